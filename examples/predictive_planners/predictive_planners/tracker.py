"""Discs tracked in the scans, each with a constant velocity.

A circle is fitted to each cluster of returns (I. Kasa, IEEE Trans. Instrumentation and Measurement 25(1), 1976), since
its centre does not wander as the robot drives past; what is no circle is a wall. An alpha-beta filter continues tracks
by the nearest one.
"""

import math
from dataclasses import dataclass

import numpy as np

from barn_planners.interface import FloatArray, Observation
from barn_worlds.base.config import Checked, quantity
from barn_worlds.base.types import NANOSECONDS_PER_SECOND, Pose2D


@dataclass(frozen=True)
class TrackerConfig(Checked):
    """Settings of the tracker; the defaults are for people and robots at up to 3 m/s, seen 20 times a second."""

    within_m: float = quantity(
        8.0, "returns that are further away are left out", "m", 0.5, 100.0
    )
    split_m: float = quantity(
        0.25, "distance of neighbouring returns that splits clusters", "m", minimum=0.01
    )
    least_returns: int = quantity(6, "fewest returns of a cluster", "", 3, 1000)
    most_radius_m: float = quantity(0.9, "largest radius of a circle", "m", 0.05, 10.0)
    roundness_m: float = quantity(
        0.03, "largest mean distance of its returns from a circle", "m", minimum=0.001
    )
    match_m: float = quantity(
        0.5, "a circle continues a track if its centre is this near", "m", minimum=0.01
    )
    position_gain: float = quantity(
        0.5, "share of a measured offset taken over", "", 0.0, 1.0
    )
    velocity_gain: float = quantity(
        0.15, "share of an offset's speed taken over", "", 0.0, 1.0
    )
    sightings: int = quantity(
        6, "a track counts once it has been seen this often", "", 1, 1000
    )
    least_speed_mps: float = quantity(
        0.25, "a track that is slower stands", "m/s", 0.0, 10.0
    )
    forget_s: float = quantity(0.3, "a track not seen for longer ends", "s", 0.0, 60.0)


@dataclass
class _Track:
    centre: FloatArray
    velocity: FloatArray
    radius_m: float
    seen_ns: int
    sightings: int = 1


class Tracker:
    """Follows discs from scan to scan; deterministic."""

    def __init__(self, config: TrackerConfig, lidar: Pose2D) -> None:
        self.config = config
        self._lidar = lidar
        self.reset()

    def reset(self) -> None:
        """Forget everything."""
        self._tracks: list[_Track] = []
        self._last_ns: int | None = None

    def update(self, observation: Observation) -> FloatArray:
        """Take a scan; return the discs that move, (k, 5): centre x, y (m) and velocity (m/s) in odom, radius (m)."""
        stamp_ns = observation.stamp_ns
        if self._last_ns is not None and stamp_ns <= self._last_ns:
            return self.moving()
        period_s = (
            0.0
            if self._last_ns is None
            else (stamp_ns - self._last_ns) / NANOSECONDS_PER_SECOND
        )
        self._last_ns = stamp_ns
        for track in self._tracks:
            track.centre = track.centre + period_s * track.velocity
        found = self._circles(observation)
        self._match(found, period_s, stamp_ns)
        limit_ns = self.config.forget_s * NANOSECONDS_PER_SECOND
        self._tracks = [
            track for track in self._tracks if stamp_ns - track.seen_ns <= limit_ns
        ]
        return self.moving()

    def moving(self) -> FloatArray:
        """Return the discs that move, (k, 5), as of the last scan."""
        config = self.config
        rows = [
            (*track.centre.tolist(), *track.velocity.tolist(), track.radius_m)
            for track in self._tracks
            if track.sightings >= config.sightings
            and math.hypot(*track.velocity.tolist()) >= config.least_speed_mps
        ]
        return np.array(rows, np.float64).reshape(-1, 5)

    def _circles(self, observation: Observation) -> list[tuple[FloatArray, float]]:
        """Return centre (2,) in odom and radius of the circle of each round cluster."""
        config, scan = self.config, observation.scan
        ranges = scan.ranges.astype(np.float64)
        seen = np.flatnonzero(
            (ranges >= scan.range_min)
            & (ranges <= min(scan.range_max, config.within_m))
        )
        if len(seen) < config.least_returns:
            return []
        lidar, angles = self._lidar, scan.angles()[seen] + self._lidar.yaw
        local = np.stack(
            [
                lidar.x + ranges[seen] * np.cos(angles),
                lidar.y + ranges[seen] * np.sin(angles),
            ],
            axis=1,
        )
        points = observation.odometry.pose.transform(local)
        apart = (np.hypot(*np.diff(points, axis=0).T) > config.split_m) | (
            np.diff(seen) > 2
        )
        found = []
        for cluster in np.split(points, np.flatnonzero(apart) + 1):
            if len(cluster) >= config.least_returns:
                centre, radius_m, roundness_m = fitted_circle(cluster)
                if (
                    radius_m <= config.most_radius_m
                    and roundness_m <= config.roundness_m
                ):
                    found.append((centre, radius_m))
        return found

    def _match(
        self, found: list[tuple[FloatArray, float]], period_s: float, stamp_ns: int
    ) -> None:
        """Continue tracks with circles, the nearest pair first; what is left begins tracks."""
        config, tracks = self.config, self._tracks
        pairs = sorted(
            (float(np.hypot(*(centre - track.centre))), place, index)
            for place, track in enumerate(tracks)
            for index, (centre, _) in enumerate(found)
        )
        taken_tracks, taken = set(), set()
        for away_m, place, index in pairs:
            if away_m > config.match_m or place in taken_tracks or index in taken:
                continue
            taken_tracks.add(place)
            taken.add(index)
            track, (centre, radius_m) = tracks[place], found[index]
            offset = centre - track.centre
            track.centre = track.centre + config.position_gain * offset
            if period_s > 0.0:
                # the first steps tell the velocity as a whole, later ones refine it
                gain = max(config.velocity_gain, 1.0 / track.sightings)
                track.velocity = track.velocity + gain * offset / period_s
            track.radius_m += config.position_gain * (radius_m - track.radius_m)
            track.seen_ns, track.sightings = stamp_ns, track.sightings + 1
        tracks += [
            _Track(centre, np.zeros(2), radius_m, stamp_ns)
            for index, (centre, radius_m) in enumerate(found)
            if index not in taken
        ]


