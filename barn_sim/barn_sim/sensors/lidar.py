"""A planar laser scanner with noise and range limits."""

import math
from functools import cache

import numpy as np

from barn_sim.config import LidarConfig
from barn_sim.sensors.ray_casting import Fan, Limits, cast_beams, cast_sweep, measure
from barn_worlds.base.arrays import Floats, Singles, unit_vectors
from barn_worlds.base.types import NANOSECONDS_PER_SECOND, Pose2D, Scan

# Neighboring beams whose ranges differ by more than this do not hit the same object.
_EDGE_M = 0.2
# No tilted cylinders, or no other shapes.
NO_SHAPES = np.empty((0, 7))


class Lidar:
    """A scanner with noise, range limits and the values of REP-117."""

    rng: np.random.Generator
    """Source of all noise."""

    mount: Pose2D
    """Pose in base_link."""

    directions: Floats
    """Unit vectors (n, 2) of the beams in the sensor frame."""

    fan: Fan
    """Angle of the first beam and from beam to beam in rad, longest range in m."""

    limits: Limits
    """Noise in m and as a share of the range, shortest and longest range in m."""

    sweeps: bool
    """Whether beams are taken in turn while the mirror rotates."""

    ages_ns: Floats
    """Time (n,) from each beam of a sweep to the last one; 0 if the lidar does not."""

    def __init__(self, config: LidarConfig, rng: np.random.Generator):
        """Set up beams, limits, mask and blackouts, with `rng` for all noise.

        Args:
            config: Fan, range limits, mounting and errors of the lidar.
            rng: Source of all noise. Scans draw from it in their order.
        """
        self.begin(rng)
        self.mount = Pose2D(config.mount_x_m, config.mount_y_m, config.mount_yaw_rad)
        self._config = config

        # Single precision, as in the message, so that sending a scan does not change
        # it.
        spread = config.angle_max_rad - config.angle_min_rad
        angle_min = float(np.float32(config.angle_min_rad))
        # There is one gap fewer than beams.
        increment = float(np.float32(spread / max(config.beams - 1, 1)))
        range_min = float(np.float32(config.range_min_m))
        range_max = float(np.float32(config.range_max_m))

        self.directions = _beam_directions(angle_min, increment, config.beams)
        self.fan = (angle_min, increment, range_max)
        self.limits = (config.noise_m, config.noise_share, range_min, range_max)

        self.sweeps = config.sweeps
        sweep_ns = NANOSECONDS_PER_SECOND * (spread / (2.0 * math.pi * config.rate_hz))
        self.ages_ns = sweep_ns * np.linspace(1.0, 0.0, config.beams) * config.sweeps
        self._ranges = np.empty(config.beams)

        # Beams are in the order of their angles, so those behind a mask are in a row.
        angles = angle_min + increment * np.arange(config.beams)
        edges = (config.masked_from_rad, config.masked_to_rad)
        self._mask = slice(*np.searchsorted(angles, edges).tolist())
        # Bursts begin and end by chance, so that they last as long as configured on
        # average and fill their share of the time.
        burst_scans = max(config.blackout_s * config.rate_hz, 1.0)
        pause_scans = burst_scans * (1.0 - config.blackout_share)
        self._end_chance = 1.0 / burst_scans
        self._begin_chance = config.blackout_share / pause_scans

    def begin(self, rng: np.random.Generator) -> None:
        """Restart: use a new source of noise, and end any blackout."""
        self.rng = rng
        self._is_blind = False

    @property
    def is_plain(self) -> bool:
        """Whether all beams are taken at once, with no errors but noise and limits."""
        config = self._config
        return not (
            config.sweeps
            or config.mixed_share
            or config.dropout_share
            or config.blackout_share
            or config.unseen_share
            or config.masked_to_rad > config.masked_from_rad
        )

    def scan(
        self,
        stamp_ns: int,
        robot: Pose2D,
        centers: Floats,
        radius_m: float,
        tilted: Floats = NO_SHAPES,
        shapes: Floats = NO_SHAPES,
        noise: Singles | None = None,
        sweep: Floats | None = None,
    ) -> Scan:
        """Take a scan from a pose, or one per beam in `sweep`; None draws new noise.

        Args:
            stamp_ns: Time of the scan since the start of the trial.
            robot: Pose of base_link, in the frame of the obstacles.
            centers: Centers (n, 2) of upright cylinders in m.
            radius_m: Radius of all cylinders, upright or tilted.
            tilted: Other cylinders (m, 7): x and y of the center and its height above
                the scan plane in m, unit vector of the axis, half length in m.
            shapes: Cylinders of other sizes and boxes (k, 7), as rows of
                `barn_worlds.geometry.kernels`.
            noise: Standard normal numbers (n,), by default drawn from `rng`.
            sweep: Poses (n, 3) of base_link at each beam, in place of `robot`.

        Returns:
            The scan, with +inf beyond the longest range and -inf below the shortest.
        """
        ranges = self._ranges
        ranges.fill(np.inf)
        obstacles = (centers, radius_m, tilted, shapes)
        if sweep is None:
            sensor = robot @ self.mount
            frame = (*sensor.position, math.cos(sensor.yaw), math.sin(sensor.yaw))
            cast_beams(ranges, self.directions, self.fan, frame, *obstacles)
        else:
            frames = self._sensor_frames(sweep)
            turn = float(np.abs(sweep[:, 2] - sweep[-1, 2]).max())
            cast_sweep(ranges, self.directions, self.fan, frames, turn, *obstacles)

        # The order of draws is part of the result: mixing, noise, drop-outs, blackouts.
        if self._config.mixed_share:
            self._mix_pixels(ranges)
        if noise is None:
            noise = np.empty(len(ranges), np.float32)
            self.draw_noise(noise)
        measured = np.empty(len(ranges), np.float32)
        measure(ranges, noise, self.limits, measured)
        if self._config.dropout_share:
            dropped = self.rng.random(len(measured)) < self._config.dropout_share
            measured[dropped] = np.inf
        measured[self._mask] = np.inf
        if self._config.blackout_share:
            chance = self._end_chance if self._is_blind else self._begin_chance
            if self.rng.random() < chance:
                self._is_blind = not self._is_blind
            if self._is_blind:
                measured[:] = np.inf
        return self.scan_of(stamp_ns, measured)

    def draw_noise(self, noise: Singles) -> None:
        """Fill an array with standard normal numbers, (n,) or (k, n) for k scans."""
        self.rng.standard_normal(out=noise, dtype=np.float32)

    def scan_of(self, stamp_ns: int, measured: Singles) -> Scan:
        """Wrap ranges (beams,) in m in a `Scan`; add no noise and apply no limits.

        Args:
            stamp_ns: Time of the scan since the start of the trial.
            measured: Ranges (n,) in m with noise and limits.
        """
        angle_min, increment, range_max = self.fan
        range_min = self.limits[2]
        return Scan(stamp_ns, measured, angle_min, increment, range_min, range_max)

    def _sensor_frames(self, poses: Floats) -> Floats:
        """Return x, y, cosine, sine of the sensor (n, 4) at base_link poses (n, 3)."""
        x, y, yaw = poses.T
        cosine = np.cos(yaw)
        sine = np.sin(yaw)
        sensor_x = x + cosine * self.mount.x - sine * self.mount.y
        sensor_y = y + sine * self.mount.x + cosine * self.mount.y
        sensor_yaw = yaw + self.mount.yaw
        columns = [sensor_x, sensor_y, np.cos(sensor_yaw), np.sin(sensor_yaw)]
        return np.stack(columns, axis=1)

    def _mix_pixels(self, ranges: Floats) -> None:
        """Replace some ranges at edges in place by a range between the two sides.

        A beam that grazes an edge lights both sides; sensors report a mixture. The near
        side is changed, evenly up to the far side, as often as configured.
        """
        chances, portions = self.rng.random((2, len(ranges)))
        near = np.minimum(ranges, self.fan[2])
        # The first and the last beam have only one neighbor and stand in for the other.
        far = np.maximum(
            np.append(near[1:], near[-1]), np.insert(near[:-1], 0, near[0])
        )
        is_mixed = (far - near > _EDGE_M) & (chances < self._config.mixed_share)
        ranges[is_mixed] = (near + portions * (far - near))[is_mixed]


@cache
def _beam_directions(angle_min: float, increment: float, beams: int) -> Floats:
    """Return unit vectors (beams, 2) in the sensor frame; angles in rad."""
    return unit_vectors(angle_min + increment * np.arange(beams))
