"""Single trials in a report: the data behind their table, their points and the view of each."""

from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Any

import numpy as np

from barn_eval.analysis.measures import MEASURES, with_motion
from barn_eval.analysis.sources import Entry, Source
from barn_eval.experiments.track import CHANNELS, NO_NUMBER, pack
from barn_eval.pages.replay.payload import motion_arrays
from barn_eval.pages.report.maps import known_scene
from barn_eval.pages.report.trials import DrivenTrial
from barn_worlds.worlds.world import World

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
    entries: Sequence[Entry],
    drives: Sequence[DrivenTrial],
    worlds: Mapping[str, World],
    links: Mapping[Path, str] | None = None,
    keys: Sequence[str] = (),
) -> dict[str, Any]:
    """Return what the page's script needs; drives are all trials in the order of the entries.

    links: to the page of a replay, by the path of its bag. keys: of the measures shown, those usual without any.
    """
    measures = keys or with_motion(_MEASURES, [drive.result for drive in drives])
    named = [MEASURES[key] for key in measures]
    columns: list[dict[str, Any]] = [
        {"name": name, "title": name, "unit": "", "digits": digits} for name, digits in _COLUMNS.items()
    ]
    columns += [{"name": one.key, "title": one.label, "unit": one.unit, "digits": one.digits} for one in named]
    numbers = {entry: number for number, entry in enumerate(entries)}
    sources = {drive.result.world_checksum: drive.entry.source for drive in drives}
    return {
        "columns": columns,
        "entries": [{"label": one.label, "colour": one.colour, "folder": str(one.source.path)} for one in entries],
        "trials": [_trial(drive, numbers[drive.entry], links or {}, measures) for drive in drives],
        "worlds": {checksum: _world(world, sources.get(checksum)) for checksum, world in worlds.items()},
        "channels": CHANNELS,
        "no_number": NO_NUMBER,
        "outline": entries[0].source.outline.plain(),
    }


def _trial(drive: DrivenTrial, number: int, links: Mapping[Path, str], measures: Sequence[str]) -> dict[str, Any]:
    entry, result, motion = drive.entry, drive.result, drive.result.motion
    bag = entry.source.bag(result.trial_id)
    cells: list[Any] = [entry.label, result.world, result.repetition + 1, result.outcome.value]
    values = (MEASURES[key].value(result) for key in measures)
    cells += [None if value is None else round(value, 4) for value in values]
    return {
        "id": result.trial_id,
        "entry": number,
        "checksum": result.world_checksum,
        "name": result.world_name,
        "detail": result.detail,
        "seeds": [str(seed) for seed in (result.campaign_seed, result.simulator_seed, result.planner_seed)],
        "problem": drive.problem,
        "bag": str(bag) if bag.exists() else "",
        "replay": links.get(bag, ""),
        "cells": cells,
        "track": None if drive.track is None else drive.track.packed,
    } | ({} if motion is None else {"phase": motion.phase_s, "touched": motion.touched})


def _world(world: World, source: Source | None) -> dict[str, Any]:
    arrays = {"cylinders": world.cylinders_m.astype("f4"), "path": world.path_m().astype("f4")}
    step = 1.0
    if max(map(abs, world.bounds_m)) < 32.0:
        arrays, step = {name: np.round(1000.0 * values).astype("i2") for name, values in arrays.items()}, 0.001
    ends = known_scene(source, world).ends_m() if source else np.empty((0, 2))
    content: dict[str, Any] = {"radius": world.cylinder_radius_m, "bounds": list(world.bounds_m), "step": step}
    content["ends"] = ends.round(3).tolist()
    if world.moving or world.walls:
        content["moving"] = motion_arrays(world, arrays)
    return content | {"packed": pack(arrays)}