def fitted_circle(points: FloatArray) -> tuple[FloatArray, float, float]:
    """Return centre (2,), radius and mean distance of points (n, 2) from their circle; infinite for a line."""
    middle = points.mean(axis=0)
    off = points - middle
    square = (off**2).sum(axis=1)
    matrix, right = off.T @ off, off.T @ (square - square.mean())
    if np.linalg.det(matrix) <= 1e-12 * max(float(np.trace(matrix)) ** 2, 1e-300):
        return middle, math.inf, math.inf
    centre = 0.5 * np.linalg.solve(matrix, right)
    radius_m = math.sqrt(float(centre @ centre) + float(square.mean()))
    roundness_m = float(np.abs(np.hypot(*(off - centre).T) - radius_m).mean())
    return middle + centre, radius_m, roundness_m


def moved(discs: FloatArray, by: Pose2D) -> FloatArray:
    """Return discs (k, 5) in another frame, in which the present one has a pose."""
    if not len(discs):
        return discs
    turn = np.array(
        [[math.cos(by.yaw), -math.sin(by.yaw)], [math.sin(by.yaw), math.cos(by.yaw)]]
    )
    return np.column_stack(
        [by.transform(discs[:, :2]), discs[:, 2:4] @ turn.T, discs[:, 4]]
    )


def meeting_distances(
    discs: FloatArray, directions: FloatArray, radius_m: float, speed_mps: float
) -> FloatArray:
    """Return how far (n,) a disc comes from the origin in each direction before it meets one of discs (k, 5)."""
    ways = np.stack([np.cos(directions), np.sin(directions)], axis=1)[:, None, :]
    relative = discs[None, :, 2:4] / speed_mps - ways  # per metre driven
    offset = discs[None, :, :2]
    a, b = (relative**2).sum(axis=2), (relative * offset).sum(axis=2)
    c = (offset**2).sum(axis=2) - (discs[None, :, 4] + radius_m) ** 2
    root = b**2 - a * c
    with np.errstate(divide="ignore", invalid="ignore"):
        first = np.where(c <= 0.0, 0.0, (-b - np.sqrt(root)) / a)
    nearest: FloatArray = np.where((root >= 0.0) & (b < 0.0), first, np.inf).min(
        axis=1, initial=np.inf
    )
    return nearest
