"""The robot's estimate of its pose in the map frame."""

import math
from dataclasses import replace

import numpy as np

from barn_sim.config import LocalizationConfig, SimulatorConfig
from barn_sim.sensors.particles import ParticleLocalization, has_moved
from barn_worlds.base.types import OccupancyMap, Pose2D, wrap_angle
from barn_worlds.worlds.cells import STANDARD_CELL_M
from barn_worlds.worlds.world import World


class FilterLocalization:
    """Behaves like adaptive Monte Carlo localisation, without particles.

    While the robot moves less than the update distances the correction from odom to map stays, so the pose follows the
    odometry. Each update sets the correction so that the pose is the truth plus an error. The error is a first-order
    Gauss-Markov process over the updates, with the configured standard deviations from the first one on.
    """

    def __init__(self, config: LocalizationConfig, rng: np.random.Generator) -> None:
        self._config, self._rng = config, rng
        self._keep = math.exp(-1.0 / config.correlation_updates)
        self._stds = np.array(
            [config.position_std_m, config.position_std_m, config.yaw_std_rad]
        )
        self._error = self._stds * rng.standard_normal(3)
        self._correction = Pose2D(0.0, 0.0, 0.0)
        self._updated_at: Pose2D | None = None

    def estimate(self, truth: Pose2D, odometry: Pose2D) -> Pose2D:
        """Return the pose after the last correction, which is updated first if the robot has moved enough."""
        if self._updated_at is None or has_moved(
            self._config, self._updated_at, odometry
        ):
            if self._updated_at is not None:
                fresh = math.sqrt(1.0 - self._keep**2) * self._rng.standard_normal(3)
                self._error = self._keep * self._error + self._stds * fresh
            x, y, yaw = self._error.tolist()
            believed = Pose2D(truth.x + x, truth.y + y, wrap_angle(truth.yaw + yaw))
            self._correction, self._updated_at = believed @ odometry.inverse(), odometry
        return self._correction @ odometry


def known_map(world: World, historical: bool) -> OccupancyMap:
    """Return the map to localise in; worlds of other cells never had a historical one, theirs is off as a whole."""
    standard = math.isclose(world.resolution_m, STANDARD_CELL_M)
    known = world.occupancy_map(historical=historical and standard)
    off_m = -STANDARD_CELL_M if historical and not standard else 0.0
    return replace(known, origin_y=known.origin_y + off_m)


def make_localization(
    config: SimulatorConfig,
    world: World,
    start: Pose2D,
    mount: Pose2D,
    rng: np.random.Generator,
) -> FilterLocalization | ParticleLocalization:
    """Return what estimates the pose in the map where it is not exact."""
    localisation = config.localisation
    if localisation.mode == "amcl":
        return FilterLocalization(localisation, rng)
    return ParticleLocalization(
        localisation, rng, known_map(world, localisation.historical_map), start, mount
    )
