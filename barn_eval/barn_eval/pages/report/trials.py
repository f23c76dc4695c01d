"""Single trials in a report: the data behind their table and the view of each, and maps of the hardest worlds."""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
from matplotlib.artist import Artist
from matplotlib.axes import Axes
from matplotlib.figure import Figure
from matplotlib.lines import Line2D
from matplotlib.patches import Polygon

from barn_eval.analysis.difficulty import Difficulty
from barn_eval.analysis.measures import MEASURES, metric_of, safety_of, with_motion
from barn_eval.analysis.sources import Entry, Source
from barn_eval.experiments.track import CHANNELS, NO_NUMBER, Track, pack
from barn_eval.pages.replay.overlay import outline, scene_under
from barn_eval.pages.replay.shape_arrays import motion_arrays
from barn_eval.pages.report import drawing
from barn_eval.pages.report.drawing_motion import draw_motion_of, draw_touched, motion_handles, spans_of
from barn_eval.trials.result import TrialResult
from barn_worlds.base.errors import BarnError
from barn_worlds.base.types import Pose2D
from barn_worlds.worlds.world import World

_PER_ROW = 4
# The page's table has these columns, with their digits (None: a text), then those of measures.
_COLUMNS = {"planner": None, "world": 0, "trial": 0, "outcome": None}
_MEASURES = (
    "traversal_time_s",
    "normalised_time_s_per_m",
    "challenge",
    "driven_m",
    "min_clearance_m",
    "contact_s",
    "compute_p95_ms",
    "missed_cycles",
)


@dataclass(frozen=True, eq=False)
class DrivenTrial:
    """A trial on a map: its place in the report, the number of its entry, its result, its track if there is one."""

    place: int
    entry: int
    result: TrialResult
    track: Track | None


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
    figure = drawing.new_figure(4.9 * rows + 0.5)
    panels = figure.subplots(rows, _PER_ROW, squeeze=False).ravel()
    for axes in panels[len(worlds) :]:
        axes.set_axis_off()
    for axes, (number, world) in zip(panels, worlds.items(), strict=False):
        axes.set_gid(f"world-{number}")
        _draw(axes, entries, world, drives[number])
        difficulty = order.mean_s_per_m[order.worlds.index(number)]
        good = sum(drive.result.scores.success for drive in drives[number])
        axes.set_title(f"world {number}: {difficulty:.2f} s/m\n{good} of {len(drives[number])} trials succeed")
    handles = [
        Line2D([], [], color=entry.colour, linewidth=2, marker=drawing.marker_of(index))
        for index, entry in enumerate(entries)
    ]
    failed = Line2D([], [], color=drawing.INK, marker="x", linestyle="", markersize=8, markeredgewidth=2)
    path = Line2D([], [], color=drawing.FAINT, linestyle="--")
    start = Line2D([], [], color=drawing.START, marker="o", linestyle="", markersize=7)
    goal = Line2D([], [], color=drawing.GOAL, marker="*", linestyle="", markersize=13)
    names = [*(entry.label for entry in entries), "end of a failed trial", "shortest path", "start", "goal"]
    moving = motion_handles() if any(world.moving for world in worlds.values()) else []
    names += [str(one.get_label()) for one in moving]
    drawing.legend_below(figure, [*handles, failed, path, start, goal, *moving], names)
    return figure


def _draw(axes: Axes, entries: Sequence[Entry], world: World, drives: Sequence[DrivenTrial]) -> None:
    drawing.discs(axes, world.cylinders_m, world.cylinder_radius_m, facecolor=drawing.FAINT)
    path = world.path_m()
    axes.plot(path[:, 0], path[:, 1], color=drawing.FAINT, linestyle="--", linewidth=1.4)
    tracks = [(drive.result, drive.track.samples[:, 0]) for drive in drives if drive.track is not None]
    draw_motion_of(axes, world, spans_of(tracks))
    ends = course_of(entries[drives[0].entry].source, world)
    for pose, marker, colour in ((ends[0], "o", drawing.START), (ends[1], "*", drawing.GOAL)) if ends else ():
        axes.plot(pose.x, pose.y, marker, color=colour, markersize=7 if marker == "o" else 13, zorder=6)
    for drive in drives:
        if drive.track is None:
            continue
        colour = entries[drive.entry].colour
        trail = drive.track.samples[:, 1:3]
        marks: list[Artist] = [*axes.plot(trail[:, 0], trail[:, 1], color=colour, linewidth=1.5, alpha=0.8)]
        last = Polygon(
            outline(drive.track.samples[-1, 1:4], entries[drive.entry].source.outline),
            fill=False,
            edgecolor=colour,
            linewidth=1.0,
        )
        marks.append(axes.add_patch(last))
        marks += draw_touched(axes, world, drive.result, float(drive.track.samples[-1, 0]), colour)
        if not drive.result.scores.success:
            marks += axes.plot(*trail[-1], color=colour, marker="x", markersize=9, markeredgewidth=2.4, zorder=5)
        for number, mark in enumerate(marks):
            mark.set_gid(f"trial-{drive.place}-{number}")  # by which the page hides what its filters leave out
    left, below, right, above = world.bounds_m
    axes.set_xlim(left, right)
    driven = [np.array([below, above])] if world.corner_m is not None else []  # all of an arena
    driven += [drive.track.samples[:, 2] for drive in drives if drive.track]
    seen = [*(float(value) for one in driven for value in (one.min(), one.max())), *(pose.y for pose in ends or ())]
    axes.set_ylim(max(below, min(seen, default=path[0, 1]) - 0.8), max(above, *seen, path[-1, 1]) + 0.6)
    axes.set_aspect("equal")
    drawing.label_axes(axes, "x [m]", "y [m]")


