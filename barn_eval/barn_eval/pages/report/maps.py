"""Maps of worlds with the trajectories of trials in them."""

from collections.abc import Mapping, Sequence
from typing import Any

import numpy as np
from matplotlib.artist import Artist
from matplotlib.axes import Axes
from matplotlib.collections import PolyCollection
from matplotlib.lines import Line2D

from barn_eval.analysis.difficulty import Difficulty
from barn_eval.analysis.sources import Source
from barn_eval.pages.figures import marker_of
from barn_eval.pages.report.charts import ChartData, Legend, Panels, chart
from barn_eval.pages.report.trials import DrivenTrial
from barn_worlds.base.errors import BarnError
from barn_worlds.drawing.palette import FAINT, GOAL, INK, MOVER, START
from barn_worlds.drawing.scene import draw_arrow, draw_outlines, draw_scene, draw_ways, ways
from barn_worlds.geometry.bodies import moving_bodies
from barn_worlds.worlds.scene import TrialScene, scene_of
from barn_worlds.worlds.world import World

_PER_ROW = 4
_WAY_STEP_S, _LONGEST_WAY_S = 0.1, 200.0
_SHORTEST_ARROW_M = 0.3


def hardest_maps(
    order: Difficulty, drives: Sequence[DrivenTrial], worlds: Mapping[int, World], most: int
) -> dict[int, tuple[World, list[DrivenTrial]]]:
    """Return the hardest worlds that are at hand, by number, with the trials in each."""
    numbers = [number for number in reversed(order.worlds) if number in worlds][:most]
    return {number: (worlds[number], [one for one in drives if one.result.world == number]) for number in numbers}


@chart(
    "The hardest worlds with all trajectories that were recorded",
    lambda data: Panels(4.9 * _rows(data) + 0.5, _PER_ROW, _rows(data)) if data.hardest else None,
)
def _hardest(panels: Sequence[Axes], data: ChartData) -> Legend:
    for axes in panels[len(data.hardest) :]:
        axes.set_axis_off()
    for axes, (number, (world, drives)) in zip(panels, data.hardest.items(), strict=False):
        axes.set_gid(f"world-{number}")
        _draw_map(axes, world, drives)
        difficulty = data.order.mean_s_per_m[data.order.worlds.index(number)]
        good = sum(drive.result.scores.success for drive in drives)
        axes.set_title(f"world {number}: {difficulty:.2f} s/m\n{good} of {len(drives)} trials succeed")
    handles = [
        Line2D([], [], color=entry.colour, linewidth=2, marker=marker_of(index), label=entry.label)
        for index, entry in enumerate(data.entries)
    ]
    cross: dict[str, Any] = {"marker": "x", "linestyle": "", "markersize": 8, "markeredgewidth": 2}
    handles += [
        Line2D([], [], color=INK, **cross, label="end of a failed trial"),
        Line2D([], [], color=FAINT, linestyle="--", label="shortest path"),
        Line2D([], [], color=START, marker="o", linestyle="", markersize=7, label="start"),
        Line2D([], [], color=GOAL, marker="*", linestyle="", markersize=13, label="goal"),
    ]
    handles += motion_handles() if any(world.moving for world, _ in data.hardest.values()) else []
    return Legend(handles, [str(one.get_label()) for one in handles])


def _rows(data: ChartData) -> int:
    return -(-len(data.hardest) // _PER_ROW)


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


def scene_under(source: Source, world: World) -> TrialScene:
    """Return a world with start and goal under the protocol of a source; BarnError if that cannot be told."""
    rules = source.experiment.protocol.sized(world, source.chassis)
    course = rules.course(world)
    return scene_of(world, course.start, course.goal, rules.goal_distance_m)


def known_scene(source: Source, world: World) -> TrialScene:
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
