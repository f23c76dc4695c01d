"""Trajectories of chosen trials over the world that they were driven in."""

from collections import Counter
from collections.abc import Iterable, Sequence
from pathlib import Path
from typing import Any

import numpy as np
from matplotlib.axes import Axes
from matplotlib.collections import LineCollection
from matplotlib.figure import Figure
from matplotlib.lines import Line2D

from barn_eval.analysis.sources import Entry, read_entries, read_worlds
from barn_eval.experiments.track import CHANNELS, from_track_line
from barn_eval.pages.figures import new_figure, plain
from barn_eval.pages.report.maps import draw_motion, draw_touched, motion_handles, scene_under
from barn_eval.pages.report.trials import DrivenTrial
from barn_eval.trials.outcome import Outcome
from barn_worlds.base.errors import ConfigError, suggest
from barn_worlds.drawing.palette import CONTACT, GOAL, INK, START
from barn_worlds.drawing.scene import draw_contacts, draw_outlines, draw_scene, draw_trail, scale_speeds
from barn_worlds.worlds.scene import TrialScene
from barn_worlds.worlds.world import World

COLOURED_BY = ("planner", "speed")
_SPEED = CHANNELS.index("speed")
_HEIGHT_IN, _SIDE_IN = 8.0, 3.4  # the latter for labels and legend
_ARENA_IN = 1.2  # more for worlds that are as wide as high


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
    left, below, right, above = _bounds(scene, chosen)
    side_in = _SIDE_IN + (_ARENA_IN if found.corner_m is not None else 0.0)
    figure = new_figure(_HEIGHT_IN, side_in + (_HEIGHT_IN - 1.0) * (right - left) / (above - below))
    axes = figure.add_subplot()
    draw_scene(axes, scene)
    draw_motion(axes, found, chosen)
    trails = [_draw_trial(axes, found, driven, by) for driven in chosen]
    if by == "speed":
        scale_speeds(axes, trails)
    axes.set(xlim=(left, right), ylim=(below, above), aspect="equal", xlabel="x [m]", ylabel="y [m]")
    axes.set_title(f"world {world}: {len(chosen)} trial{'s' if len(chosen) > 1 else ''}")
    handles = _legend(chosen, by) + (motion_handles() if found.moving else [])
    figure.legend(handles, [str(one.get_label()) for one in handles], loc="outside right upper")
    return figure


def choose(entries: Sequence[Entry], world: int, planners: Sequence[str], outcome: str) -> list[DrivenTrial]:
    """Return the trials in a world of these planners and with this outcome, or of all; ConfigError if there is none."""
    known, outcomes = {entry.planner for entry in entries}, {one.value for one in Outcome}
    for name in set(planners) - known:
        raise ConfigError(f"planner {name!r}: has no trial here{suggest(name, known)}; there are {_listed(known)}")
    if outcome and outcome not in outcomes:
        raise ConfigError(f"outcome {outcome!r}: must be one of {_listed(outcomes)}{suggest(outcome, outcomes)}")
    there = [(entry, one) for entry in entries for one in entry.results]
    numbers = sorted({one.world for _, one in there})
    if world not in numbers:
        raise ConfigError(f"world {world}: no trial of it; there are trials of {', '.join(map(str, numbers[:12]))}")
    there = [(entry, one) for entry, one in there if one.world == world and entry.planner in (planners or known)]
    wanted = [(entry, one) for entry, one in there if outcome in ("", one.outcome.value)]
    found = [
        DrivenTrial(place, entry, one, from_track_line(entry.source.tracks[one.trial_id], str(entry.source.path))[1])
        for place, (entry, one) in enumerate(wanted)
        if one.trial_id in entry.source.tracks
    ]
    if not found:
        why = "its trials have no tracks" if wanted else "no trial of it is of this kind"
        raise ConfigError(f"world {world}: {why}")
    return found


def _world(chosen: Sequence[DrivenTrial]) -> World:
    first, source = chosen[0].result, chosen[0].entry.source
    for other in chosen:
        if other.result.world_checksum != first.world_checksum:
            paths = f"{source.path} and {other.entry.source.path}"
            raise ConfigError(f"world {first.world}: is not the same in {paths}")
    (world,) = read_worlds([(first, str(source.configuration.get("dataset", first.dataset)))]).values()
    if isinstance(world, str):
        raise ConfigError(f"world {first.world}: {world}")
    return world


def _bounds(scene: TrialScene, chosen: Sequence[DrivenTrial]) -> tuple[float, float, float, float]:
    goal = scene.ends_m()[-1:] + [0.0, scene.goal_distance_m]
    trails = (one.poses[:, :2] for one in chosen)
    points = np.vstack([scene.cylinders_m, scene.ends_m(), goal, *scene.boxes.outlines(), *trails])
    (left, below), (right, above) = points.min(axis=0) - 0.3, points.max(axis=0) + 0.3
    return float(left), float(below), float(right), float(above)


def _draw_trial(axes: Axes, world: World, driven: DrivenTrial, by: str) -> LineCollection:
    assert driven.track is not None
    colour, poses, corners_m = driven.entry.colour, driven.poses, driven.entry.source.outline.corners_m
    speeds = driven.track.samples[:, _SPEED] if by == "speed" else None
    trail = draw_trail(axes, poses[:, :2], speeds, colour)
    draw_outlines(axes, poses[[0, -1]], corners_m, colour, linewidth=1.2, zorder=4)
    draw_contacts(axes, poses[driven.track.contact, :2])
    draw_touched(axes, world, driven)
    return trail


def _legend(chosen: Sequence[DrivenTrial], by: str) -> list[Line2D]:
    """Return an entry per planner, with its outcomes, and those of start, goal and contact."""
    handles = []
    for label, colour in {one.entry.label: one.entry.colour for one in chosen}.items():
        ended = Counter(one.result.outcome.value for one in chosen if one.entry.label == label)
        told = ", ".join(f"{count} {name.replace('_', ' ')}" for name, count in ended.items())
        marker: dict[str, Any] = {} if by == "planner" else {"marker": "s", "linestyle": "", "markerfacecolor": "none"}
        handles.append(Line2D([], [], color=colour, linewidth=2.0, label=f"{plain(label)}\n{told}", **marker))
    marks: dict[str, dict[str, Any]] = {
        "start": {"color": START, "marker": "o"},
        "goal": {"color": GOAL, "marker": "*", "markersize": 11},
        "robot at both ends": {"color": INK, "marker": "s", "markerfacecolor": "none"},
    }
    if any(one.track is not None and one.track.contact.any() for one in chosen):
        marks["contact"] = {"color": CONTACT, "marker": "x"}
    return handles + [Line2D([], [], linestyle="", label=label, **look) for label, look in marks.items()]


def _listed(names: Iterable[str]) -> str:
    return ", ".join(sorted(names))
