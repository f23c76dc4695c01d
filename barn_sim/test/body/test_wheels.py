"""Wheels: how commands turn them, and what they tell of where the robot is."""

import math
from dataclasses import replace

import numpy as np
import pytest
from numba import njit

from barn_sim.body.drive import DriveController, turn_wheels
from barn_sim.body.state import Fleet
from barn_sim.config import DriveConfig, OdometryConfig
from barn_sim.sensors.odometry import FusedOdometry, integrate_wheels
from barn_worlds.base.types import Velocity2D, nanoseconds

TRACK = 0.37559
TICK_S = 0.005
PROMPT = DriveConfig(command_latency_s=0.0)


@njit
def turn_once(robots, pending, settings, now_ns):
    robots[0].stamp_ns = now_ns
    turn_wheels(robots[0], pending[0], settings[0])
    return robots[0].left_m_s, robots[0].right_m_s


class Clocked:
    """A drive with its clock."""

    def __init__(self, config):
        self.drive = DriveController(config, TRACK, TICK_S, Fleet.of(1), 0)
        self.now_ns = 0

    def command(self, linear, angular):
        self.drive.command(Velocity2D(linear, angular), self.now_ns)

    def run(self, duration_s):
        fleet = self.drive.fleet
        for _ in range(round(duration_s / TICK_S)):
            speeds = turn_once(fleet.robots, fleet.pending, fleet.settings, self.now_ns)
            self.now_ns += nanoseconds(TICK_S)
        return speeds


@pytest.mark.parametrize("seed", range(4))
def test_wheels_turn_as_the_rules_say_under_any_commands(seed):
    rng = np.random.default_rng(seed)
    config = DriveConfig(command_timeout_s=(0.25, 0.5)[seed % 2])
    robot = Clocked(config)
    speed = 0.0
    turn = 0.0
    target = (0.0, 0.0)
    since = 0
    sent = []
    latency = nanoseconds(config.command_latency_s)
    timeout = nanoseconds(config.command_timeout_s)
    half = 0.5 * TRACK * 1.5
    for _ in range(1500):
        if rng.random() < 0.01:
            command = rng.choice([-5.0, -0.5, 0.0, 0.3, 9.0], 2).tolist()
            sent.append((robot.now_ns + latency, command))
            robot.command(*command)
        for due, command in sent:
            if since < due <= robot.now_ns:
                since = due
                target = np.clip(command, [-2.0, -4.0], [2.0, 4.0]).tolist()
        if robot.now_ns - since >= timeout:
            target = (0.0, 0.0)
        speed += min(max(target[0] - speed, -20.0 * TICK_S), 20.0 * TICK_S)
        turn += min(max(target[1] - turn, -25.0 * TICK_S), 25.0 * TICK_S)
        assert robot.run(TICK_S) == (speed - turn * half, speed + turn * half)


def test_backwards_it_is_no_faster_than_it_may():
    for reverse, expected in ((0.4, -0.4), (10.0, -2.0)):
        robot = Clocked(replace(PROMPT, max_reverse_m_s=reverse))
        robot.command(-9.0, 0.0)
        assert robot.run(0.4) == pytest.approx((expected, expected))


def test_motors_follow_with_a_lag_of_first_order():
    at_once = {"max_acceleration_m_s2": 1000.0, "max_yaw_acceleration_rad_s2": 1000.0}
    robot = Clocked(replace(PROMPT, motor_lag_s=0.1, **at_once))
    robot.command(0.5, 1.0)
    half = 0.5 * 1.5 * TRACK
    for time_s in (0.05, 0.1, 0.2):
        share = 1.0 - math.exp(-(robot.now_ns * 1e-9 + time_s) / 0.1)
        expected = ((0.5 - half) * share, (0.5 + half) * share)
        assert robot.run(time_s) == pytest.approx(expected, rel=1e-9)


EXACT = OdometryConfig(yaw_noise_rad=0.0, yaw_rate_noise_rad_s=0.0)


@njit
def integrate(robots):
    integrate_wheels(robots[0], TICK_S)


class Measured(FusedOdometry):
    """Odometry of a robot whose state is given."""

    def __init__(self, config, start_yaw=0.0):
        self.robots = (fleet := Fleet.of(1)).robots
        super().__init__(config, np.random.default_rng(0), start_yaw, fleet, 0)

    def advance(self, left, right, yaw):
        self.robots["left_m_s"] = left
        self.robots["right_m_s"] = right
        self.robots["yaw"] = yaw
        integrate(self.robots)


def test_starts_at_zero_whatever_the_start_pose():
    odometry = Measured(EXACT, start_yaw=2.0)
    odometry.robots["yaw"] = 2.0
    pose = odometry.read(0).pose
    assert pose.position == (0.0, 0.0)
    assert pose.yaw == pytest.approx(0.0, abs=1e-15)


def test_integrates_the_wheels_along_the_yaw():
    odometry = Measured(EXACT, start_yaw=1.0)
    yaw = 1.0
    rate = 2.0 * math.pi / 10.0
    speed = 0.5 * rate
    for _ in range(2000):  # a circle of radius 0.5 m, once around in 10 s
        yaw += TICK_S * rate
        odometry.advance(speed - 0.1, speed + 0.1, yaw)
    odometry.robots["spin"][0, 2] = 0.63
    reading = odometry.read(7)
    assert math.hypot(*reading.pose.position) < 1e-9
    assert reading.stamp_ns == 7
    assert reading.velocity.linear == pytest.approx(0.314, abs=1e-3)
    assert reading.velocity.angular == 0.63


def test_noise_has_the_configured_deviation_and_does_not_grow():
    fused = Measured(OdometryConfig())
    yaws = []
    rates = []
    for number in range(5000):
        fused.update(number)
        reading = fused.read(0)
        yaws.append(reading.pose.yaw)
        rates.append(reading.velocity.angular)
    assert np.std(yaws) == pytest.approx(0.005, rel=0.05)
    assert np.std(yaws[-500:]) == pytest.approx(0.005, rel=0.15)
    assert np.std(rates) == pytest.approx(0.005, rel=0.05)


def test_a_reading_is_what_comes_out_of_a_message():
    fused = Measured(OdometryConfig())
    fused.update(0)
    fused.robots["yaw"] = 1.234567
    pose = fused.read(0).pose
    assert pose == pose.through_quaternion()
