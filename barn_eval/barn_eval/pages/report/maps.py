"""Maps of worlds with the trajectories of trials in them."""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np
from matplotlib.artist import Artist
from matplotlib.axes import Axes
from matplotlib.collections import PolyCollection
from matplotlib.figure import Figure
from matplotlib.lines import Line2D

from barn_eval.analysis.difficulty import Difficulty
from barn_eval.analysis.sources import Entry, Source
from barn_eval.experiments.track import CHANNELS, Track
from barn_eval.pages.figures import legend_below, marker_of, new_figure
from barn_eval.trials.result import TrialResult
from barn_worlds.base.arrays import Floats
from barn_worlds.base.errors import BarnError
from barn_worlds.drawing.palette import FAINT, GOAL, INK, MOVER, START
from barn_worlds.drawing.scene import draw_arrow, draw_outlines, draw_scene, draw_ways, ways
from barn_worlds.geometry.bodies import moving_bodies
from barn_worlds.worlds.scene import Scene, scene_of
from barn_worlds.worlds.world import World

_PER_ROW = 4
_POSE = slice(CHANNELS.index("x"), CHANNELS.index("yaw") + 1)
_WAY_STEP_S, _LONGEST_WAY_S = 0.1, 200.0
_SHORTEST_ARROW_M = 0.3


@dataclass(frozen=True, eq=False)
class DrivenTrial:
    """A trial on a map: its place among all, its entry, its result, its track if there is one."""

    place: int
    entry: Entry
    result: TrialResult
    track: Track | None

    @property
    def poses(self) -> Floats:
        """Poses (n, 3) of the track, none without one."""
        return np.empty((0, 3)) if self.track is None else self.track.samples[:, _POSE]

    @property
    def end_s(self) -> float:
        """When the track ends."""
        return 0.0 if self.track is None else float(self.track.samples[-1, 0])


