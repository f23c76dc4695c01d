"""The trials of a report with their tracks and worlds, and the data of its script."""

import math
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from functools import cached_property
from pathlib import Path
from typing import Any

import numpy as np

from barn_eval.analysis.entries import Entry
from barn_eval.analysis.measures import MEASURES, SHOWN, with_moving_measures
from barn_eval.analysis.sources import Source, read_worlds
from barn_eval.pages.figures import DASHES, look_numbers
from barn_eval.pages.replay.payload import (
    MAX_MILLIMETERS_M,
    Arrays,
    motion_arrays,
    pack_small,
)
from barn_eval.results.bags.movers import compute_gaps
from barn_eval.results.row_table import join
from barn_eval.results.rows import TRACKS_FILE
from barn_eval.results.tracks import CHANNELS, MISSING_SAMPLE, Track, parse_track_line
from barn_eval.trials.result import TrialResult
from barn_worlds.base.arrays import Floats
from barn_worlds.base.errors import BarnError, ConfigError
from barn_worlds.geometry.bodies import moving_bodies, wall_bodies
from barn_worlds.geometry.footprint import Footprint
from barn_worlds.worlds.scene import TrialScene, scene_of
from barn_worlds.worlds.world import World

_POSE = slice(CHANNELS.index("x"), CHANNELS.index("yaw") + 1)
# Columns of the page's table before those of measures, with their digits; None: text.
_COLUMNS = {"planner": None, "world": 0, "trial": 0, "outcome": None}


@dataclass(frozen=True, eq=False)
class DrivenTrial:
    """A trial as pages draw it."""

    entry: Entry
    result: TrialResult

    world: World | str
    """Its world, or why that is missing."""

    @property
    def has_track(self) -> bool:
        """Whether a track was kept, even if it is damaged."""
        return self.result.trial_id in self.entry.source.tracks

    @cached_property
    def _recorded(self) -> Track | str:
        """The track, with clearance to moving obstacles, or why it is missing; cached."""
        source = self.entry.source
        recorded = _read_track(source, self.result)
        if isinstance(recorded, str) or isinstance(self.world, str):
            return recorded
        return _add_moving_clearance(recorded, self.result, self.world, source.outline)

    @property
    def track(self) -> Track | None:
        """The track; None if there is none that can be read."""
        return None if isinstance(self._recorded, str) else self._recorded

    @property
    def problem(self) -> str:
        """What is missing and why; empty if track and world are available."""
        parts = (self.world, self._recorded)
        return "; ".join(part for part in parts if isinstance(part, str))

    @property
    def poses(self) -> Floats:
        """Poses x, y [m], yaw [rad] of the track (n, 3); no rows without a track."""
        if self.track is None:
            return np.empty((0, 3))
        return self.track.samples[:, _POSE]

    @property
    def end_s(self) -> float:
        """Time of the track's last sample since the start [s]; 0.0 without a track."""
        return 0.0 if self.track is None else float(self.track.samples[-1, 0])


def read_trials(entries: Sequence[Entry]) -> list[DrivenTrial]:
    """Return all trials by entry with their worlds; tracks are read on demand."""
    trials = [(entry, result) for entry in entries for result in entry.results]
    worlds = read_worlds((result, entry.source) for entry, result in trials)
    return [
        DrivenTrial(entry, result, worlds[result.world_checksum])
        for entry, result in trials
    ]


def _read_track(source: Source, result: TrialResult) -> Track | str:
    """Return the track of a trial, or a text that says why there is none."""
    line = source.tracks.get(result.trial_id)
    if line is None:
        return "no track of this trial was kept, so there is no trajectory to show"
    place = f"{source.path / TRACKS_FILE}, {result.trial_id}"
    try:
        return parse_track_line(line, place)[1]
    except ConfigError as error:
        return str(error)


def _add_moving_clearance(
    track: Track, result: TrialResult, world: World, outline: Footprint
) -> Track:
    """Return a track whose clearance counts moving obstacles; itself if none moves.

    Walls count as well.
    """
    if result.motion is None:
        return track
    samples = track.samples.copy()
    phase_s = result.motion.phase_s
    # A track's times begin with the trial, the obstacles' motion began before.
    places, _ = world.tracks.over(samples[:, 0] + phase_s)
    gaps = compute_gaps(
        moving_bodies(world.tracks, phase_s),
        wall_bodies(world.walls),
        places,
        samples[:, _POSE],
        outline,
    )
    # The last channel is the clearance, NaN where there are no cylinders: fmin
    # ignores that.
    samples[:, -1] = np.fmin(samples[:, -1], gaps)
    return replace(track, samples=samples, content=None)


def make_scene(source: Source, world: World) -> TrialScene:
    """Return a world with a folder's start and goal; BarnError if they are unknown.

    Args:
        source: The results folder.
        world: A world that its trials ran in.

    Raises:
        BarnError: The configuration does not say.
    """
    rules = source.run_config.protocol.scaled_to(world, source.chassis)
    course = rules.course(world)
    return scene_of(world, course.start, course.goal, rules.goal_distance_m)


def make_scene_if_known(source: Source, world: World) -> TrialScene:
    """Return a world with start and goal, or without them if they are unknown.

    Args:
        source: The results folder.
        world: A world that its trials ran in.
    """
    try:
        return make_scene(source, world)
    # The configuration of a folder may be incomplete or changed by hand.
    except (BarnError, KeyError, TypeError, ValueError):
        return scene_of(world)


