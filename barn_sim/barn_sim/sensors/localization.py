"""The robot's estimate of its pose in the map frame."""

import math
from dataclasses import replace

import numpy as np

from barn_sim.config import LocalizationConfig, SimulatorConfig
from barn_sim.sensors.particles import ParticleLocalization, has_moved
from barn_worlds.base.types import ORIGIN, OccupancyMap, Pose2D, wrap_angle
from barn_worlds.worlds.cells import STANDARD_CELL_M
from barn_worlds.worlds.world import World


class FilterLocalization:
    """Behaves like adaptive Monte Carlo localization, without particles.

    Until the robot has moved by an update distance, the correction from odom to map
    stays, so the pose follows the odometry. Each update sets the correction so that the
    pose is the truth plus an error. The error is a first-order Gauss-Markov process
    over the updates. It has the configured standard deviations from the first update.
    """

    def __init__(self, config: LocalizationConfig, rng: np.random.Generator):
        """Create the filter and draw its first error.

        Args:
            config: Standard deviations, correlation and update distances.
            rng: Source of the errors.
        """
        self._config = config
        self._rng = rng
        self._correlation = math.exp(-1.0 / config.correlation_updates)
        self._stds = np.array(
            [config.position_std_m, config.position_std_m, config.yaw_std_rad]
        )
        # The stationary distribution from the start: a first error of 0 would grow for
        # a while.
        self._error = self._stds * rng.standard_normal(3)
        self._correction = ORIGIN
        self._updated_at: Pose2D | None = None

    def estimate(self, truth: Pose2D, odometry: Pose2D) -> Pose2D:
        """Return the estimated map pose; draw a new error if the robot moved enough.

        Args:
            truth: True pose in the map frame.
            odometry: Pose in the odom frame at the same time.

        Returns:
            The pose in the map frame.
        """
        last = self._updated_at
        if last is None or has_moved(self._config, last, odometry):
            if last is not None:
                # The innovation keeps the variance of the error constant.
                innovation = math.sqrt(
                    1.0 - self._correlation**2
                ) * self._rng.standard_normal(3)
                self._error = self._correlation * self._error + self._stds * innovation
            x, y, yaw = self._error.tolist()
            # The error stays in the map frame, as that of a map that does not quite
            # fit.
            pose = Pose2D(truth.x + x, truth.y + y, wrap_angle(truth.yaw + yaw))
            self._correction = pose @ odometry.inverse()
            self._updated_at = odometry
        return self._correction @ odometry


def localization_map(world: World, historical: bool) -> OccupancyMap:
    """Return a world's map for the particle filter, its obstacles nearer if historical.

    Args:
        world: World of the trial.
        historical: Whether obstacles are one cell nearer, as in the original's maps.
            A world of other cells never had one, so its map is shifted as a whole.
    """
    is_standard = math.isclose(world.resolution_m, STANDARD_CELL_M)
    occupancy = world.occupancy_map(historical=historical and is_standard)
    shift_m = 0.0
    if historical and not is_standard:
        shift_m = -STANDARD_CELL_M
    return replace(occupancy, origin_y=occupancy.origin_y + shift_m)


def make_localization(
    config: SimulatorConfig,
    world: World,
    start: Pose2D,
    mount: Pose2D,
    rng: np.random.Generator,
) -> FilterLocalization | ParticleLocalization:
    """Create the localization: `FilterLocalization` for mode amcl, else particles.

    Args:
        config: Configuration of the simulator.
        world: World of the trial; its map is what the particles are matched to.
        start: Start pose of base_link in the map frame.
        mount: Pose of the lidar in base_link.
        rng: Source of all that the filter draws.
    """
    localization = config.localisation
    if localization.mode == "amcl":
        return FilterLocalization(localization, rng)
    occupancy = localization_map(world, localization.historical_map)
    return ParticleLocalization(localization, rng, occupancy, start, mount)