def course_of(source: Source, world: World) -> tuple[Pose2D, Pose2D] | None:
    """Return start and goal of a world under the protocol of a source, None where its configuration does not say."""
    try:
        scene = scene_under(source, world)
    except (BarnError, KeyError, TypeError, ValueError):
        return None
    return (scene.start, scene.goal) if scene.start and scene.goal else None


def trial_data(
    entries: Sequence[Entry],
    drives: Sequence[DrivenTrial],
    worlds: Mapping[str, World],
    problems: Mapping[int, str],
    links: Mapping[Path, str] | None = None,
) -> dict[str, Any]:
    """Return what the page's script needs; drives are all trials in the order of the entries.

    links: to the page of a replay, by the path of its bag.
    """
    measures = with_motion(_MEASURES, [drive.result for drive in drives])
    sources = {drive.result.world_checksum: entries[drive.entry].source for drive in drives}
    return {
        "columns": _columns(measures),
        "safety": safety_of([drive.result for drive in drives]).key,
        "metric": metric_of(entries[0].results).key,
        "entries": [
            {"label": entry.label, "colour": entry.colour, "folder": str(entry.source.path)} for entry in entries
        ],
        "trials": [
            _trial(drive, entries[drive.entry], problems.get(place, ""), links or {}, measures)
            for place, drive in enumerate(drives)
        ],
        "worlds": {checksum: _world(world, sources.get(checksum)) for checksum, world in worlds.items()},
        "channels": CHANNELS,
        "no_number": NO_NUMBER,
        "outline": entries[0].source.outline.plain(),
    }


def _trial(
    drive: DrivenTrial, entry: Entry, problem: str, links: Mapping[Path, str], measures: Sequence[str]
) -> dict[str, Any]:
    result, motion = drive.result, drive.result.motion
    bag = entry.source.bag(result.trial_id)
    return {
        "id": result.trial_id,
        "entry": drive.entry,
        "checksum": result.world_checksum,
        "name": result.world_name,
        "detail": result.detail,
        "seeds": [str(seed) for seed in (result.campaign_seed, result.simulator_seed, result.planner_seed)],
        "problem": problem,
        "bag": str(bag) if bag.exists() else "",
        "replay": links.get(bag, ""),
        "cells": [
            entry.label,
            result.world,
            result.repetition + 1,
            result.outcome.value,
            *(_rounded(MEASURES[key].value(result)) for key in measures),
        ],
        "track": None if drive.track is None else drive.track.packed,
    } | ({} if motion is None else {"phase": motion.phase_s, "touched": motion.touched})


def _columns(keys: Sequence[str]) -> list[dict[str, Any]]:
    measures = [MEASURES[key] for key in keys]
    return [
        *({"name": name, "title": name, "unit": "", "digits": digits} for name, digits in _COLUMNS.items()),
        *({"name": one.key, "title": one.label, "unit": one.unit, "digits": one.digits} for one in measures),
    ]


def _world(world: World, source: Source | None) -> dict[str, Any]:
    arrays = {"cylinders": world.cylinders_m.astype("f4"), "path": world.path_m().astype("f4")}
    if max(map(abs, world.bounds_m)) < 32.0:
        arrays = {name: np.round(1000.0 * values).astype("i2") for name, values in arrays.items()}
    step = 0.001 if arrays["path"].dtype == np.int16 else 1.0
    ends = course_of(source, world) if source else None
    content: dict[str, Any] = {
        "radius": world.cylinder_radius_m,
        "bounds": list(world.bounds_m),
        "step": step,
        "ends": [[round(pose.x, 3), round(pose.y, 3)] for pose in ends or ()],
    }
    if world.moving or world.walls:
        content["moving"] = motion_arrays(world, arrays)
    return content | {"packed": pack(arrays)}


def _rounded(value: float | None) -> float | None:
    return None if value is None else round(value, 4)