def hardest_figure(
    entries: Sequence[Entry],
    order: Difficulty,
    worlds: Mapping[int, World],
    drives: Mapping[int, Sequence[DrivenTrial]],
) -> Figure:
    """Draw each world (by its number, hardest first) with its trails; a cross is where a trial ended that failed.

    Start and goal are those of the protocol, where the configuration can be read.
    """
    rows = -(-len(worlds) // _PER_ROW)
    figure = new_figure(4.9 * rows + 0.5)
    panels = figure.subplots(rows, _PER_ROW, squeeze=False).ravel()
    for axes in panels[len(worlds) :]:
        axes.set_axis_off()
    for axes, (number, world) in zip(panels, worlds.items(), strict=False):
        axes.set_gid(f"world-{number}")
        _draw_map(axes, world, drives[number])
        difficulty = order.mean_s_per_m[order.worlds.index(number)]
        good = sum(drive.result.scores.success for drive in drives[number])
        axes.set_title(f"world {number}: {difficulty:.2f} s/m\n{good} of {len(drives[number])} trials succeed")
    handles = [
        Line2D([], [], color=entry.colour, linewidth=2, marker=marker_of(index), label=entry.label)
        for index, entry in enumerate(entries)
    ]
    handles += [
        Line2D(
            [], [], color=INK, marker="x", linestyle="", markersize=8, markeredgewidth=2, label="end of a failed trial"
        ),
        Line2D([], [], color=FAINT, linestyle="--", label="shortest path"),
        Line2D([], [], color=START, marker="o", linestyle="", markersize=7, label="start"),
        Line2D([], [], color=GOAL, marker="*", linestyle="", markersize=13, label="goal"),
    ]
    handles += motion_handles() if any(world.moving for world in worlds.values()) else []
    legend_below(figure, handles)
    return figure


def _draw_map(axes: Axes, world: World, drives: Sequence[DrivenTrial]) -> None:
    scene = known_scene(drives[0].entry.source, world)
    draw_scene(axes, scene, faint=True)
    draw_motion(axes, world, drives)
    for drive in drives:
        if drive.track is None:
            continue
        colour, trail = drive.entry.colour, drive.poses[:, :2]
        marks: list[Artist] = [*axes.plot(*trail.T, color=colour, linewidth=1.5, alpha=0.8)]
        marks.append(draw_outlines(axes, drive.poses[-1:], drive.entry.source.outline.corners_m, colour, linewidth=1.0))
        marks += draw_touched(axes, world, drive)
        if not drive.result.scores.success:
            marks += axes.plot(*trail[-1], color=colour, marker="x", markersize=9, markeredgewidth=2.4, zorder=5)
        for number, mark in enumerate(marks):
            mark.set_gid(f"trial-{drive.place}-{number}")  # by which the page hides what its filters leave out
    left, below, right, above = world.bounds_m
    axes.set_xlim(left, right)
    whole = np.array([below, above] if world.corner_m is not None else [])  # all of an arena
    seen = np.concatenate([whole, scene.ends_m()[:, 1], *(drive.poses[:, 1] for drive in drives)])
    first, last = scene.path_m[[0, -1], 1]
    axes.set_ylim(max(below, seen.min(initial=first) - 0.8), max(above, last, seen.max(initial=above)) + 0.6)
    axes.set(aspect="equal", xlabel="x [m]", ylabel="y [m]")
    axes.grid(visible=True)
    axes.set_axisbelow(True)


def scene_under(source: Source, world: World) -> Scene:
    """Return a world with start and goal under the protocol of a source; BarnError if that cannot be told."""
    rules = source.experiment.protocol.sized(world, source.chassis)
    course = rules.course(world)
    return scene_of(world, course.start, course.goal, rules.goal_distance_m)


def known_scene(source: Source, world: World) -> Scene:
    """Return a world with start and goal under the protocol of a source, without them where it does not say."""
    try:
        return scene_under(source, world)
    except (BarnError, KeyError, TypeError, ValueError):
        return scene_of(world)


def draw_motion(axes: Axes, world: World, drives: Sequence[DrivenTrial]) -> None:
    """Draw the ways of a world's moving obstacles while trials went, with arrows."""
    longest: dict[float, float] = {}
    for drive in drives:
        if drive.result.motion is not None and drive.track is not None:
            begin_s = drive.result.motion.phase_s
            longest[begin_s] = max(longest.get(begin_s, 0.0), begin_s + drive.end_s)
    for begin_s, end_s in longest.items() if world.moving else ():
        pieces = ways(world.tracks, np.arange(max(begin_s, end_s - _LONGEST_WAY_S), end_s + 1e-9, _WAY_STEP_S))
        draw_ways(axes, pieces, alpha=0.55, zorder=1.5)
        for piece in pieces:
            if np.hypot(*(piece[-1] - piece[0])) > _SHORTEST_ARROW_M:
                draw_arrow(axes, piece[-1], piece[-1] - piece[-2], mutation_scale=8.0, linewidth=0.6, alpha=0.7)


def draw_touched(axes: Axes, world: World, drive: DrivenTrial) -> list[Artist]:
    """Draw and return the moving obstacle that ended a trial, where it was then; nothing where none did."""
    motion = drive.result.motion
    if motion is None or motion.touched not in world.tracks.names:
        return []
    outlines = moving_bodies(world.tracks, motion.phase_s + drive.end_s).outlines()
    hit = [outlines[world.tracks.names.index(motion.touched)]]
    look: dict[str, Any] = {"facecolor": MOVER + "55", "edgecolor": drive.entry.colour, "linewidth": 1.4}
    return [axes.add_collection(PolyCollection(hit, zorder=2.5, **look))]


def motion_handles() -> list[Line2D]:
    """Return the entries of a legend."""
    way = Line2D([], [], color=MOVER, linewidth=1.0, alpha=0.7, label="way of what moves")
    hit = Line2D([], [], marker="o", markersize=9, markerfacecolor=MOVER + "55", markeredgecolor=MOVER, linestyle="")
    hit.set_label("what was hit")
    return [way, hit]
