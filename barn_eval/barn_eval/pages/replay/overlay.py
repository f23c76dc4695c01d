"""Trajectories of chosen trials over the world that they were driven in."""

from collections import Counter
from collections.abc import Iterable, Sequence
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np
from matplotlib.axes import Axes
from matplotlib.collections import LineCollection, PolyCollection
from matplotlib.figure import Figure
from matplotlib.lines import Line2D

from barn_eval.analysis.sources import Entry, Source, read_entries, read_worlds
from barn_eval.bags.true_scene import scene_of
from barn_eval.experiments.track import CHANNELS, Track, from_track_line
from barn_eval.pages.report.drawing import GOAL, INK, START, draw_scene, new_figure, plain
from barn_eval.pages.report.drawing_motion import draw_motion_of, draw_touched, motion_handles, spans_of
from barn_eval.trials.outcome import Outcome
from barn_eval.trials.result import TrialResult
from barn_eval.trials.trajectory import Floats
from barn_worlds.base.errors import ConfigError, suggest
from barn_worlds.base.types import Pose2D
from barn_worlds.geometry.bodies import wall_bodies
from barn_worlds.geometry.footprint import Footprint
from barn_worlds.messages.scene import Scene
from barn_worlds.worlds.world import World

COLOURED_BY = ("planner", "speed")
_POSE, _SPEED = slice(CHANNELS.index("x"), CHANNELS.index("yaw") + 1), CHANNELS.index("speed")
_CONTACT, _FASTEST_MPS = "#B84600", 0.5
_HEIGHT_IN, _SIDE_IN = 8.0, 3.4  # the latter for labels and legend
_ARENA_IN = 1.2  # more for worlds that are as wide as high


class Driven(NamedTuple):
    """One trial and how it went."""

    entry: Entry
    result: TrialResult
    track: Track


def overlay(
    folders: Sequence[Path], world: int, *, by: str = "planner", planners: Sequence[str] = (), outcome: str = ""
) -> Figure:
    """Return the figure of the trials of folders in one world, coloured by planner or by speed.

    planners, outcome: only these. ConfigError where there is no such trial, or worlds of that number differ.
    """
    if by not in COLOURED_BY:
        raise ConfigError(f"by: must be one of {', '.join(COLOURED_BY)}, got {by!r}{suggest(by, COLOURED_BY)}")
    chosen = choose(read_entries(folders), world, planners, outcome)
    found = _world(chosen)
    scene = scene_under(chosen[0].entry.source, found)
    left, below, right, above = _bounds(scene, found, chosen)
    side_in = _SIDE_IN + (_ARENA_IN if found.corner_m is not None else 0.0)
    figure = new_figure(_HEIGHT_IN, side_in + (_HEIGHT_IN - 1.0) * (right - left) / (above - below))
    axes = figure.add_subplot()
    draw_scene(axes, scene)
    draw_motion_of(axes, found, spans_of((one.result, one.track.samples[:, 0]) for one in chosen))
    for driven in chosen:
        _draw_trial(axes, driven, by)
        end_s = float(driven.track.samples[-1, 0])
        draw_touched(axes, found, driven.result, end_s, driven.entry.colour)
    if by == "speed":
        fastest = max(_FASTEST_MPS, *(float(np.nanmax(np.abs(one.track.samples[:, _SPEED]))) for one in chosen))
        lines = [
            drawn for drawn in axes.collections if isinstance(drawn, LineCollection) and drawn.get_array() is not None
        ]
        for line in lines:
            line.set_clim(0.0, fastest)
        figure.colorbar(lines[-1], ax=axes, label="speed [m/s]", fraction=0.05, pad=0.02)
    axes.set(xlim=(left, right), ylim=(below, above), aspect="equal", xlabel="x [m]", ylabel="y [m]")
    axes.set_title(f"world {world}: {len(chosen)} trial{'s' if len(chosen) > 1 else ''}")
    handles = _legend(chosen, by) + (motion_handles() if found.moving else [])
    figure.legend(handles, [str(one.get_label()) for one in handles], loc="outside right upper")
    return figure


def choose(entries: Sequence[Entry], world: int, planners: Sequence[str], outcome: str) -> list[Driven]:
    """Return the trials in a world of these planners and with this outcome, or of all; ConfigError if there is none."""
    known = {entry.planner for entry in entries}
    for name in planners:
        if name not in known:
            raise ConfigError(f"planner {name!r}: has no trial here{suggest(name, known)}; there are {_listed(known)}")
    outcomes = {one.value for one in Outcome}
    if outcome and outcome not in outcomes:
        raise ConfigError(f"outcome {outcome!r}: must be one of {_listed(outcomes)}{suggest(outcome, outcomes)}")
    there = [(entry, one) for entry in entries for one in entry.results]
    if world not in {one.world for _, one in there}:
        numbers = sorted({one.world for _, one in there})
        raise ConfigError(f"world {world}: no trial of it; there are trials of {', '.join(map(str, numbers[:12]))}")
    wanted = [
        (entry, one)
        for entry, one in there
        if one.world == world and (not planners or entry.planner in planners) and outcome in ("", one.outcome.value)
    ]
    found = [
        Driven(entry, one, from_track_line(entry.source.tracks[one.trial_id], str(entry.source.path))[1])
        for entry, one in wanted
        if one.trial_id in entry.source.tracks
    ]
    if not found:
        raise ConfigError(
            f"world {world}: {'its trials have no tracks' if wanted else 'no trial of it is of this kind'}"
        )
    return found


