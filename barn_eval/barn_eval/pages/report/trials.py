"""The trials of a report, with tracks and worlds as far as there are any, and what the page's script gets of them."""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any

import numpy as np

from barn_eval.analysis.measures import MEASURES, with_moving_measures
from barn_eval.analysis.sources import Entry, Source, read_worlds
from barn_eval.pages.replay.payload import motion_arrays
from barn_eval.results.bags.movers import compute_gaps
from barn_eval.results.rows import TRACKS_FILE
from barn_eval.results.tracks import (
    CHANNELS,
    MISSING_SAMPLE,
    Track,
    pack_arrays,
    parse_track_line,
)
from barn_eval.trials.result import TrialResult
from barn_worlds.base.arrays import Floats
from barn_worlds.base.errors import BarnError, ConfigError
from barn_worlds.geometry.bodies import moving_bodies, wall_bodies
from barn_worlds.geometry.footprint import Footprint
from barn_worlds.worlds.scene import TrialScene, scene_of
from barn_worlds.worlds.world import World

_POSE = slice(CHANNELS.index("x"), CHANNELS.index("yaw") + 1)


@dataclass(frozen=True, eq=False)
class DrivenTrial:
    """A trial as pages draw it: its place among all, its entry, its result, its track if there is one.

    problem: what it lacks and why, empty where its track and world are there.
    """

    place: int
    entry: Entry
    result: TrialResult
    track: Track | None
    problem: str = ""

    @property
    def poses(self) -> Floats:
        """Poses (n, 3) of the track, none without one."""
        return np.empty((0, 3)) if self.track is None else self.track.samples[:, _POSE]

    @property
    def end_s(self) -> float:
        """When the track ends."""
        return 0.0 if self.track is None else float(self.track.samples[-1, 0])


def driven_trials(
    entries: Sequence[Entry],
) -> tuple[list[DrivenTrial], dict[str, World]]:
    """Return the trials of entries in their order, and their worlds by checksum."""
    results = [(entry, result) for entry in entries for result in entry.results]
    found = read_worlds((one, entry.source) for entry, one in results)
    drives = []
    for place, (entry, result) in enumerate(results):
        track, world = kept_track(entry.source, result), found[result.world_checksum]
        problem = "; ".join(one for one in (world, track) if isinstance(one, str))
        if isinstance(track, Track) and isinstance(world, World):
            track = _with_motion(track, result, world, entry.source.outline)
        drives.append(
            DrivenTrial(
                place,
                entry,
                result,
                track if isinstance(track, Track) else None,
                problem,
            )
        )
    return drives, {
        checksum: world for checksum, world in found.items() if isinstance(world, World)
    }


def worlds_by_number(
    drives: Sequence[DrivenTrial], worlds: Mapping[str, World]
) -> dict[int, World]:
    """Return worlds by number, without those of which trials disagree or that are not there."""
    known: dict[int, set[str]] = {}
    for drive in drives:
        known.setdefault(drive.result.world, set()).add(drive.result.world_checksum)
    sole = {
        number: min(checksums)
        for number, checksums in known.items()
        if len(checksums) == 1
    }
    return {
        number: worlds[checksum]
        for number, checksum in sole.items()
        if checksum in worlds
    }


def kept_track(source: Source, result: TrialResult) -> Track | str:
    """Return the track kept beside a result, else why there is none."""
    line = source.tracks.get(result.trial_id)
    if line is None:
        return "no track of this trial was kept, so there is no trajectory to show"
    try:
        return parse_track_line(
            line, f"{source.path / TRACKS_FILE}, {result.trial_id}"
        )[1]
    except ConfigError as error:
        return str(error)


def _with_motion(
    track: Track, result: TrialResult, world: World, outline: Footprint
) -> Track:
    """Return a track whose clearance is also that to walls and to what moved, at the times of its samples."""
    if result.motion is None:
        return track
    samples, phase_s = track.samples.copy(), result.motion.phase_s
    places, _ = world.tracks.over(samples[:, 0] + phase_s)
    bodies = moving_bodies(world.tracks, phase_s)
    gaps = compute_gaps(
        bodies, wall_bodies(world.walls), places, samples[:, 1:4], outline
    )
    samples[:, -1] = np.fmin(samples[:, -1], gaps)
    return replace(track, samples=samples)


