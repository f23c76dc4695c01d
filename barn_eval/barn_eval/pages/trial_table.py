"""Single trials in a report: the data behind their table and the view of each, and maps of the hardest worlds."""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np
from matplotlib.axes import Axes
from matplotlib.figure import Figure
from matplotlib.lines import Line2D

from barn_eval.analysis.difficulty import Difficulty
from barn_eval.analysis.measures import MEASURES
from barn_eval.analysis.sources import Entry
from barn_eval.experiments.track import CHANNELS, NO_NUMBER, Track, pack
from barn_eval.pages import drawing
from barn_eval.trials.result import TrialResult
from barn_sim.model import jackal
from barn_worlds.world import World

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
    """A trial on a map: the number of its entry, its result and its track, None if there is none."""

    entry: int
    result: TrialResult
    track: Track | None


def hardest_figure(
    entries: Sequence[Entry],
    order: Difficulty,
    worlds: Mapping[int, World],
    drives: Mapping[int, Sequence[DrivenTrial]],
) -> Figure:
    """Draw each world (by its number, hardest first) with its trails; a cross is where a trial ended that failed."""
    rows = -(-len(worlds) // _PER_ROW)
    figure = drawing.new_figure(4.9 * rows + 0.5)
    panels = figure.subplots(rows, _PER_ROW, squeeze=False).ravel()
    for axes in panels[len(worlds) :]:
        axes.set_axis_off()
    for axes, (number, world) in zip(panels, worlds.items(), strict=False):
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
    names = [*(entry.label for entry in entries), "end of a failed trial", "shortest path"]
    drawing.legend_below(figure, [*handles, failed, path], names)
    return figure


def _draw(axes: Axes, entries: Sequence[Entry], world: World, drives: Sequence[DrivenTrial]) -> None:
    drawing.discs(axes, world.cylinders_m, world.cylinder_radius_m, facecolor=drawing.FAINT)
    path = world.path_m()
    axes.plot(path[:, 0], path[:, 1], color=drawing.FAINT, linestyle="--", linewidth=1.4)
    for drive in drives:
        if drive.track is None:
            continue
        colour = entries[drive.entry].colour
        trail = drive.track.samples[:, 1:3]
        axes.plot(trail[:, 0], trail[:, 1], color=colour, linewidth=1.5, alpha=0.8)
        if not drive.result.scores.success:
            axes.plot(*trail[-1], color=colour, marker="x", markersize=9, markeredgewidth=2.4, zorder=5)
    left, below, right, above = world.bounds_m
    axes.set_xlim(left, right)
    lowest = min((float(drive.track.samples[:, 2].min()) for drive in drives if drive.track), default=path[0, 1])
    axes.set_ylim(max(below, lowest - 0.8), above + 0.6)
    axes.set_aspect("equal")
    drawing.label_axes(axes, "x [m]", "y [m]")


def trial_data(
    entries: Sequence[Entry], drives: Sequence[DrivenTrial], worlds: Mapping[str, World], problems: Mapping[int, str]
) -> dict[str, Any]:
    """Return what the page's script needs; drives are all trials in the order of the entries."""
    return {
        "columns": _columns(),
        "entries": [
            {"label": entry.label, "colour": entry.colour, "folder": str(entry.source.path)} for entry in entries
        ],
        "trials": [_trial(drive, entries[drive.entry], problems.get(place, "")) for place, drive in enumerate(drives)],
        "worlds": {checksum: _world(world) for checksum, world in worlds.items()},
        "channels": CHANNELS,
        "no_number": NO_NUMBER,
        "extent": jackal().extent().tolist(),
    }


def _trial(drive: DrivenTrial, entry: Entry, problem: str) -> dict[str, Any]:
    result = drive.result
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
        "cells": [
            entry.label,
            result.world,
            result.repetition + 1,
            result.outcome.value,
            *(_rounded(MEASURES[key].value(result)) for key in _MEASURES),
        ],
        "track": None if drive.track is None else drive.track.packed,
    }


def _columns() -> list[dict[str, Any]]:
    measures = [MEASURES[key] for key in _MEASURES]
    return [
        *({"name": name, "title": name, "unit": "", "digits": digits} for name, digits in _COLUMNS.items()),
        *({"name": one.key, "title": one.label, "unit": one.unit, "digits": one.digits} for one in measures),
    ]


def _world(world: World) -> dict[str, Any]:
    arrays = {"cylinders": world.cylinders_m.astype("f4"), "path": world.path_m().astype("f4")}
    if max(map(abs, world.bounds_m)) < 32.0:
        arrays = {name: np.round(1000.0 * values).astype("i2") for name, values in arrays.items()}
    step = 0.001 if arrays["path"].dtype == np.int16 else 1.0
    return {"radius": world.cylinder_radius_m, "bounds": list(world.bounds_m), "step": step, "packed": pack(arrays)}


def _rounded(value: float | None) -> float | None:
    return None if value is None else round(value, 4)
