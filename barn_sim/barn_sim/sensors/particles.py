"""Adaptive Monte Carlo localisation with particles: scans matched to the map that the robot was given.

The rules are those of the amcl package (Fox 2001, KLD-sampling; Thrun, Burgard and Fox 2005, tables 5.6 and 6.3) as the
Jackal's navigation configures it, with those of its habits that move the result: the weight of a particle is one plus
the sum of its beams' cubed likelihoods, and the motion model draws with variances as if they were standard deviations.
More are options: a correction takes effect late; the map's cells lie centred on their lower corners, so that poses come
out half a cell too low in x and y; particles anywhere on the map are mixed in when scans fit worse than they did (table
8.3), where the average weight depends on how many particles there are, as in amcl.
"""

import math
from collections import deque
from collections.abc import Callable
from functools import cache

import numpy as np
from numba import njit

from barn_sim.config import LocalizationConfig
from barn_worlds.base.arrays import Floats, Integers
from barn_worlds.base.types import OccupancyMap, Pose2D, Scan, nanoseconds, wrap_angle

_OCCUPIED = 65
_FARTHEST_M = 2.0  # distances from obstacles beyond this count as this
_BIN = np.array(
    [0.5, 0.5, math.radians(10.0)]
)  # m, m, rad: particles in one bin count once
_KLD_ERROR, _KLD_Z = 0.05, 0.99
_CLOSE_M = 0.01  # a step shorter than this has no direction