def _world(chosen: Sequence[Driven]) -> World:
    first, source = chosen[0], chosen[0].entry.source
    other = next((one for one in chosen if one.result.world_checksum != first.result.world_checksum), None)
    if other is not None:
        paths = f"{source.path} and {other.entry.source.path}"
        raise ConfigError(f"world {first.result.world}: is not the same in {paths}")
    (world,) = read_worlds([(first.result, str(source.configuration.get("dataset", first.result.dataset)))]).values()
    if isinstance(world, str):
        raise ConfigError(f"world {first.result.world}: {world}")
    return world


def scene_under(source: Source, world: World) -> Scene:
    """Return a world with start and goal under the protocol of a source; BarnError if that cannot be told."""
    rules = source.experiment.protocol.sized(world, source.chassis)
    return scene_of(world, rules.course(world), rules.goal_distance_m)


def _bounds(scene: Scene, world: World, chosen: Sequence[Driven]) -> tuple[float, float, float, float]:
    assert scene.start is not None and scene.goal is not None
    ends = np.array([[scene.start.x, scene.start.y], [scene.goal.x, scene.goal.y + scene.goal_distance_m]])
    points = np.vstack(
        [
            scene.cylinders_m,
            ends,
            *wall_bodies(world.walls).outlines(),
            *(one.track.samples[:, _POSE][:, :2] for one in chosen),
        ]
    )
    (left, below), (right, above) = points.min(axis=0) - 0.3, points.max(axis=0) + 0.3
    return float(left), float(below), float(right), float(above)


def _draw_trial(axes: Axes, driven: Driven, by: str) -> None:
    poses, speeds = driven.track.samples[:, _POSE], np.abs(driven.track.samples[:, _SPEED])
    segments = list(np.stack([poses[:-1, :2], poses[1:, :2]], axis=1))
    look: dict[str, Any] = {"colors": driven.entry.colour} if by == "planner" else {"cmap": "viridis"}
    line = LineCollection(segments, linewidths=1.8, alpha=0.85, zorder=3, capstyle="round", **look)
    if by == "speed":
        line.set_array(speeds[1:])
        axes.plot(*poses[:, :2].T, color=INK, linewidth=2.8, zorder=2.9)  # on which bright colours are seen
    axes.add_collection(line)
    outlines = [outline(poses[index], driven.entry.source.outline) for index in (0, -1)]
    axes.add_collection(
        PolyCollection(outlines, facecolor="none", edgecolor=driven.entry.colour, linewidth=1.2, zorder=4)
    )
    touching = poses[driven.track.contact, :2]
    axes.plot(*touching.T, "x", color=_CONTACT, markersize=8, markeredgewidth=2.0, zorder=5)


def outline(pose: Floats, robot: Footprint) -> Floats:
    """Return the corners (k, 2) of a robot at a pose (3,)."""
    return Pose2D(*pose.tolist()).transform(robot.corners_m)


def _legend(chosen: Sequence[Driven], by: str) -> list[Line2D]:
    """Return an entry per planner, with its outcomes, and those of start, goal and contact."""
    handles = []
    for label, colour in {one.entry.label: one.entry.colour for one in chosen}.items():
        ended = Counter(one.result.outcome.value for one in chosen if one.entry.label == label)
        told = ", ".join(f"{count} {name.replace('_', ' ')}" for name, count in ended.items())
        marker: dict[str, Any] = {} if by == "planner" else {"marker": "s", "linestyle": "", "markerfacecolor": "none"}
        handles.append(Line2D([], [], color=colour, linewidth=2.0, label=f"{plain(label)}\n{told}", **marker))
    handles.append(Line2D([], [], color=START, marker="o", linestyle="", label="start"))
    handles.append(Line2D([], [], color=GOAL, marker="*", markersize=11, linestyle="", label="goal"))
    square: dict[str, Any] = {"color": INK, "marker": "s", "markerfacecolor": "none", "linestyle": ""}
    handles.append(Line2D([], [], label="robot at both ends", **square))
    if any(one.track.contact.any() for one in chosen):
        handles.append(Line2D([], [], color=_CONTACT, marker="x", linestyle="", label="contact"))
    return handles


def _listed(names: Iterable[str]) -> str:
    return ", ".join(sorted(names))
