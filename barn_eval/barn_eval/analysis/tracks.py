"""The trajectories of a report that are only in bags, read from those on all processors."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path

import joblib
import numpy as np
import numpy.typing as npt

from barn_eval.analysis.columns import NoColumnsError, read_columns
from barn_eval.bags.recorded import read_recorded
from barn_eval.experiments.track import Track, thinned
from barn_eval.trials.trajectory import clearances
from barn_sim.model import jackal
from barn_worlds.errors import BagError

Floats = npt.NDArray[np.float64]

_POSE = ("pose.pose.position.x", "pose.pose.position.y", "pose.pose.orientation.z", "pose.pose.orientation.w")
_WANTED = {
    "/ground_truth/odom": (*_POSE, "twist.twist.linear.x", "twist.twist.angular.z"),
    "/cmd_vel": ("linear.x", "angular.z"),
    "/collision": ("data",),
}


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
    return thinned(whole, contact, note)


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
