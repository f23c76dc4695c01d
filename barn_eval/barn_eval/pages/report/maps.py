"""Maps of worlds with the trajectories of trials in them."""

from collections import Counter
from collections.abc import Mapping, Sequence
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
from matplotlib.artist import Artist
from matplotlib.axes import Axes
from matplotlib.collections import LineCollection, PolyCollection
from matplotlib.figure import Figure
from matplotlib.lines import Line2D

from barn_eval.analysis.difficulty import WorldOrder
from barn_eval.analysis.sources import Entry, read_entries
from barn_eval.pages.figures import marker_of, new_figure, plain
from barn_eval.pages.report.charts import ChartData, Legend, Panels, chart
from barn_eval.pages.report.trials import (
    DrivenTrial,
    driven_trials,
    known_scene,
    scene_under,
)
from barn_eval.results.tracks import CHANNELS
from barn_eval.trials.outcome import Outcome
from barn_worlds.base.errors import ConfigError, suggest
from barn_worlds.drawing import scene as drawing
from barn_worlds.drawing.palette import CONTACT, FAINT, GOAL, INK, MOVER, START
from barn_worlds.geometry.bodies import moving_bodies
from barn_worlds.worlds.scene import TrialScene
from barn_worlds.worlds.world import World

_PER_ROW = 4
_WIDTH_IN, _MAP_IN, _AROUND_IN = (
    16.0,
    3.3,
    1.0,
)  # the figure's width and a map's; its title and labels
_WAY_STEP_S, _LONGEST_WAY_S = 0.1, 200.0
_SHORTEST_ARROW_M = 0.3


def hardest_maps(
    order: WorldOrder,
    drives: Sequence[DrivenTrial],
    worlds: Mapping[int, World],
    most: int,
) -> dict[int, tuple[World, list[DrivenTrial]]]:
    """Return the hardest worlds that are at hand, by number, with the trials in each."""
    numbers = [number for number in reversed(order.worlds) if number in worlds][:most]
    return {
        number: (worlds[number], [one for one in drives if one.result.world == number])
        for number in numbers
    }


@chart(
    "The hardest worlds with all recorded trajectories",
    lambda data: _layout(data) if data.hardest else None,
)
def _hardest(panels: Sequence[Axes], data: ChartData) -> Legend:
    for axes in panels[len(data.hardest) :]:
        axes.set_axis_off()
    for axes, (number, (world, drives)) in zip(
        panels, data.hardest.items(), strict=False
    ):
        axes.set_gid(f"world-{number}")
        _draw_map(axes, world, drives)
        difficulty = data.order.mean_s_per_m[data.order.worlds.index(number)]
        good = sum(drive.result.scores.success for drive in drives)
        axes.set_title(
            f"world {number}: {difficulty:.2f} s/m\n{good} of {len(drives)} trials succeed"
        )
    handles = [
        Line2D(
            [],
            [],
            color=entry.color,
            linewidth=2,
            marker=marker_of(index),
            label=entry.label,
        )
        for index, entry in enumerate(data.entries)
    ]
    cross: dict[str, Any] = {
        "marker": "x",
        "linestyle": "",
        "markersize": 8,
        "markeredgewidth": 2,
    }
    handles += [
        Line2D([], [], color=INK, **cross, label="end of a failed trial"),
        Line2D([], [], color=FAINT, linestyle="--", label="shortest path"),
        Line2D(
            [], [], color=START, marker="o", linestyle="", markersize=7, label="start"
        ),
        Line2D(
            [], [], color=GOAL, marker="*", linestyle="", markersize=13, label="goal"
        ),
    ]
    handles += (
        motion_handles()
        if any(world.moving for world, _ in data.hardest.values())
        else []
    )
    return Legend(handles, [str(one.get_label()) for one in handles])