class ParticleLocalization:
    """A particle filter; the correction from odom to map changes only when the robot has moved or turned enough."""

    def __init__(
        self,
        config: LocalizationConfig,
        rng: np.random.Generator,
        known: OccupancyMap,
        start: Pose2D,
        lidar: Pose2D,
    ) -> None:
        """Spread the particles around `start`, the robot's pose in the map frame; lidar: its pose in base_link."""
        self._config, self._rng, self._lidar = config, rng, lidar
        half = 0.5 * known.resolution if config.half_cell_low else 0.0
        self._grid = (known.origin_x - half, known.origin_y - half, known.resolution)
        self._free = np.argwhere(known.data == 0)[:, ::-1]  # columns and rows
        self._distances_m = obstacle_distances(
            known.data >= _OCCUPIED, known.resolution
        )
        self._likelihoods: tuple[float, Floats] | None = None
        self._needed = needed_particles(config.min_particles, config.max_particles)
        stds = np.array(
            [config.initial_std_m, config.initial_std_m, config.initial_yaw_std_rad]
        )
        start_pose = np.array([start.x, start.y, start.yaw])
        self._particles = start_pose + stds * rng.standard_normal(
            (config.max_particles, 3)
        )
        self._averages: tuple[float, float] | None = (
            None  # of the weights, slow and fast
        )
        self._updated_at: Pose2D | None = None
        self._correction = Pose2D(0.0, 0.0, 0.0)
        self._pending: deque[tuple[int, Pose2D]] = (
            deque()
        )  # corrections made, and when each takes effect

    def estimate(
        self, stamp_ns: int, odometry: Pose2D, look: Callable[[], Scan]
    ) -> Pose2D:
        """Return the pose by the correction in effect, making a new one with a scan first if the robot has moved."""
        if self._updated_at is None or has_moved(
            self._config, self._updated_at, odometry
        ):
            scan = look()
            if self._updated_at is not None:
                self._move(self._updated_at, odometry)
            self._resample(self._weights(scan))
            due_ns = (
                stamp_ns + nanoseconds(self._config.correction_delay_s)
                if self._updated_at
                else stamp_ns
            )
            self._pending.append((due_ns, self._mean() @ odometry.inverse()))
            self._updated_at = odometry
        while self._pending and self._pending[0][0] <= stamp_ns:
            self._correction = self._pending.popleft()[1]
        return self._correction @ odometry

    def _move(self, last: Pose2D, odometry: Pose2D) -> None:
        """Move every particle as the odometry did, with noise of its own."""
        dx, dy = odometry.x - last.x, odometry.y - last.y
        length = math.hypot(dx, dy)
        first = wrap_angle(math.atan2(dy, dx) - last.yaw) if length >= _CLOSE_M else 0.0
        second = wrap_angle(wrap_angle(odometry.yaw - last.yaw) - first)
        turns = [
            min(abs(turn), abs(wrap_angle(turn - math.pi))) for turn in (first, second)
        ]  # reverse is no turn
        noise = self._config.motion_noise
        spread_turns = [noise * (turn**2 + length**2) for turn in turns]
        spread_length = noise * (length**2 + turns[0] ** 2 + turns[1] ** 2)
        drawn = self._rng.standard_normal((3, len(self._particles)))
        heading = self._particles[:, 2] + first - spread_turns[0] * drawn[0]
        step = length - spread_length * drawn[1]
        self._particles[:, :2] += step[:, None] * np.stack(
            [np.cos(heading), np.sin(heading)], axis=1
        )
        self._particles[:, 2] = heading + second - spread_turns[1] * drawn[2]

    def _weights(self, scan: Scan) -> Floats:
        """Return how well the scan fits the map at each particle (n,), not normalised."""
        ranges = np.asarray(scan.ranges, np.float64)
        seen = np.isfinite(ranges) & (ranges < scan.range_max)
        seen &= (
            np.arange(len(seen)) % max((len(seen) - 1) // (self._config.beams - 1), 1)
            == 0
        )
        angles = (
            scan.angle_min
            + scan.angle_increment * np.flatnonzero(seen)
            + self._lidar.yaw
        )
        hits = ranges[seen, None] * np.stack([np.cos(angles), np.sin(angles)], axis=1)
        hits += [self._lidar.x, self._lidar.y]
        weights: Floats = fit(
            self._particles, hits, self._cubed(scan.range_max), *self._grid
        )
        return weights

    def _cubed(self, range_max: float) -> Floats:
        """Return the cubed likelihood of a hit in each cell of the map, within a border for hits off the map."""
        if self._likelihoods is None or self._likelihoods[0] != range_max:
            config = self._config
            distances = np.pad(self._distances_m, 1, constant_values=_FARTHEST_M)
            likelihoods = config.hit_share * np.exp(
                -0.5 * (distances / config.hit_std_m) ** 2
            )
            likelihoods += config.random_share / range_max
            self._likelihoods = range_max, likelihoods**3
        return self._likelihoods[1]

    def _resample(self, weights: Floats) -> None:
        """Draw particles by their weights until there are as many as the number of bins that they fill asks for."""
        most = self._config.max_particles
        cumulated = np.cumsum(weights)
        drawn = np.searchsorted(
            cumulated, cumulated[-1] * self._rng.random(most), side="right"
        )
        particles = self._particles[np.minimum(drawn, len(weights) - 1)]
        if (lost := self._lost(float(cumulated[-1]) / len(weights) ** 2)) > 0.0:
            anywhere = self._rng.random(most) < lost
            particles[anywhere] = self._anywhere(int(anywhere.sum()))
        _, first = np.unique(bin_keys(bins_of(particles)), return_index=True)
        is_new = np.zeros(most, np.int64)
        is_new[first] = 1
        enough = np.arange(1, most + 1) > self._needed[np.cumsum(is_new)]
        self._particles = particles[
            : int(np.argmax(enough)) + 1 if enough.any() else most
        ]

    def _lost(self, average: float) -> float:
        """Return the share of particles to draw anywhere, from the average weight of this scan; it starts anew then."""
        slow, fast = self._averages or (average, average)
        slow += self._config.recovery_alpha_slow * (average - slow)
        fast += self._config.recovery_alpha_fast * (average - fast)
        lost = max(0.0, 1.0 - fast / slow)
        self._averages = None if lost > 0.0 else (slow, fast)
        return lost

    def _anywhere(self, count: int) -> Floats:
        """Return poses (count, 3) in free cells of the map, headed anywhere."""
        origin_x, origin_y, resolution = self._grid
        cells = (
            self._free[self._rng.integers(len(self._free), size=count)]
            if len(self._free)
            else np.zeros((count, 2))
        )
        yaws = self._rng.uniform(-math.pi, math.pi, count)
        return np.column_stack(
            [(cells + 0.5) * resolution + [origin_x, origin_y], yaws]
        )

    def _mean(self) -> Pose2D:
        """Return the mean of the largest cluster: particles in bins that touch one another."""
        bins = bins_of(self._particles)
        _, first, member = np.unique(
            bin_keys(bins), return_index=True, return_inverse=True
        )
        cluster = clusters(bins[first])[member]
        chosen = self._particles[cluster == np.argmax(np.bincount(cluster))]
        yaw = math.atan2(np.sin(chosen[:, 2]).mean(), np.cos(chosen[:, 2]).mean())
        return Pose2D(float(chosen[:, 0].mean()), float(chosen[:, 1].mean()), yaw)


def has_moved(config: LocalizationConfig, last: Pose2D, odometry: Pose2D) -> bool:
    """Tell whether the robot has moved or turned enough for a new correction."""
    turned = abs(wrap_angle(odometry.yaw - last.yaw))
    return (
        odometry.distance(last) >= config.update_distance_m
        or turned >= config.update_turn_rad
    )


def bins_of(particles: Floats) -> Integers:
    """Return the bin of x, y and yaw that each particle lies in (n, 3)."""
    bins: Integers = np.floor(particles / _BIN).astype(np.int64)
    return bins


def bin_keys(bins: Integers) -> Integers:
    """Return a number for each bin (n, 3); they sort as the bins do, coordinate by coordinate."""
    low = bins.min(axis=0)
    _, rows, columns = (bins.max(axis=0) - low + 1).tolist()
    keys: Integers = (bins - low) @ np.array([rows * columns, columns, 1])
    return keys


@njit(cache=True)
def obstacle_distances(occupied, resolution):  # type: ignore[no-untyped-def]
    """Return the distance in metres of each cell's centre from that of the nearest occupied one, at most 2 m."""
    cells = np.argwhere(occupied)
    distances = np.full(occupied.shape, _FARTHEST_M)
    for row in range(occupied.shape[0]) if len(cells) else range(0):
        for col in range(occupied.shape[1]):
            nearest = np.iinfo(np.int64).max
            for k in range(len(cells)):
                nearest = min(
                    nearest, (cells[k, 0] - row) ** 2 + (cells[k, 1] - col) ** 2
                )
            distances[row, col] = min(math.sqrt(nearest) * resolution, _FARTHEST_M)
    return distances


@cache
def needed_particles(least: int, most: int) -> Integers:
    """Return how many particles keep the error of KLD-sampling low, for 0 to `most` filled bins."""
    needed = np.full(most + 1, most)
    for bins in range(2, most + 1):
        ninth = 2.0 / (9.0 * (bins - 1))
        found = math.ceil(
            (bins - 1)
            / (2.0 * _KLD_ERROR)
            * (1.0 - ninth + math.sqrt(ninth) * _KLD_Z) ** 3
        )
        needed[bins] = min(max(found, least), most)
    needed.flags.writeable = False
    return needed


def clusters(bins: Integers) -> Integers:
    """Return the number of the cluster of each bin (n, 3); bins that touch, corners included, share one."""
    touch = np.abs(bins[:, None] - bins[None]).max(axis=2) <= 1
    found = np.full(len(bins), -1, np.int64)
    for seed in range(len(bins)):
        if found[seed] < 0:
            reached = np.zeros(len(bins), np.bool_)
            grown = np.arange(len(bins)) == seed
            while (grown & ~reached).any():
                reached = grown
                grown = touch[reached].any(axis=0)
            found[reached] = seed
    return found


@njit(cache=True, error_model="numpy")
def fit(particles, hits, table, origin_x, origin_y, resolution):  # type: ignore[no-untyped-def]
    """Return one plus the sum over hits (m, 2) in base_link of the table's value where they lie, for each particle.

    table: a value per cell, within a border of one cell that stands for all that is off the map. Cells are found apart
    from the sum, so that the compiler does several at once.
    """
    rows, cols = table.shape
    values = table.ravel()
    hit_x, hit_y = hits[:, 0].copy(), hits[:, 1].copy()
    last_row, last_col, width = rows - 2.0, cols - 2.0, np.int32(cols)
    cells = np.empty(len(hits), np.int32)
    weights = np.empty(len(particles))
    for i in range(len(particles)):
        x, y = particles[i, 0], particles[i, 1]
        c, s = math.cos(particles[i, 2]), math.sin(particles[i, 2])
        for k in range(len(hits)):
            row = np.floor((y + s * hit_x[k] + c * hit_y[k] - origin_y) / resolution)
            col = np.floor((x + c * hit_x[k] - s * hit_y[k] - origin_x) / resolution)
            row = -1.0 if row < -1.0 else row
            row = last_row if row > last_row else row
            col = -1.0 if col < -1.0 else col
            col = last_col if col > last_col else col
            cells[k] = (
                (np.int32(row) + np.int32(1)) * width + np.int32(col) + np.int32(1)
            )
        total = 1.0
        for k in range(len(hits)):
            total += values[cells[k]]
        weights[i] = total
    return weights
