"""Odometry as the robot's extended Kalman filter fuses it."""

import math

import numpy as np

from barn_sim.config import OdometryConfig
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
