"""The robot's estimates: odometry as its extended Kalman filter fuses it, and its pose in the map frame."""

import math

import numpy as np

from barn_sim.config import LocalisationConfig, OdometryConfig
from barn_worlds.types import Odometry, Pose2D, Velocity2D, wrap_angle


class FusedOdometry:
    """Speed of the wheels integrated along the yaw of the IMU, from (0, 0, 0) at the robot's start pose.

    The filter trusts the IMU's absolute yaw. So the heading has that sensor's noise but does not drift, while the
    position drifts with every slip of the wheels. Noise is drawn once per update, at the odometry's own rate, whether
    or not the update is read.
    """

    def __init__(self, config: OdometryConfig, rng: np.random.Generator, start_yaw: float) -> None:
        self._config = config
        self._rng = rng
        self._start_yaw = start_yaw
        self._yaw_error = 0.0
        self._yaw_rate_error = 0.0
        self._x = 0.0
        self._y = 0.0
        self._speed = 0.0

    def update(self) -> None:
        """Draw the noise of a new update."""
        yaw, yaw_rate = self._rng.standard_normal(2).tolist()
        self._yaw_error = self._config.yaw_noise_rad * yaw
        self._yaw_rate_error = self._config.yaw_rate_noise_rad_s * yaw_rate

    def advance(self, tick_s: float, left_m_s: float, right_m_s: float, yaw: float) -> None:
        """Integrate one step with the rim speeds and the robot's true yaw."""
        self._speed = 0.5 * (left_m_s + right_m_s)
        heading = yaw - self._start_yaw + self._yaw_error
        self._x += tick_s * self._speed * math.cos(heading)
        self._y += tick_s * self._speed * math.sin(heading)

    def read(self, stamp_ns: int, yaw: float, yaw_rate: float) -> Odometry:
        """Return the state at this instant, given the true yaw and yaw rate."""
        pose = Pose2D(self._x, self._y, wrap_angle(yaw - self._start_yaw + self._yaw_error))
        velocity = Velocity2D(self._speed, yaw_rate + self._yaw_rate_error)
        return Odometry(stamp_ns, pose.through_quaternion(), velocity)


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
