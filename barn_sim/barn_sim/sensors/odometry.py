"""Odometry as the extended Kalman filter of the robot fuses it."""

import math

from numba import njit
from numpy.random import Generator

from barn_sim.body.state import Fleet, Record, Records
from barn_sim.config import OdometryConfig
from barn_worlds.base.arrays import Floats
from barn_worlds.base.types import Odometry, Pose2D, Velocity2D, nanoseconds


class FusedOdometry:
    """Speed of the wheels integrated along the yaw of the IMU, from (0, 0, 0) at the robot's start pose.

    The filter trusts the IMU's absolute yaw. So the heading has that sensor's noise but does not drift, while the
    position drifts with every slip of the wheels. Noise is drawn once per update, at the odometry's own rate, whether
    or not the update is read. A biased gyro without a compass makes the heading drift, in proportion to time.
    """

    def __init__(
        self,
        config: OdometryConfig,
        rng: Generator,
        start_yaw: float,
        fleet: Fleet,
        index: int,
    ) -> None:
        """Begin with the noise of the first update; fleet, index: whose state it keeps."""
        self._fleet, self._index, self._rng, self._drawn = fleet, index, rng, 0
        settings = self._fleet.settings
        settings["yaw_noise_rad"], settings["yaw_rate_noise_rad_s"] = (
            config.yaw_noise_rad,
            config.yaw_rate_noise_rad_s,
        )
        settings["odometry_ns"] = nanoseconds(1.0 / config.rate_hz)
        self._fleet.robots[index]["start_yaw"] = start_yaw
        self._fleet.robots[index]["speed_factor"] = 1.0

    def draw_errors(self, config: OdometryConfig, rng: Generator) -> None:
        """Draw the errors that stay for a trial: of the gyro and of the wheels' radius."""
        robot, (gyro, radius) = self._fleet.robots[self._index], rng.standard_normal(2)
        robot["gyro_bias"] = config.gyro_bias_rad_s * gyro
        robot["speed_factor"] = 1.0 + config.wheel_radius_error * radius

    def update(self, number: int) -> None:
        """Make the update of this number the present one."""
        self.supply(number, number)
        update_noise(
            self._fleet.robots,
            self._fleet.settings,
            self._index,
            self._fleet.noise,
            number,
        )

    def supply(self, first: int, last: int) -> None:
        """Have the noise of the updates from `first` to `last`; every one is drawn once, in their order."""
        if last < self._drawn:
            return
        noise = self._fleet.noise[self._index]
        kept = self._drawn - first
        if kept > 0:
            noise[:kept] = noise[len(noise) - kept :].copy()
        noise[kept:] = self._rng.standard_normal((len(noise) - kept, 2))
        self._fleet.robots[self._index]["noise_from"] = first
        self._drawn = first + len(noise)

    def read(self, stamp_ns: int) -> Odometry:
        """Return the state now."""
        x, y, yaw, linear, angular = read_odometry(self._fleet.robots, self._index)
        return Odometry(
            stamp_ns,
            Pose2D(x, y, yaw).through_quaternion(),
            Velocity2D(linear, angular),
        )


@njit(cache=True)
def integrate_wheels(robot: Record, tick_s: float) -> None:
    """Integrate the odometry of a robot by one tick."""
    robot.odometry_speed = 0.5 * (robot.left_m_s + robot.right_m_s) * robot.speed_factor
    heading = robot.yaw - robot.start_yaw + robot.yaw_error
    robot.odometry_x += tick_s * robot.odometry_speed * math.cos(heading)
    robot.odometry_y += tick_s * robot.odometry_speed * math.sin(heading)


@njit(cache=True)
def renew_noise(robot: Record, settings: Record, row: Floats) -> None:
    """Give a robot the noise of a new update, from a row (2,) of standard normal numbers, and what has drifted."""
    drift = robot.gyro_bias * 1e-9 * robot.stamp_ns
    robot.yaw_error = settings.yaw_noise_rad * row[0] + drift
    robot.yaw_rate_error = settings.yaw_rate_noise_rad_s * row[1] + robot.gyro_bias


@njit(cache=True)
def update_noise(
    robots: Records, settings: Records, index: int, noise: Floats, number: int
) -> None:
    """Give a robot the noise of the update of this number."""
    robot: Record = robots[index]
    renew_noise(robot, settings[0], noise[index, number - robot.noise_from])


@njit(cache=True)
def read_odometry(
    robots: Records, index: int
) -> tuple[float, float, float, float, float]:
    """Return x, y, yaw, forward speed and yaw rate as the odometry of a robot has them."""
    robot: Record = robots[index]
    seen = wrap(robot.yaw - robot.start_yaw + robot.yaw_error)
    return (
        robot.odometry_x,
        robot.odometry_y,
        seen,
        robot.odometry_speed,
        robot.spin[2] + robot.yaw_rate_error,
    )


@njit(cache=True)
def wrap(angle: float) -> float:
    """Return the angle in [-pi, pi), as `barn_worlds.base.types.wrap_angle` does."""
    return (angle + math.pi) % (2.0 * math.pi) - math.pi
