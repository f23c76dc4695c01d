import math
from dataclasses import replace

import numpy as np
import pytest
from numba import njit

from barn_sim.body.drive import DriveController, turn_wheels
from barn_sim.config import DriveConfig
from barn_sim.motion.state import Fleet
from barn_worlds.base.types import Velocity2D, nanoseconds

TRACK = 0.37559
TICK_S = 0.005
PROMPT = DriveConfig(command_latency_s=0.0)


@njit
def turn(robots, pending, settings, now_ns):
    turn_wheels(robots[0], pending, 0, settings[0], now_ns)
    return robots[0].left_m_s, robots[0].right_m_s


class Clocked:
    """A drive with its clock."""

    def __init__(self, config: DriveConfig) -> None:
        self.drive = DriveController(config, TRACK, TICK_S, Fleet.of(1), 0)
        self.now_ns = 0

    def command(self, linear: float, angular: float) -> None:
        self.drive.command(Velocity2D(linear, angular), self.now_ns)

    def run(self, duration_s: float) -> tuple[float, float]:
        fleet = self.drive.fleet
        for _ in range(round(duration_s / TICK_S)):
            speeds = turn(fleet.robots, fleet.pending, fleet.settings, self.now_ns)
            self.now_ns += nanoseconds(TICK_S)
        return speeds


def test_commands_beyond_the_limits_are_cut() -> None:
    robot = Clocked(PROMPT)
    robot.command(9.0, -9.0)
    left, right = robot.run(0.4)
    assert 0.5 * (left + right) == pytest.approx(2.0)
    assert (right - left) / (1.5 * TRACK) == pytest.approx(-4.0)


@pytest.mark.parametrize("seed", range(4))
def test_wheels_turn_as_the_rules_say_under_any_commands(seed: int) -> None:
    rng = np.random.default_rng(seed)
    robot, speed, turn, target, since = Clocked(DriveConfig()), 0.0, 0.0, (0.0, 0.0), 0
    sent: list[tuple[int, tuple[float, float]]] = []
    latency, timeout = nanoseconds(DriveConfig().command_latency_s), nanoseconds(DriveConfig().command_timeout_s)
    for _ in range(1500):
        if rng.random() < 0.01:
            sent.append((robot.now_ns + latency, tuple(rng.choice([-5.0, -0.5, 0.0, 0.3, 9.0], 2).tolist())))
            robot.command(*sent[-1][1])
        for due, command in sent:
            if since < due <= robot.now_ns:
                since, target = due, command
        target = (0.0, 0.0) if robot.now_ns - since >= timeout else target
        speed += float(np.clip(np.clip(target[0], -2.0, 2.0) - speed, -20.0 * TICK_S, 20.0 * TICK_S))
        turn += float(np.clip(np.clip(target[1], -4.0, 4.0) - turn, -25.0 * TICK_S, 25.0 * TICK_S))
        half = 0.5 * TRACK * 1.5
        assert robot.run(TICK_S) == (speed - turn * half, speed + turn * half)


@pytest.mark.parametrize("timeout_s", [0.25, 0.5])
def test_an_old_command_stops_the_robot(timeout_s: float) -> None:
    robot = Clocked(replace(PROMPT, command_timeout_s=timeout_s))
    robot.command(0.5, 0.0)
    assert robot.run(timeout_s)[0] == pytest.approx(0.5)
    assert robot.run(0.1)[0] == 0.0


def test_backwards_it_is_no_faster_than_it_may() -> None:
    for reverse, expected in ((0.4, -0.4), (10.0, -2.0)):
        robot = Clocked(replace(PROMPT, max_reverse_m_s=reverse))
        robot.command(-9.0, 0.0)
        assert robot.run(0.4) == pytest.approx((expected, expected))


def test_motors_follow_with_a_lag_of_first_order() -> None:
    robot = Clocked(replace(PROMPT, motor_lag_s=0.1, max_acceleration_m_s2=1000.0, max_yaw_acceleration_rad_s2=1000.0))
    robot.command(0.5, 1.0)
    half = 0.5 * 1.5 * TRACK
    for time_s in (0.05, 0.1, 0.2):
        share = 1.0 - math.exp(-(robot.now_ns * 1e-9 + time_s) / 0.1)
        assert robot.run(time_s) == pytest.approx(((0.5 - half) * share, (0.5 + half) * share), rel=1e-9)
