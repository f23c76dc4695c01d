"""The trajectories of a report: read from bags on all processors, thinned out and rounded to whole numbers."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from functools import cached_property
from pathlib import Path
from typing import Any

import joblib
import numpy as np
import numpy.typing as npt

from barn_eval.page import pack
from barn_eval.replay.recorded import read_recorded
from barn_eval.report.columns import NoColumnsError, read_columns
from barn_eval.trajectory import clearances
from barn_sim.model import jackal
from barn_worlds.errors import BagError

Floats = npt.NDArray[np.float64]

MOST_SAMPLES = 240
NO_NUMBER = -32768
_LARGEST = 32767
_POSE = ("pose.pose.position.x", "pose.pose.position.y", "pose.pose.orientation.z", "pose.pose.orientation.w")
_WANTED = {
    "/ground_truth/odom": (*_POSE, "twist.twist.linear.x", "twist.twist.angular.z"),
    "/cmd_vel": ("linear.x", "angular.z"),
    "/collision": ("data",),
}
# Smallest step of what a sample holds, in its own unit; a track that does not fit takes a multiple.
_STEPS = (0.01, 0.005, 0.005, 0.0005, 0.002, 0.002, 0.002, 0.002, 0.002)
CHANNELS = ("time", "x", "y", "yaw", "speed", "turn", "command_speed", "command_turn", "clearance")


@dataclass(frozen=True, eq=False)
class Track:
    """What a robot did, thinned out: (n, 9) after `CHANNELS` (s, m, rad, m/s, rad/s; NaN: none), contact (n,)."""

    samples: Floats
    contact: npt.NDArray[np.bool_]
    note: str = ""

    @cached_property
    def packed(self) -> dict[str, Any]:
        """Differences of whole numbers, which pack well, the step of each channel, and the note."""
        return _packed(self)


@dataclass(frozen=True, eq=False)
class Wanted:
    """A trial whose track is wanted: its bag and the cylinders (k, 2) of its world."""

    bag: Path
    cylinders_m: Floats
    radius_m: float


def read_tracks(wanted: Sequence[Wanted], parallel: joblib.Parallel) -> list[Track | str]:
    """Return the track of each bag, or in words why there is none."""
    size = max(8, len(wanted) // 64)
    parts = [wanted[first : first + size] for first in range(0, len(wanted), size)]
    done = parallel(joblib.delayed(_read_part)(part) for part in parts)
    return [track for part in done for track in part]


def read_track(wanted: Wanted) -> Track | str:
    """Return the track of one bag, or in words why there is none."""
    if not wanted.bag.exists():
        return "no bag was kept"
    try:
        whole, contact, note = whole_trajectory(wanted.bag)
    except BagError as error:
        return str(error)
    gaps = clearances(whole[:, 1:4], wanted.cylinders_m, wanted.radius_m, jackal().extent())
    whole = np.column_stack([whole, gaps if len(gaps) else np.full(len(whole), np.nan)])
    return _thinned(whole, contact, note)


def whole_trajectory(bag: Path) -> tuple[Floats, npt.NDArray[np.bool_], str]:
    """Return samples (n, 8) after `CHANNELS` without clearance, contact (n,) and what is to be said of the bag."""
    files = list(bag.glob("*.mcap"))
    if len(files) == 1:
        try:
            columns = read_columns(files[0], _WANTED)
            if len(columns["/ground_truth/odom"]):
                return (*_from_columns(columns), "")
        except NoColumnsError:
            pass
    return whole_trajectory_slowly(bag)


def whole_trajectory_slowly(bag: Path) -> tuple[Floats, npt.NDArray[np.bool_], str]:
    """Return the same from every message of the bag, which works for one that is cut off or damaged as well."""
    recorded = read_recorded(bag)
    rows = np.column_stack([recorded.times_s, recorded.poses, recorded.speeds, recorded.commands])
    return rows, recorded.contact, "; ".join(recorded.notes)


def _packed(track: Track) -> dict[str, Any]:
    largest = np.nanmax(np.abs(track.samples), axis=0, initial=0.0)
    steps = np.array(_STEPS)
    steps = steps * np.maximum(1.0, np.ceil(largest / (steps * (_LARGEST - 1))))
    known = np.isfinite(track.samples)
    whole = np.where(known, np.round(np.where(known, track.samples, 0.0) / steps), NO_NUMBER).astype(np.int16)
    differences = np.diff(whole, axis=0, prepend=np.zeros((1, len(CHANNELS)), np.int16))  # wraps around, as intended
    content = pack({"samples": differences.T.ravel(), "contact": track.contact.astype(np.uint8)})
    return content | {"steps": steps.tolist(), "note": track.note}


def _read_part(part: Sequence[Wanted]) -> list[Track | str]:
    tracks = [read_track(one) for one in part]
    for track in tracks:
        if isinstance(track, Track):
            _ = track.packed  # made here, where all processors are at work, and kept with the track
    return tracks


def _from_columns(columns: dict[str, Floats]) -> tuple[Floats, npt.NDArray[np.bool_]]:
    truth = columns["/ground_truth/odom"]
    yaw = (2.0 * np.arctan2(truth[:, 3], truth[:, 4]) + np.pi) % (2.0 * np.pi) - np.pi
    times = truth[:, 0]
    command = _held(times, columns["/cmd_vel"], np.nan)
    contact = _held(times, columns["/collision"], 0.0)[:, 0] > 0.0
    return np.column_stack([times - times[0], truth[:, 1:3], yaw, truth[:, 5:7], command]), contact


def _held(times: Floats, rows: Floats, empty: float) -> Floats:
    """Return the last of the values by each time."""
    values = np.concatenate([np.full((1, rows.shape[1] - 1), empty), rows[:, 1:]])
    found: Floats = values[np.searchsorted(rows[:, 0], times, side="right")]
    return found


def _thinned(samples: Floats, contact: npt.NDArray[np.bool_], note: str) -> Track:
    """Return every k-th sample and the last one; contact and smallest clearance are those since the one before."""
    stride = -(-len(samples) // MOST_SAMPLES)
    first = np.arange(0, len(samples), stride)
    kept = np.minimum(first + stride - 1, len(samples) - 1)
    thinned = samples[kept]
    thinned[:, -1] = np.minimum.reduceat(samples[:, -1], first)
    thinned = np.concatenate([samples[:1], thinned]) if kept[0] else thinned
    touched = np.logical_or.reduceat(contact, first)
    return Track(thinned, np.concatenate([contact[:1], touched]) if kept[0] else touched, note)
