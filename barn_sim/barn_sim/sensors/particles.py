"""Adaptive Monte Carlo localization: scans matched to the map that the robot was given.

The rules are those of the amcl package (Fox 2001, KLD-sampling; Thrun, Burgard and Fox
2005, tables 5.6 and 6.3) as the Jackal's navigation configures it, with the habits of
it that change the result: the weight of a particle is one plus the sum of its beams'
cubed likelihoods, and the motion model draws with variances as if they were standard
deviations. More are options: a correction takes effect late; the map's cells lie
centered on their lower corners, so that poses come out half a cell too low in x and y;
particles anywhere on the map are mixed in when scans fit worse than they did (table
8.3), where the average weight depends on how many particles there are, as in amcl.
"""

import math
from collections import deque
from collections.abc import Callable
from functools import cache

import numpy as np

from barn_sim.config import LocalizationConfig
from barn_worlds.base.arrays import BoolGrid, Floats, Integers, kernel, unit_vectors
from barn_worlds.base.types import (
    ORIGIN,
    OccupancyMap,
    Pose2D,
    Scan,
    nanoseconds,
    wrap_angle,
)
from barn_worlds.worlds.cspace import closest_obstacle

# Costs of map cells from which on they are obstacles.
_OCCUPIED = 65
# Larger distances from obstacles count as this one.
_FARTHEST_M = 2.0
# Size of a histogram bin of KLD-sampling in x, y (m) and yaw (rad).
_BIN = np.array([0.5, 0.5, math.radians(10.0)])
# Largest error of the distribution, and quantile of the normal distribution for it.
_KLD_ERROR = 0.05
_KLD_Z = 0.99
# A shorter step has no direction.
_STEP_M = 0.01