def positions_by_world(trials: Sequence[DrivenTrial]) -> dict[str, list[int]]:
    """Return the positions of trials in the list by the checksum of their world."""
    positions: dict[str, list[int]] = {}
    for position, trial in enumerate(trials):
        positions.setdefault(trial.result.world_checksum, []).append(position)
    return positions


def page_data(
    entries: Sequence[Entry], trials: Sequence[DrivenTrial], keys: Sequence[str] = ()
) -> tuple[dict[str, Any], list[list[Any]]]:
    """Return the page script's data and a row per trial; `keys` replace its measures.

    Args:
        entries: Planners of the report.
        trials: All their trials in the order of the entries.
        keys: Keys of the measures in the table. By default the usual ones.

    Returns:
        What is the same for all trials. A row has the trial's name, the positions of
        its planner and its world, how it ended, and the cells of the table but for the
        planner.
    """
    results = join([entry.results for entry in entries])
    measure_keys = keys or with_moving_measures(SHOWN["report trials"], results)
    columns: list[tuple[Any, ...]] = []
    for name, digits in _COLUMNS.items():
        columns.append((name, name, "", digits))
    for key in measure_keys:
        measure = MEASURES[key]
        columns.append((key, measure.label, measure.unit, measure.digits))

    entry_data = []
    for entry, number in zip(
        entries, look_numbers([entry.color for entry in entries]), strict=True
    ):
        dashes = DASHES[number]
        entry_data.append(
            {
                "label": entry.label,
                "color": entry.color,
                "folder": str(entry.source.path),
                "marker": number,
                # A line without gaps is named by a text.
                "dash": [] if isinstance(dashes, str) else dashes[1],
            }
        )
    numbers = {entry: number for number, entry in enumerate(entries)}
    worlds = {trial.result.world_checksum: trial.result.world_name for trial in trials}
    places = {checksum: place for place, checksum in enumerate(worlds)}
    figures = [MEASURES[key].raw_values(results) for key in measure_keys]
    rows = []
    for trial, values in zip(trials, np.transpose(figures).tolist(), strict=True):
        result = trial.result
        row: list[Any] = [
            result.trial_id,
            numbers[trial.entry],
            places[result.world_checksum],
            result.detail,
            result.world,
            result.repetition + 1,
            result.outcome.value,
        ]
        for value in values:
            # More digits than any column shows would only make the page larger.
            row.append(None if math.isnan(value) else round(value, 4))
        rows.append(row)
    data = {
        # Name, title, unit and digits, which a text has none of.
        "columns": columns,
        "entries": entry_data,
        "worlds": list(worlds.values()),
        "channels": CHANNELS,
        "no_number": MISSING_SAMPLE,
        "outline": entries[0].source.outline.plain(),
    }
    return data, rows


def world_part(
    trials: Sequence[DrivenTrial], positions: Sequence[int], links: Mapping[Path, str]
) -> dict[str, Any]:
    """Return a world and the records of its trials as JSON data for the page's script.

    Args:
        trials: All trials of the report.
        positions: Positions of those in the world.
        links: Address of each trial's replay by the path of its bag.
    """
    first = trials[positions[0]]
    world = None
    if isinstance(first.world, World):
        world = _world_data(first.world, first.entry.source)
    records = {p: _trial_record(trials[p], links) for p in positions}
    return {"world": world, "trials": records}


def _trial_record(trial: DrivenTrial, links: Mapping[Path, str]) -> dict[str, Any]:
    """Return a trial's record as JSON data, with its track packed."""
    result = trial.result
    bag = trial.entry.source.bag(result.trial_id)
    # JavaScript has no whole numbers beyond 53 bits, so seeds are texts.
    seeds = (result.campaign_seed, result.simulator_seed, result.planner_seed)
    record: dict[str, Any] = {
        "seeds": [str(seed) for seed in seeds],
        "problem": trial.problem,
        "bag": str(bag) if bag.exists() else "",
        "replay": links.get(bag, ""),
        "track": None if trial.track is None else trial.track.packed,
    }
    if result.motion is not None:
        record["phase"] = result.motion.phase_s
        record["touched"] = result.motion.touched
    return record


def _world_data(world: World, source: Source) -> dict[str, Any]:
    """Return a world for the page's script, in whole millimeters where it fits.

    Start and goal are by the protocol of `source`.
    """
    arrays: Arrays = {
        "cylinders": world.cylinders_m.astype("f4"),
        "path": world.path_m().astype("f4"),
    }
    step_m = 1.0
    if max(map(abs, world.bounds_m)) < MAX_MILLIMETERS_M:
        step_m = 0.001
        for name, values in arrays.items():
            arrays[name] = np.round(1000.0 * values).astype("i2")

    ends = make_scene_if_known(source, world).ends_m()
    data: dict[str, Any] = {
        "radius": world.cylinder_radius_m,
        "bounds": list(world.bounds_m),
        "step": step_m,
        "ends": ends.round(3).tolist(),
    }
    if world.moving or world.walls:
        data["moving"] = motion_arrays(world, arrays)
    return data | {"packed": pack_small(arrays)}
