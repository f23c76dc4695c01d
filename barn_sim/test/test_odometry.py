import math

import numpy as np
import pytest

from barn_sim.config import OdometryConfig
from barn_sim.sensors.estimates import FusedOdometry

TICK_S = 0.005
EXACT = OdometryConfig(yaw_noise_rad=0.0, yaw_rate_noise_rad_s=0.0)


def odometry(config: OdometryConfig, start_yaw: float = 0.0) -> FusedOdometry:
    return FusedOdometry(config, np.random.default_rng(0), start_yaw)


def test_starts_at_zero_whatever_the_start_pose() -> None:
    reading = odometry(EXACT, start_yaw=2.0).read(0, 2.0, 0.0)
    assert (reading.pose.x, reading.pose.y) == (0.0, 0.0)
    assert reading.pose.yaw == pytest.approx(0.0, abs=1e-15)


def test_integrates_the_wheels_along_the_yaw() -> None:
    fused, yaw = odometry(EXACT, start_yaw=1.0), 1.0
    for _ in range(2000):  # a circle of radius 0.5 m, once around in 10 s
        yaw += TICK_S * 2.0 * math.pi / 10.0
        speed = 2.0 * math.pi / 10.0 * 0.5
        fused.advance(TICK_S, speed - 0.1, speed + 0.1, yaw)
    reading = fused.read(7, yaw, 0.63)
    assert math.hypot(reading.pose.x, reading.pose.y) < 1e-9
    assert reading.stamp_ns == 7
    assert reading.velocity.linear == pytest.approx(0.314, abs=1e-3)
    assert reading.velocity.angular == 0.63


def test_slip_of_the_wheels_is_drift_of_the_position() -> None:
    fused = odometry(EXACT)
    for _ in range(200):
        fused.advance(TICK_S, 0.5, 0.5, 0.0)  # however far the robot really went
    assert fused.read(0, 0.0, 0.0).pose.x == pytest.approx(0.5)


def test_noise_has_the_configured_deviation_and_does_not_grow() -> None:
    fused = odometry(OdometryConfig())
    yaws, rates = [], []
    for number in range(5000):
        fused.update(number)
        reading = fused.read(0, 0.0, 0.0)
        yaws.append(reading.pose.yaw)
        rates.append(reading.velocity.angular)
    assert np.std(yaws) == pytest.approx(0.005, rel=0.05)
    assert np.std(yaws[-500:]) == pytest.approx(0.005, rel=0.15)
    assert np.std(rates) == pytest.approx(0.005, rel=0.05)


def test_a_reading_is_what_comes_out_of_a_message() -> None:
    fused = odometry(OdometryConfig())
    fused.update(0)
    pose = fused.read(0, 1.234567, 0.0).pose
    assert pose == pose.through_quaternion()
