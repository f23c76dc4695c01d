"""The data behind a report's table of trials and its view of a single one."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from typing import Any

import numpy as np

from barn_eval.analysis.sources import Entry
from barn_eval.experiments.packing import pack
from barn_eval.experiments.track import CHANNELS, NO_NUMBER
from barn_eval.pages.maps import Drive
from barn_eval.pages.page import PALETTE
from barn_sim.model import jackal
from barn_worlds.world import World

# Name, title, unit, digits; the page's table has these columns in this order.
COLUMNS = (
    ("planner", "planner", "", None),
    ("world", "world", "", 0),
    ("trial", "trial", "", 0),
    ("outcome", "outcome", "", None),
    ("time", "time", "s", 2),
    ("normalised", "per metre as counted", "s/m", 2),
    ("challenge", "challenge metric", "", 3),
    ("driven", "driven", "m", 2),
    ("clearance", "smallest clearance", "m", 3),
    ("contact", "contact", "s", 2),
    ("compute", "compute p95", "ms", 2),
    ("missed", "missed cycles", "", 0),
)


def trial_data(
    entries: Sequence[Entry], drives: Sequence[Drive], worlds: Mapping[str, World], problems: Mapping[int, str]
) -> dict[str, Any]:
    """Return what the page's script needs; drives are all trials in the order of the entries."""
    return {
        "columns": [dict(zip(("name", "title", "unit", "digits"), column, strict=True)) for column in COLUMNS],
        "entries": [
            {"label": entry.label, "colour": PALETTE[index % len(PALETTE)], "folder": str(entry.source.path)}
            for index, entry in enumerate(entries)
        ],
        "trials": [_trial(drive, entries[drive.entry], problems.get(place, "")) for place, drive in enumerate(drives)],
        "worlds": {checksum: _world(world) for checksum, world in worlds.items()},
        "channels": CHANNELS,
        "no_number": NO_NUMBER,
        "extent": jackal().extent().tolist(),
    }


def _trial(drive: Drive, entry: Entry, problem: str) -> dict[str, Any]:
    result, measures, clock = drive.result, drive.result.measures, drive.result.wall_clock
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
            _rounded(result.scores.traversal_time_s),
            _rounded(result.scores.normalised_time_s_per_m),
            _rounded(result.scores.challenge),
            _rounded(measures.driven_m),
            _rounded(measures.min_clearance_m),
            _rounded(measures.contact_s),
            _rounded(clock.compute_p95_ms),
            clock.missed_cycles,
        ],
        "track": None if drive.track is None else drive.track.packed,
    }


def _world(world: World) -> dict[str, Any]:
    arrays = {"cylinders": world.cylinders_m.astype("f4"), "path": world.path_m().astype("f4")}
    if max(map(abs, world.bounds_m)) < 32.0:
        arrays = {name: np.round(1000.0 * values).astype("i2") for name, values in arrays.items()}
    step = 0.001 if arrays["path"].dtype == np.int16 else 1.0
    return {"radius": world.cylinder_radius_m, "bounds": list(world.bounds_m), "step": step, "packed": pack(arrays)}


def _rounded(value: float | None) -> float | None:
    return None if value is None else round(value, 4)