def scene_under(source: Source, world: World) -> TrialScene:
    """Return a world with start and goal under the protocol of a source; BarnError if that cannot be told."""
    rules = source.run_config.protocol.scaled_to(world, source.chassis)
    course = rules.course(world)
    return scene_of(world, course.start, course.goal, rules.goal_distance_m)


def known_scene(source: Source, world: World) -> TrialScene:
    """Return a world with start and goal under the protocol of a source, without them where it does not say."""
    try:
        return scene_under(source, world)
    except (BarnError, KeyError, TypeError, ValueError):
        return scene_of(world)


# The page's table has these columns, with their digits (None: a text), then those of measures.
_COLUMNS = {"planner": None, "world": 0, "trial": 0, "outcome": None}
_MEASURES: tuple[str, ...] = (
    "traversal_time_s",
    "normalised_time_s_per_m",
    "challenge",
    "driven_m",
)
_MEASURES += ("min_clearance_m", "contact_s", "compute_p95_ms", "missed_cycles")


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
    measures = keys or with_moving_measures(
        _MEASURES, [drive.result for drive in drives]
    )
    heads: list[tuple[str, str, str, int | None]] = [
        (name, name, "", digits) for name, digits in _COLUMNS.items()
    ]
    heads += [
        (one.key, one.label, one.unit, one.digits)
        for one in map(MEASURES.__getitem__, measures)
    ]
    numbers = {entry: number for number, entry in enumerate(entries)}
    sources = {drive.result.world_checksum: drive.entry.source for drive in drives}
    return {
        "columns": [
            dict(zip(("name", "title", "unit", "digits"), head, strict=True))
            for head in heads
        ],
        "entries": [
            {"label": one.label, "colour": one.color, "folder": str(one.source.path)}
            for one in entries
        ],
        "trials": [
            _trial(drive, numbers[drive.entry], links or {}, measures)
            for drive in drives
        ],
        "worlds": {
            checksum: _world(world, sources.get(checksum))
            for checksum, world in worlds.items()
        },
        "channels": CHANNELS,
        "no_number": MISSING_SAMPLE,
        "outline": entries[0].source.outline.plain(),
    }


def _trial(
    drive: DrivenTrial, number: int, links: Mapping[Path, str], measures: Sequence[str]
) -> dict[str, Any]:
    entry, result, motion = drive.entry, drive.result, drive.result.motion
    bag = entry.source.bag(result.trial_id)
    cells: list[Any] = [
        entry.label,
        result.world,
        result.repetition + 1,
        result.outcome.value,
    ]
    values = (MEASURES[key].value(result) for key in measures)
    cells += [None if value is None else round(value, 4) for value in values]
    return {
        "id": result.trial_id,
        "entry": number,
        "checksum": result.world_checksum,
        "name": result.world_name,
        "detail": result.detail,
        "seeds": [
            str(seed)
            for seed in (
                result.campaign_seed,
                result.simulator_seed,
                result.planner_seed,
            )
        ],
        "problem": drive.problem,
        "bag": str(bag) if bag.exists() else "",
        "replay": links.get(bag, ""),
        "cells": cells,
        "track": None if drive.track is None else drive.track.packed,
    } | ({} if motion is None else {"phase": motion.phase_s, "touched": motion.touched})


def _world(world: World, source: Source | None) -> dict[str, Any]:
    arrays = {
        "cylinders": world.cylinders_m.astype("f4"),
        "path": world.path_m().astype("f4"),
    }
    step = 1.0
    if max(map(abs, world.bounds_m)) < 32.0:
        arrays, step = (
            {
                name: np.round(1000.0 * values).astype("i2")
                for name, values in arrays.items()
            },
            0.001,
        )
    ends = known_scene(source, world).ends_m() if source else np.empty((0, 2))
    content: dict[str, Any] = {
        "radius": world.cylinder_radius_m,
        "bounds": list(world.bounds_m),
        "step": step,
    }
    content["ends"] = ends.round(3).tolist()
    if world.moving or world.walls:
        content["moving"] = motion_arrays(world, arrays)
    return content | {"packed": pack_arrays(arrays)}
