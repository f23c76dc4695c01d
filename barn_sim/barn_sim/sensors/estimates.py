"""The robot's estimates: odometry as its extended Kalman filter fuses it, and its pose in the map frame."""

import math

import numpy as np
from numba import njit

from barn_sim.config import LocalisationConfig, OdometryConfig
from barn_sim.motion.state import Fleet, Record, Records
from barn_worlds.base.arrays import Floats
from barn_worlds.base.types import Odometry, Pose2D, Velocity2D, nanoseconds, wrap_angle


class FusedOdometry:
    """Speed of the wheels integrated along the yaw of the IMU, from (0, 0, 0) at the robot's start pose.

    The filter trusts the IMU's absolute yaw. So the heading has that sensor's noise but does not drift, while the
    position drifts with every slip of the wheels. Noise is drawn once per update, at the odometry's own rate, whether
    or not the update is read.
    """

    def __init__(
        self,
        config: OdometryConfig,
        rng: np.random.Generator,
        start_yaw: float,
        fleet: Fleet | None = None,
        index: int = 0,
    ) -> None:
        """Begin with the noise of the first update; fleet, index: whose state it keeps, else a robot of its own."""
        self._fleet = Fleet.of(1) if fleet is None else fleet
        self._index = index
        self._rng = rng
        self._drawn = 0
        settings = self._fleet.settings
        settings["yaw_noise_rad"], settings["yaw_rate_noise_rad_s"] = config.yaw_noise_rad, config.yaw_rate_noise_rad_s
        settings["odometry_ns"] = nanoseconds(1.0 / config.rate_hz)
        self._fleet.robots[index]["start_yaw"] = start_yaw

    def update(self, number: int) -> None:
        """Make the update of this number the present one."""
        self.supply(number, number)
        update_noise(self._fleet.robots, self._fleet.settings, self._index, self._fleet.noise, number)

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

    def advance(self, tick_s: float, left_m_s: float, right_m_s: float, yaw: float) -> None:
        """Integrate one step with the rim speeds and the robot's true yaw."""
        integrate_one(self._fleet.robots, self._index, tick_s, left_m_s, right_m_s, yaw)

    def read(self, stamp_ns: int, yaw: float, yaw_rate: float) -> Odometry:
        """Return the state at this instant, given the true yaw and yaw rate."""
        x, y, yaw, linear, angular = read_odometry(self._fleet.robots, self._index, yaw, yaw_rate)
        return Odometry(stamp_ns, Pose2D(x, y, yaw).through_quaternion(), Velocity2D(linear, angular))


@njit(cache=True)
def integrate_wheels(robot: Record, tick_s: float, left_m_s: float, right_m_s: float, yaw: float) -> None:
    """Integrate the odometry of a record by one step."""
    robot.odometry_speed = 0.5 * (left_m_s + right_m_s)
    heading = yaw - robot.start_yaw + robot.yaw_error
    robot.odometry_x += tick_s * robot.odometry_speed * math.cos(heading)
    robot.odometry_y += tick_s * robot.odometry_speed * math.sin(heading)


@njit(cache=True)
def renew_noise(robot: Record, settings: Record, row: Floats) -> None:
    """Give a record the noise of a new update, from a row (2,) of standard normal numbers."""
    robot.yaw_error = settings.yaw_noise_rad * row[0]
    robot.yaw_rate_error = settings.yaw_rate_noise_rad_s * row[1]


@njit(cache=True)
def observed_odometry(robot: Record, yaw: float, yaw_rate: float) -> tuple[float, float, float, float, float]:
    """Return x, y, yaw, forward speed and yaw rate as the odometry of a record has them."""
    seen = wrap(yaw - robot.start_yaw + robot.yaw_error)
    return robot.odometry_x, robot.odometry_y, seen, robot.odometry_speed, yaw_rate + robot.yaw_rate_error


@njit(cache=True)
def wrap(angle: float) -> float:
    """Return the angle in [-pi, pi), as `barn_worlds.base.types.wrap_angle` does."""
    return (angle + math.pi) % (2.0 * math.pi) - math.pi


@njit(cache=True)
def integrate_one(robots: Records, index: int, tick_s: float, left_m_s: float, right_m_s: float, yaw: float) -> None:
    """Integrate the odometry of a robot by one step."""
    integrate_wheels(robots[index], tick_s, left_m_s, right_m_s, yaw)


@njit(cache=True)
def update_noise(robots: Records, settings: Records, index: int, noise: Floats, number: int) -> None:
    """Give a robot the noise of the update of this number."""
    robot: Record = robots[index]
    renew_noise(robot, settings[0], noise[index, number - robot.noise_from])


@njit(cache=True)
def read_odometry(robots: Records, index: int, yaw: float, yaw_rate: float) -> tuple[float, float, float, float, float]:
    """Return what the odometry of a robot reads, given the true yaw and yaw rate."""
    return observed_odometry(robots[index], yaw, yaw_rate)


class FilterLocalisation:
    """Behaves like adaptive Monte Carlo localisation, without particles.

    While the robot moves less than the update distances the correction from odom to map stays, so the pose follows the
    odometry. Each update sets the correction so that the pose is the truth plus an error. The error is a first-order
    Gauss-Markov process over the updates, with the configured standard deviations from the first one on.
    """

    def __init__(self, config: LocalisationConfig, rng: np.random.Generator) -> None:
        self._config = config
        self._rng = rng
        self._keep = math.exp(-1.0 / config.correlation_updates)
        self._stds = np.array([config.position_std_m, config.position_std_m, config.yaw_std_rad])
        self._error = self._stds * rng.standard_normal(3)
        self._correction: Pose2D | None = None
        self._updated_at = Pose2D(0.0, 0.0, 0.0)

    def estimate(self, truth: Pose2D, odometry: Pose2D) -> Pose2D:
        """Return the pose after the last correction, which is updated first if the robot has moved enough."""
        if self._correction is None:
            self._correct(truth, odometry)
        elif self._moved(odometry):
            fresh = math.sqrt(1.0 - self._keep**2) * self._rng.standard_normal(3)
            self._error = self._keep * self._error + self._stds * fresh
            self._correct(truth, odometry)
        assert self._correction is not None
        return self._correction @ odometry

    def _moved(self, odometry: Pose2D) -> bool:
        turned = abs(wrap_angle(odometry.yaw - self._updated_at.yaw))
        config = self._config
        return odometry.distance(self._updated_at) >= config.update_distance_m or turned >= config.update_turn_rad

    def _correct(self, truth: Pose2D, odometry: Pose2D) -> None:
        x, y, yaw = self._error.tolist()
        believed = Pose2D(truth.x + x, truth.y + y, wrap_angle(truth.yaw + yaw))
        self._correction = believed @ odometry.inverse()
        self._updated_at = odometry
