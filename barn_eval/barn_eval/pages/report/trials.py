"""The trials of a report, with their tracks and worlds as far as there are any."""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace

import numpy as np

from barn_eval.analysis.sources import Entry, Source, read_worlds
from barn_eval.bags.movers import gaps_to
from barn_eval.experiments.rows import TRACKS_NAME
from barn_eval.experiments.track import CHANNELS, Track, from_track_line
from barn_eval.trials.result import TrialResult
from barn_worlds.base.arrays import Floats
from barn_worlds.base.errors import ConfigError
from barn_worlds.geometry.bodies import moving_bodies, wall_bodies
from barn_worlds.geometry.footprint import Footprint
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


def driven_trials(entries: Sequence[Entry]) -> tuple[list[DrivenTrial], dict[str, World]]:
    """Return the trials of entries in their order, and their worlds by checksum."""
    results = [(entry, result) for entry in entries for result in entry.results]
    found = read_worlds((one, entry.source) for entry, one in results)
    drives = []
    for place, (entry, result) in enumerate(results):
        track, world = kept_track(entry.source, result), found[result.world_checksum]
        problem = "; ".join(one for one in (world, track) if isinstance(one, str))
        if isinstance(track, Track) and isinstance(world, World):
            track = _with_motion(track, result, world, entry.source.outline)
        drives.append(DrivenTrial(place, entry, result, track if isinstance(track, Track) else None, problem))
    return drives, {checksum: world for checksum, world in found.items() if isinstance(world, World)}


def worlds_by_number(drives: Sequence[DrivenTrial], worlds: Mapping[str, World]) -> dict[int, World]:
    """Return worlds by number, without those of which trials disagree or that are not there."""
    known: dict[int, set[str]] = {}
    for drive in drives:
        known.setdefault(drive.result.world, set()).add(drive.result.world_checksum)
    sole = {number: min(checksums) for number, checksums in known.items() if len(checksums) == 1}
    return {number: worlds[checksum] for number, checksum in sole.items() if checksum in worlds}


def kept_track(source: Source, result: TrialResult) -> Track | str:
    """Return the track kept beside a result, else why there is none."""
    line = source.tracks.get(result.trial_id)
    if line is None:
        return "no track of this trial was kept, so there is no trajectory to show"
    try:
        return from_track_line(line, f"{source.path / TRACKS_NAME}, {result.trial_id}")[1]
    except ConfigError as error:
        return str(error)


def _with_motion(track: Track, result: TrialResult, world: World, outline: Footprint) -> Track:
    """Return a track whose clearance is also that to walls and to what moved, at the times of its samples."""
    if result.motion is None:
        return track
    samples, phase_s = track.samples.copy(), result.motion.phase_s
    places, _ = world.tracks.over(samples[:, 0] + phase_s)
    bodies = moving_bodies(world.tracks, phase_s)
    gaps = gaps_to(bodies, wall_bodies(world.walls), places, samples[:, 1:4], outline)
    samples[:, -1] = np.fmin(samples[:, -1], gaps)
    return replace(track, samples=samples)