class ParticleLocalization:
    """A particle filter that corrects itself only after the robot has moved enough."""

    def __init__(
        self,
        config: LocalizationConfig,
        rng: np.random.Generator,
        occupancy: OccupancyMap,
        start: Pose2D,
        mount: Pose2D,
    ):
        """Spread the particles around the start pose.

        Args:
            config: Number and noise of the particles and the model of the sensor.
            rng: Source of all that the filter draws.
            occupancy: Map in the map frame.
            start: Start pose of base_link in the map frame.
            mount: Pose of the lidar in base_link.
        """
        self._config = config
        self._rng = rng
        self._mount = mount

        resolution = occupancy.resolution
        shift = 0.5 * resolution if config.half_cell_low else 0.0
        self._grid = (
            occupancy.origin_x - shift,
            occupancy.origin_y - shift,
            resolution,
        )
        # Columns and rows.
        self._free_cells = np.argwhere(occupancy.data == 0)[:, ::-1]
        self._distances_m = obstacle_distances(occupancy.data >= _OCCUPIED, resolution)
        self._table: tuple[float, Floats] | None = None

        self._needed = needed_particles(config.min_particles, config.max_particles)
        stds = np.array(
            [config.initial_std_m, config.initial_std_m, config.initial_yaw_std_rad]
        )
        errors = rng.standard_normal((config.max_particles, 3))
        self._particles = np.array(start.numbers) + stds * errors
        # Slow and fast average of the weights.
        self._averages: tuple[float, float] | None = None
        self._updated_at: Pose2D | None = None
        self._correction = ORIGIN
        # Corrections that wait for the time at which they take effect.
        self._pending: deque[tuple[int, Pose2D]] = deque()

    def estimate(
        self, stamp_ns: int, odometry: Pose2D, take_scan: Callable[[], Scan]
    ) -> Pose2D:
        """Return the pose in map; may take a scan, whose correction counts after a delay.

        Args:
            stamp_ns: Time since the start of the trial.
            odometry: Pose in the odom frame.
            take_scan: Called if the filter needs a scan of this time.

        Returns:
            The pose in the map frame by the correction that is in effect.
        """
        config = self._config
        last = self._updated_at
        if last is None or has_moved(config, last, odometry):
            scan = take_scan()
            effective_ns = stamp_ns
            if last is not None:
                self._move(last, odometry)
                effective_ns += nanoseconds(config.correction_delay_s)
            self._resample(self._weights(scan))
            correction = self._mean_pose() @ odometry.inverse()
            # The first correction holds at once, since there is no estimate before it.
            self._pending.append((effective_ns, correction))
            self._updated_at = odometry
        while self._pending and self._pending[0][0] <= stamp_ns:
            _, self._correction = self._pending.popleft()
        return self._correction @ odometry

    def _move(self, last: Pose2D, odometry: Pose2D) -> None:
        """Move the particles in place by the odometry since `last`, with noise."""
        dx = odometry.x - last.x
        dy = odometry.y - last.y
        length = math.hypot(dx, dy)
        turn = 0.0
        if length >= _STEP_M:
            turn = wrap_angle(math.atan2(dy, dx) - last.yaw)
        final_turn = wrap_angle(wrap_angle(odometry.yaw - last.yaw) - turn)

        noise = self._config.motion_noise
        bend = _bend(turn)
        final_bend = _bend(final_turn)
        turn_spread = noise * (bend**2 + length**2)
        final_spread = noise * (final_bend**2 + length**2)
        length_spread = noise * (length**2 + bend**2 + final_bend**2)

        errors = self._rng.standard_normal((3, len(self._particles)))
        heading = self._particles[:, 2] + turn
        heading -= turn_spread * errors[0]
        step = length - length_spread * errors[1]
        self._particles[:, :2] += step[:, None] * unit_vectors(heading)
        self._particles[:, 2] = heading + final_turn - final_spread * errors[2]

    def _weights(self, scan: Scan) -> Floats:
        """Return the weight (n,) of each particle by how well a scan fits the map."""
        ranges = np.asarray(scan.ranges, np.float64)
        beams = np.arange(len(ranges))
        # amcl takes every so many beams, not evenly spaced angles.
        stride = max((len(ranges) - 1) // (self._config.beams - 1), 1)
        is_hit = np.isfinite(ranges) & (ranges < scan.range_max) & (beams % stride == 0)

        angles = (
            scan.angle_min
            + scan.angle_increment * np.flatnonzero(is_hit)
            + self._mount.yaw
        )
        directions = unit_vectors(angles)
        hits = ranges[is_hit, None] * directions + self._mount.position
        table = self._likelihood_cubes(scan.range_max)
        return particle_weights(self._particles, hits, table, *self._grid)

    def _likelihood_cubes(self, range_max: float) -> Floats:
        """Return cubed hit likelihoods (rows + 2, cols + 2) of map and border."""
        if self._table is None or self._table[0] != range_max:
            config = self._config
            distances = np.pad(self._distances_m, 1, constant_values=_FARTHEST_M)
            # The likelihood field model (Thrun, Burgard and Fox 2005, table 6.3).
            deviations = distances / config.hit_std_m
            likelihoods = config.hit_share * np.exp(-0.5 * deviations**2)
            likelihoods += config.random_share / range_max
            self._table = (range_max, likelihoods**3)
        return self._table[1]

    def _resample(self, weights: Floats) -> None:
        """Replace particles by draws by weight, some anywhere; bins set how many."""
        count = self._config.max_particles
        sums = np.cumsum(weights)
        # Independent draws as in amcl, not a low-variance comb.
        indices = np.searchsorted(
            sums, sums[-1] * self._rng.random(count), side="right"
        )
        particles = self._particles[np.minimum(indices, len(weights) - 1)]

        # The average depends on the number of particles, as in amcl.
        share = self._random_share(float(sums[-1]) / len(weights) ** 2)
        if share > 0.0:
            is_random = self._rng.random(count) < share
            particles[is_random] = self._random_poses(int(is_random.sum()))

        _, firsts = np.unique(bin_keys(particle_bins(particles)), return_index=True)
        fills_bin = np.zeros(count, np.int64)
        fills_bin[firsts] = 1
        is_enough = np.arange(1, count + 1) > self._needed[np.cumsum(fills_bin)]
        if is_enough.any():
            count = int(np.argmax(is_enough)) + 1
        self._particles = particles[:count]

    def _random_share(self, average: float) -> float:
        """Update both average weights; return the share of particles to draw anywhere.

        The averages start anew once particles are drawn anywhere.
        """
        slow, fast = self._averages or (average, average)
        slow += self._config.recovery_alpha_slow * (average - slow)
        fast += self._config.recovery_alpha_fast * (average - fast)
        share = max(0.0, 1.0 - fast / slow)
        self._averages = None if share > 0.0 else (slow, fast)
        return share

    def _random_poses(self, count: int) -> Floats:
        """Return random poses (count, 3) in free cells, or in cell 0, 0 if none."""
        origin_x, origin_y, resolution = self._grid
        cells = np.zeros((count, 2), np.int64)
        if len(self._free_cells):
            indices = self._rng.integers(len(self._free_cells), size=count)
            cells = self._free_cells[indices]
        yaws = self._rng.uniform(-math.pi, math.pi, count)
        positions = (cells + 0.5) * resolution + [origin_x, origin_y]
        return np.column_stack([positions, yaws])

    def _mean_pose(self) -> Pose2D:
        """Return the mean pose of the cluster of touching bins with most particles."""
        bins = particle_bins(self._particles)
        _, firsts, members = np.unique(
            bin_keys(bins), return_index=True, return_inverse=True
        )
        labels = cluster_labels(bins[firsts])[members]
        cluster = self._particles[labels == np.argmax(np.bincount(labels))]
        yaws = cluster[:, 2]
        yaw = math.atan2(np.sin(yaws).mean(), np.cos(yaws).mean())
        x = float(cluster[:, 0].mean())
        y = float(cluster[:, 1].mean())
        return Pose2D(x, y, yaw)


def has_moved(config: LocalizationConfig, last: Pose2D, odometry: Pose2D) -> bool:
    """Tell whether the robot has moved or turned enough for a new correction.

    Args:
        config: Distance and turn between updates.
        last: Pose in the odom frame at the last update.
        odometry: Pose in the odom frame now.
    """
    turn = abs(wrap_angle(odometry.yaw - last.yaw))
    is_far = odometry.distance(last) >= config.update_distance_m
    return is_far or turn >= config.update_turn_rad


def particle_bins(particles: Floats) -> Integers:
    """Return the histogram bin (n, 3) of each particle's x, y (0.5 m), yaw (10 deg)."""
    bins: Integers = np.floor(particles / _BIN).astype(np.int64)
    return bins


def bin_keys(bins: Integers) -> Integers:
    """Return a unique number (n,) for each bin (n, 3); they sort as the bins do."""
    low = bins.min(axis=0)
    _, rows, columns = (bins.max(axis=0) - low + 1).tolist()
    keys: Integers = (bins - low) @ np.array([rows * columns, columns, 1])
    return keys


def obstacle_distances(occupied: BoolGrid, resolution: float) -> Floats:
    """Return each map cell's distance (m) to the nearest occupied one, at most 2 m.

    Args:
        occupied: Cells (rows, columns) of the map.
        resolution: Size of a cell, m.

    Returns:
        Distances (rows, columns) in m, at most 2 m.
    """
    return np.minimum(resolution * closest_obstacle(occupied), _FARTHEST_M)


@cache
def needed_particles(least: int, most: int) -> Integers:
    """Return how many particles to keep per count of filled bins; `most` below two.

    Args:
        least: Smallest number of particles.
        most: Largest number of particles.

    Returns:
        A number for each count of filled bins from 0 to `most`.
    """
    needed = np.full(most + 1, most)
    for bins in range(2, most + 1):
        # Equation 7 of Fox 2001, the quantile of the chi-square distribution.
        ninth = 2.0 / (9.0 * (bins - 1))
        factor = (1.0 - ninth + math.sqrt(ninth) * _KLD_Z) ** 3
        count = math.ceil((bins - 1) / (2.0 * _KLD_ERROR) * factor)
        needed[bins] = min(max(count, least), most)
    needed.flags.writeable = False
    return needed


def cluster_labels(bins: Integers) -> Integers:
    """Return a label (n,) for each bin (n, 3), the same for bins that touch.

    Bins touch at corners as well.
    """
    # A matrix of all pairs is affordable: particles fill a few hundred bins.
    touches = np.abs(bins[:, None] - bins[None]).max(axis=2) <= 1
    labels = np.full(len(bins), -1, np.int64)
    for seed in range(len(bins)):
        if labels[seed] >= 0:
            continue
        cluster = np.zeros(len(bins), np.bool_)
        larger = np.arange(len(bins)) == seed
        while (larger & ~cluster).any():
            cluster = larger
            larger = touches[cluster].any(axis=0)
        labels[cluster] = seed
    return labels


@kernel
def particle_weights(
    particles: Floats,
    hits: Floats,
    table: Floats,
    origin_x: float,
    origin_y: float,
    resolution: float,
) -> Floats:
    """Return each particle's weight (n,): 1 plus the table's values at its beams' ends.

    Args:
        particles: Poses (n, 3) of base_link in the map frame.
        hits: Ends of the beams (m, 2) in base_link, m.
        table: A value for each cell of the map, within a border of one cell that stands
            for everything off the map.
        origin_x: Lower edge of the map without its border, m.
        origin_y: Lower edge of the map without its border, m.
        resolution: Size of a cell, m.
    """
    rows, cols = table.shape
    values = table.ravel()
    hit_x = hits[:, 0].copy()
    hit_y = hits[:, 1].copy()
    last_row = rows - 2.0
    last_col = cols - 2.0
    width = np.int32(cols)
    cells = np.empty(len(hits), np.int32)
    weights = np.empty(len(particles))
    for i in range(len(particles)):
        x = particles[i, 0]
        y = particles[i, 1]
        c = math.cos(particles[i, 2])
        s = math.sin(particles[i, 2])

        # Apart from the sum, so that the compiler finds several cells at once.
        for k in range(len(hits)):
            row = np.floor((y + s * hit_x[k] + c * hit_y[k] - origin_y) / resolution)
            col = np.floor((x + c * hit_x[k] - s * hit_y[k] - origin_x) / resolution)
            row = -1.0 if row < -1.0 else row
            row = last_row if row > last_row else row
            col = -1.0 if col < -1.0 else col
            col = last_col if col > last_col else col
            border_row = np.int32(row) + np.int32(1)
            cells[k] = border_row * width + np.int32(col) + np.int32(1)

        total = 1.0
        for k in range(len(hits)):
            total += values[cells[k]]
        weights[i] = total
    return weights


def _bend(turn: float) -> float:
    """Return how far a turn is from straight ahead or straight back, rad."""
    return min(abs(turn), abs(wrap_angle(turn - math.pi)))
