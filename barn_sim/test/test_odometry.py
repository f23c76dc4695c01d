import math

import numpy as np
import pytest
from numba import njit

from barn_sim.config import OdometryConfig
from barn_sim.motion.state import Fleet
from barn_sim.sensors.odometry import FusedOdometry, integrate_wheels

TICK_S = 0.005
EXACT = OdometryConfig(yaw_noise_rad=0.0, yaw_rate_noise_rad_s=0.0)


@njit
def integrate(robots):
    integrate_wheels(robots[0], TICK_S)


class Measured(FusedOdometry):
    """Odometry of a robot whose state is given."""

    def __init__(self, config: OdometryConfig, start_yaw: float = 0.0) -> None:
        self.robots = (fleet := Fleet.of(1)).robots
        super().__init__(config, np.random.default_rng(0), start_yaw, fleet, 0)

    def advance(self, left: float, right: float, yaw: float) -> None:
        self.robots["left_m_s"], self.robots["right_m_s"], self.robots["yaw"] = left, right, yaw
        integrate(self.robots)


def test_starts_at_zero_whatever_the_start_pose() -> None:
    odometry = Measured(EXACT, start_yaw=2.0)
    odometry.robots["yaw"] = 2.0
    pose = odometry.read(0).pose
    assert (pose.x, pose.y) == (0.0, 0.0)
    assert pose.yaw == pytest.approx(0.0, abs=1e-15)


def test_integrates_the_wheels_along_the_yaw() -> None:
    odometry, yaw = Measured(EXACT, start_yaw=1.0), 1.0
    for _ in range(2000):  # a circle of radius 0.5 m, once around in 10 s
        yaw += TICK_S * 2.0 * math.pi / 10.0
        speed = 2.0 * math.pi / 10.0 * 0.5
        odometry.advance(speed - 0.1, speed + 0.1, yaw)
    odometry.robots["spin"][0, 2] = 0.63
    reading = odometry.read(7)
    assert math.hypot(reading.pose.x, reading.pose.y) < 1e-9
    assert reading.stamp_ns == 7
    assert reading.velocity.linear == pytest.approx(0.314, abs=1e-3)
    assert reading.velocity.angular == 0.63


def test_slip_of_the_wheels_is_drift_of_the_position() -> None:
    fused = Measured(EXACT)
    for _ in range(200):
        fused.advance(0.5, 0.5, 0.0)  # however far the robot really went
    assert fused.read(0).pose.x == pytest.approx(0.5)


def test_noise_has_the_configured_deviation_and_does_not_grow() -> None:
    fused = Measured(OdometryConfig())
    yaws, rates = [], []
    for number in range(5000):
        fused.update(number)
        reading = fused.read(0)
        yaws.append(reading.pose.yaw)
        rates.append(reading.velocity.angular)
    assert np.std(yaws) == pytest.approx(0.005, rel=0.05)
    assert np.std(yaws[-500:]) == pytest.approx(0.005, rel=0.15)
    assert np.std(rates) == pytest.approx(0.005, rel=0.05)


def test_a_reading_is_what_comes_out_of_a_message() -> None:
    fused = Measured(OdometryConfig())
    fused.update(0)
    fused.robots["yaw"] = 1.234567
    pose = fused.read(0).pose
    assert pose == pose.through_quaternion()
