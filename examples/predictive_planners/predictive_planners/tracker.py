"""A tracker that finds discs in scans and estimates a constant velocity of each.

A circle is fitted to each cluster of returns (I. Kasa, IEEE Trans. Instrumentation and
Measurement 25(1), 1976). Its center does not wander as the robot drives past, unlike
the mean of the returns. A cluster that is not round is a wall. An alpha-beta filter
continues each track by the nearest circle.
"""

import math
from dataclasses import dataclass, field
from typing import NamedTuple

import numpy as np

from barn_planners.interface import FloatArray, Observation
from barn_worlds.base.arrays import side_lengths, unit_vectors
from barn_worlds.base.config import Checked, quantity
from barn_worlds.base.types import NANOSECONDS_PER_SECOND, Pose2D


@dataclass(frozen=True)
class TrackerConfig(Checked):
    """Settings of the tracker.

    The defaults are for people and robots at up to 3 m/s, scanned 20 times a second.
    """

    within_m: float = quantity(
        8.0, "returns that are further away are left out", "m", 0.5, 100.0
    )
    split_m: float = quantity(
        0.25, "distance of neighboring returns that splits clusters", "m", minimum=0.01
    )
    least_returns: int = quantity(6, "fewest returns of a cluster", "", 3, 1000)
    most_radius_m: float = quantity(0.9, "largest radius of a circle", "m", 0.05, 10.0)
    roundness_m: float = quantity(
        0.03, "largest mean distance of its returns from a circle", "m", minimum=0.001
    )
    match_m: float = quantity(
        0.5, "a circle continues a track if its center is this near", "m", minimum=0.01
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


class Circle(NamedTuple):
    """A circle and how well points fit it."""

    center: FloatArray  # (2,) in m
    radius_m: float
    roundness_m: float  # mean distance of the points from the circle


@dataclass
class _Track:
    center: FloatArray  # (2,) in m in odom
    radius_m: float
    stamp_ns: int  # of the last scan that shows it
    velocity: FloatArray = field(default_factory=lambda: np.zeros(2))  # (2,) in m/s
    sightings: int = 1

    def correct(self, circle: Circle, period_s: float, config: TrackerConfig) -> None:
        """Take over a share of the circle's offset from the prediction."""
        offset = circle.center - self.center
        self.center = self.center + config.position_gain * offset
        if period_s > 0.0:
            # A new track has no velocity yet: its first offsets count in full.
            gain = max(config.velocity_gain, 1.0 / self.sightings)
            self.velocity = self.velocity + gain * offset / period_s
        self.radius_m += config.position_gain * (circle.radius_m - self.radius_m)
        self.sightings += 1


class Tracker:
    """Follows discs from scan to scan; nothing in it is random."""

    def __init__(self, config: TrackerConfig, lidar: Pose2D) -> None:
        """Start without tracks.

        Args:
            config: Limits and gains.
            lidar: Pose of the lidar in base_link.
        """
        self.config = config
        self._lidar = lidar
        self.reset()

    def reset(self) -> None:
        """Forget everything."""
        self._tracks: list[_Track] = []
        self._last_ns: int | None = None

    def update(self, observation: Observation) -> FloatArray:
        """Add a scan and return the discs that move; an older scan changes nothing."""
        stamp_ns = observation.stamp_ns
        period_s = 0.0
        if self._last_ns is not None:
            if stamp_ns <= self._last_ns:
                return self.moving_discs()
            period_s = (stamp_ns - self._last_ns) / NANOSECONDS_PER_SECOND
        self._last_ns = stamp_ns

        for track in self._tracks:
            track.center = track.center + period_s * track.velocity
        self._match(self._circles(observation), period_s, stamp_ns)
        limit_ns = self.config.forget_s * NANOSECONDS_PER_SECOND
        self._tracks = [
            track for track in self._tracks if stamp_ns - track.stamp_ns <= limit_ns
        ]
        return self.moving_discs()

    def moving_discs(self) -> FloatArray:
        """Return the discs that move as of the last scan.

        Returns:
            Discs (k, 5): x and y in m and velocity in m/s in odom, radius in m.
        """
        config = self.config
        discs = [
            [*track.center, *track.velocity, track.radius_m]
            for track in self._tracks
            if track.sightings >= config.sightings
            and math.hypot(*track.velocity) >= config.least_speed_mps
        ]
        return np.array(discs, np.float64).reshape(-1, 5)

    def _circles(self, observation: Observation) -> list[Circle]:
        """Return the circle of each round cluster of returns, in odom."""
        config = self.config
        scan = observation.scan
        ranges = scan.ranges.astype(np.float64)
        limit_m = min(scan.range_max, config.within_m)
        beams = np.flatnonzero((ranges >= scan.range_min) & (ranges <= limit_m))
        if len(beams) < config.least_returns:
            return []

        angles = scan.angles()[beams] + self._lidar.yaw
        x = self._lidar.x + ranges[beams] * np.cos(angles)
        y = self._lidar.y + ranges[beams] * np.sin(angles)
        points = observation.odometry.pose.transform(np.stack([x, y], axis=1))

        # A cluster ends where the next return is far away or beams returned nothing.
        distances = side_lengths(points)
        is_split = (distances > config.split_m) | (np.diff(beams) > 2)
        circles = []
        for cluster in np.split(points, np.flatnonzero(is_split) + 1):
            if len(cluster) < config.least_returns:
                continue
            circle = fit_circle(cluster)
            is_round = circle.roundness_m <= config.roundness_m
            if is_round and circle.radius_m <= config.most_radius_m:
                circles.append(circle)
        return circles

    def _match(self, circles: list[Circle], period_s: float, stamp_ns: int) -> None:
        """Continue tracks by circles, nearest first; other circles begin tracks."""
        pairs = [
            (float(np.hypot(*(circle.center - track.center))), i, j)
            for i, track in enumerate(self._tracks)
            for j, circle in enumerate(circles)
        ]
        free_tracks = set(range(len(self._tracks)))
        free_circles = dict(enumerate(circles))
        for distance_m, i, j in sorted(pairs):
            is_free = i in free_tracks and j in free_circles
            if distance_m <= self.config.match_m and is_free:
                free_tracks.remove(i)
                self._tracks[i].correct(free_circles.pop(j), period_s, self.config)
                self._tracks[i].stamp_ns = stamp_ns
        for circle in free_circles.values():
            self._tracks.append(_Track(circle.center, circle.radius_m, stamp_ns))


def fit_circle(points: FloatArray) -> Circle:
    """Return the circle that fits points (n, 2); a line has infinite radius."""
    middle = points.mean(axis=0)
    offsets = points - middle
    squares = (offsets**2).sum(axis=1)

    # Kasa's fit is linear in the center, so it is the solution of two equations.
    matrix = offsets.T @ offsets
    right_side = offsets.T @ (squares - squares.mean())
    scale = max(float(np.trace(matrix)) ** 2, 1e-300)
    if np.linalg.det(matrix) <= 1e-12 * scale:
        return Circle(middle, math.inf, math.inf)
    center = 0.5 * np.linalg.solve(matrix, right_side)
    radius_m = math.sqrt(float(center @ center) + float(squares.mean()))
    distances = np.hypot(*(offsets - center).T)
    roundness_m = float(np.abs(distances - radius_m).mean())
    return Circle(middle + center, radius_m, roundness_m)


def transform_discs(discs: FloatArray, frame: Pose2D) -> FloatArray:
    """Return discs in another frame.

    Args:
        discs: Discs (k, 5) as of `Tracker`.
        frame: Pose of their frame in the other one.
    """
    if not len(discs):
        return discs
    c = math.cos(frame.yaw)
    s = math.sin(frame.yaw)
    velocities = discs[:, 2:4] @ np.array([[c, -s], [s, c]]).T
    return np.column_stack([frame.transform(discs[:, :2]), velocities, discs[:, 4]])


def meeting_distances(
    discs: FloatArray, directions: FloatArray, radius_m: float, speed_mps: float
) -> FloatArray:
    """Return how far a robot drives in each direction until it meets a disc.

    Args:
        discs: Discs (k, 5) as of `Tracker`, in base_link.
        directions: Directions (n,) in rad.
        radius_m: Radius of the robot.
        speed_mps: Constant speed of the robot.

    Returns:
        Distances (n,) in m; +inf where no disc is met.
    """
    # Seen from the robot, a disc moves along a line. It is met where its distance
    # equals the sum of the radii: the first solution of a quadratic equation.
    units = unit_vectors(directions)[:, None, :]
    motion_per_m = discs[None, :, 2:4] / speed_mps - units
    offset = discs[None, :, :2]
    a = (motion_per_m**2).sum(axis=2)
    b = (motion_per_m * offset).sum(axis=2)
    c = (offset**2).sum(axis=2) - (discs[None, :, 4] + radius_m) ** 2
    discriminant = b**2 - a * c
    with np.errstate(divide="ignore", invalid="ignore"):
        first = (-b - np.sqrt(discriminant)) / a
    first[np.broadcast_to(c <= 0.0, first.shape)] = 0.0
    meets = (discriminant >= 0.0) & (b < 0.0)
    distances: FloatArray = np.where(meets, first, np.inf)
    return distances.min(axis=1, initial=np.inf)