def _layout(data: ChartData) -> Panels:
    """Return panels in which maps are as wide as there is room."""
    rows = -(-len(data.hardest) // _PER_ROW)
    sizes = [_seen(world, drives) for world, drives in data.hardest.values()]
    steepest = max(
        (above - below) / (right - left) for left, below, right, above in sizes
    )
    return Panels(
        (_MAP_IN * steepest + _AROUND_IN) * rows + 0.4,
        _PER_ROW,
        rows,
        width_in=_WIDTH_IN,
    )


def _seen(
    world: World, drives: Sequence[DrivenTrial]
) -> tuple[float, float, float, float]:
    """Return left, below, right and above of what a map shows."""
    scene = known_scene(drives[0].entry.source, world)
    left, below, right, above = world.bounds_m
    whole = np.array(
        [below, above] if world.corner_m is not None else []
    )  # all of an arena
    seen = np.concatenate(
        [whole, scene.ends_m()[:, 1], *(drive.poses[:, 1] for drive in drives)]
    )
    first, last = scene.path_m[[0, -1], 1]
    low, high = (
        max(below, seen.min(initial=first) - 0.8),
        max(above, last, seen.max(initial=above)) + 0.6,
    )
    trails = (drive.poses[:, :2] for drive in drives)
    (left, below), (right, above) = scene.view_m(
        np.array([left, low]), np.array([right, high]), *trails
    )
    return float(left), float(below), float(right), float(above)


def _draw_map(axes: Axes, world: World, drives: Sequence[DrivenTrial]) -> None:
    scene = known_scene(drives[0].entry.source, world)
    drawing.draw_scene(axes, scene, faint=True)
    draw_motion(axes, world, drives)
    for drive in drives:
        if drive.track is None:
            continue
        colour, trail = drive.entry.color, drive.poses[:, :2]
        marks: list[Artist] = [
            *axes.plot(*trail.T, color=colour, linewidth=1.5, alpha=0.8)
        ]
        corners_m = drive.entry.source.outline.corners_m
        marks.append(
            drawing.draw_outlines(
                axes, drive.poses[-1:], corners_m, colour, linewidth=1.0
            )
        )
        marks += draw_touched(axes, world, drive)
        if not drive.result.scores.success:
            marks += axes.plot(
                *trail[-1],
                color=colour,
                marker="x",
                markersize=9,
                markeredgewidth=2.4,
                zorder=5,
            )
        for number, mark in enumerate(marks):
            mark.set_gid(
                f"trial-{drive.place}-{number}"
            )  # by which the page hides what its filters leave out
    left, below, right, above = _seen(world, drives)
    axes.set(
        xlim=(left, right),
        ylim=(below, above),
        aspect="equal",
        xlabel="x [m]",
        ylabel="y [m]",
    )
    axes.grid(visible=True)
    axes.set_axisbelow(True)


def draw_motion(axes: Axes, world: World, drives: Sequence[DrivenTrial]) -> None:
    """Draw the ways of a world's moving obstacles while trials went, with arrows."""
    longest: dict[float, float] = {}
    for drive in drives:
        if drive.result.motion is not None and drive.track is not None:
            begin_s = drive.result.motion.phase_s
            longest[begin_s] = max(longest.get(begin_s, 0.0), begin_s + drive.end_s)
    for begin_s, end_s in longest.items() if world.moving else ():
        pieces = drawing.motion_paths(
            world.tracks,
            np.arange(max(begin_s, end_s - _LONGEST_WAY_S), end_s + 1e-9, _WAY_STEP_S),
        )
        drawing.draw_motion_paths(axes, pieces, alpha=0.55, zorder=1.5)
        for piece in pieces:
            if np.hypot(*(piece[-1] - piece[0])) > _SHORTEST_ARROW_M:
                drawing.draw_arrow(
                    axes,
                    piece[-1],
                    piece[-1] - piece[-2],
                    mutation_scale=8.0,
                    linewidth=0.6,
                    alpha=0.7,
                )


def draw_touched(axes: Axes, world: World, drive: DrivenTrial) -> list[Artist]:
    """Draw and return the moving obstacle that ended a trial, where it was then; nothing where none did."""
    motion = drive.result.motion
    if motion is None or motion.touched not in world.tracks.names:
        return []
    outlines = moving_bodies(world.tracks, motion.phase_s + drive.end_s).outlines()
    hit = [outlines[world.tracks.names.index(motion.touched)]]
    look: dict[str, Any] = {
        "facecolor": MOVER + "55",
        "edgecolor": drive.entry.color,
        "linewidth": 1.4,
    }
    return [axes.add_collection(PolyCollection(hit, zorder=2.5, **look))]


def motion_handles() -> list[Line2D]:
    """Return the entries of a legend."""
    way = Line2D(
        [], [], color=MOVER, linewidth=1.0, alpha=0.7, label="way of what moves"
    )
    hit = Line2D(
        [],
        [],
        marker="o",
        markersize=9,
        markerfacecolor=MOVER + "55",
        markeredgecolor=MOVER,
        linestyle="",
    )
    hit.set_label("what was hit")
    return [way, hit]


COLOURED_BY = ("planner", "speed")
_SPEED = CHANNELS.index("speed")
_HEIGHT_IN, _SIDE_IN = 8.0, 3.4  # the latter for labels and legend
_ARENA_IN = 1.2  # more for worlds that are as wide as high


def overlay(
    folders: Sequence[Path],
    world: int,
    *,
    by: str = "planner",
    planners: Sequence[str] = (),
    outcome: str = "",
) -> Figure:
    """Return the figure of the trials of folders in one world, coloured by planner or by speed.

    planners, outcome: only these. ConfigError where there is no such trial, or worlds of that number differ.
    """
    if by not in COLOURED_BY:
        raise ConfigError(
            f"by: must be one of {', '.join(COLOURED_BY)}, got {by!r}{suggest(by, COLOURED_BY)}"
        )
    chosen, found = choose(read_entries(folders), world, planners, outcome)
    scene = scene_under(chosen[0].entry.source, found)
    left, below, right, above = _bounds(scene, chosen)
    side_in = _SIDE_IN + (_ARENA_IN if found.corner_m is not None else 0.0)
    figure = new_figure(
        _HEIGHT_IN, side_in + (_HEIGHT_IN - 1.0) * (right - left) / (above - below)
    )
    axes = figure.add_subplot()
    drawing.draw_scene(axes, scene)
    draw_motion(axes, found, chosen)
    trails = [_draw_trial(axes, found, driven, by) for driven in chosen]
    if by == "speed":
        drawing.scale_speeds(axes, trails)
    axes.set(
        xlim=(left, right),
        ylim=(below, above),
        aspect="equal",
        xlabel="x [m]",
        ylabel="y [m]",
    )
    axes.set_title(
        f"world {world}: {len(chosen)} trial{'s' if len(chosen) > 1 else ''}"
    )
    handles = _legend(chosen, by) + (motion_handles() if found.moving else [])
    figure.legend(
        handles, [str(one.get_label()) for one in handles], loc="outside right upper"
    )
    return figure


def choose(
    entries: Sequence[Entry], world: int, planners: Sequence[str], outcome: str
) -> tuple[list[DrivenTrial], World]:
    """Return the trials in a world of these planners and with this outcome, or of all, and the world."""
    known, outcomes = (
        {entry.planner for entry in entries},
        {one.value for one in Outcome},
    )
    for name in set(planners) - known:
        there = ", ".join(sorted(known))
        raise ConfigError(
            f"planner {name!r}: has no trial here{suggest(name, known)}; there are {there}"
        )
    if outcome and outcome not in outcomes:
        allowed = ", ".join(sorted(outcomes))
        raise ConfigError(
            f"outcome {outcome!r}: must be one of {allowed}{suggest(outcome, outcomes)}"
        )
    numbers = sorted({one.world for entry in entries for one in entry.results})
    if world not in numbers:
        raise ConfigError(
            f"world {world}: no trial of it; there are trials of {', '.join(map(str, numbers[:12]))}"
        )
    wanted = []
    for entry in entries:
        own = (
            one
            for one in entry.results
            if one.world == world and outcome in ("", one.outcome.value)
        )
        wanted += (
            [replace(entry, results=tuple(own))]
            if entry.planner in (planners or known)
            else []
        )
    drives, worlds = driven_trials(wanted)
    found = [one for one in drives if one.track is not None]
    if not found:
        why = (
            "its trials have no tracks" if drives else "no trial of it is of this kind"
        )
        raise ConfigError(f"world {world}: {why}")
    for one in found:
        if one.result.world_checksum != found[0].result.world_checksum:
            paths = f"{found[0].entry.source.path} and {one.entry.source.path}"
            raise ConfigError(f"world {world}: is not the same in {paths}")
    if found[0].problem:
        raise ConfigError(f"world {world}: {found[0].problem}")
    return found, worlds[found[0].result.world_checksum]


def _bounds(
    scene: TrialScene, chosen: Sequence[DrivenTrial]
) -> tuple[float, float, float, float]:
    goal = scene.ends_m()[-1:] + [0.0, scene.goal_distance_m]
    trails = [one.poses[:, :2] for one in chosen]
    points = np.vstack(
        [scene.cylinders_m, scene.ends_m(), goal, *scene.boxes.outlines(), *trails]
    )
    (left, below), (right, above) = scene.view_m(
        points.min(axis=0) - 0.3, points.max(axis=0) + 0.3, *trails
    )
    return float(left), float(below), float(right), float(above)


def _draw_trial(
    axes: Axes, world: World, driven: DrivenTrial, by: str
) -> LineCollection:
    assert driven.track is not None
    colour, poses, corners_m = (
        driven.entry.color,
        driven.poses,
        driven.entry.source.outline.corners_m,
    )
    speeds = driven.track.samples[:, _SPEED] if by == "speed" else None
    trail = drawing.draw_trail(axes, poses[:, :2], speeds, colour)
    drawing.draw_outlines(
        axes, poses[[0, -1]], corners_m, colour, linewidth=1.2, zorder=4
    )
    drawing.draw_contacts(axes, poses[driven.track.contact, :2])
    draw_touched(axes, world, driven)
    return trail


def _legend(chosen: Sequence[DrivenTrial], by: str) -> list[Line2D]:
    """Return an entry per planner, with its outcomes, and those of start, goal and contact."""
    handles = []
    for label, colour in {one.entry.label: one.entry.color for one in chosen}.items():
        ended = Counter(
            one.result.outcome.value for one in chosen if one.entry.label == label
        )
        told = ", ".join(
            f"{count} {name.replace('_', ' ')}" for name, count in ended.items()
        )
        marker: dict[str, Any] = (
            {}
            if by == "planner"
            else {"marker": "s", "linestyle": "", "markerfacecolor": "none"}
        )
        handles.append(
            Line2D(
                [],
                [],
                color=colour,
                linewidth=2.0,
                label=f"{plain(label)}\n{told}",
                **marker,
            )
        )
    marks: dict[str, dict[str, Any]] = {
        "start": {"color": START, "marker": "o"},
        "goal": {"color": GOAL, "marker": "*", "markersize": 11},
        "robot at both ends": {"color": INK, "marker": "s", "markerfacecolor": "none"},
    }
    if any(one.track is not None and one.track.contact.any() for one in chosen):
        marks["contact"] = {"color": CONTACT, "marker": "x"}
    return handles + [
        Line2D([], [], linestyle="", label=label, **look)
        for label, look in marks.items()
    ]
