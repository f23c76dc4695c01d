"""The data behind a report's table of trials and its view of a single one."""

from collections.abc import Mapping, Sequence
from typing import Any

import numpy as np

from barn_eval.analysis.measures import MEASURES
from barn_eval.analysis.sources import Entry
from barn_eval.experiments.packing import pack
from barn_eval.experiments.track import CHANNELS, NO_NUMBER
from barn_eval.pages.world_maps import DrivenTrial
from barn_sim.model import jackal
from barn_worlds.world import World

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
