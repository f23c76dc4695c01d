"""Wheel speeds from velocity commands, as the robot's controller computes them."""

import math

from barn_sim.body.state import Fleet, Record
from barn_sim.body.vectors import fill
from barn_sim.config import DriveConfig
from barn_worlds.base.arrays import Floats, kernel
from barn_worlds.base.types import Velocity2D, nanoseconds


class DriveController:
    """Latency, watchdog, limits, kinematics and motor lag from command to wheels."""

    fleet: Fleet
    """Keeps the state; replaced by a larger one if commands need more room."""

    def __init__(
        self,
        config: DriveConfig,
        track_m: float,
        tick_s: float,
        fleet: Fleet,
        index: int,
    ):
        """Write the drive's limits, latency and lag to the settings of a fleet.

        Args:
            config: Limits and delays.
            track_m: Distance between the left and the right wheels.
            tick_s: Duration of a tick.
            fleet: Keeps the state.
            index: Row of the robot in the fleet.
        """
        self.fleet = fleet
        self._index = index
        self._latency_ns = nanoseconds(config.command_latency_s)

        settings = fleet.settings
        separation_m = track_m * config.wheel_separation_multiplier
        settings["half_separation_m"] = 0.5 * separation_m
        settings["timeout_ns"] = nanoseconds(config.command_timeout_s)
        settings["max_speed"] = config.max_speed_m_s
        # No robot file means faster backwards than forwards.
        settings["max_reverse"] = min(config.max_reverse_m_s, config.max_speed_m_s)
        settings["max_turn"] = config.max_yaw_rate_rad_s
        settings["turn_deadband"] = config.turn_deadband_rad_s
        settings["speed_step"] = config.max_acceleration_m_s2 * tick_s
        settings["turn_step"] = config.max_yaw_acceleration_rad_s2 * tick_s
        lag_share = 1.0
        if config.motor_lag_s:
            # The exact step of a first-order lag: 1 - exp(-tick / time constant).
            lag_share = -math.expm1(-tick_s / config.motor_lag_s)
        settings["lag_share"] = lag_share

    def command(self, velocity: Velocity2D, now_ns: int) -> None:
        """Queue a command for `now_ns` plus latency; replace `fleet` if it is full.

        Args:
            velocity: Finite speed and yaw rate.
            now_ns: Time at which it arrives; no later than any command after it.
        """
        arrival_ns = now_ns + self._latency_ns
        if self.fleet.is_full(self._index):
            self.fleet = self.fleet.with_more_room()
        add_command(
            self.fleet, self._index, arrival_ns, velocity.linear, velocity.angular
        )


@kernel
def add_command(
    fleet: Fleet, index: int, arrival_ns: int, linear: float, angular: float
) -> None:
    """Append a command to a robot's queue, which must have room (not checked).

    Args:
        fleet: Robots with their commands.
        index: Row of the robot.
        arrival_ns: Time at which the command takes effect.
        linear: Speed, m/s.
        angular: Yaw rate, rad/s.
    """
    robot: Record = fleet.robots[index]
    fill(fleet.pending[index, robot.pending], (float(arrival_ns), linear, angular))
    robot.pending += 1


@kernel
def turn_wheels(robot: Record, pending: Floats, settings: Record) -> None:
    """Consume due commands, then set rim speeds by watchdog, limits and motor lag.

    Args:
        robot: Record of the robot.
        pending: Its commands on the way (capacity, 3).
        settings: Record of the fleet's settings.
    """
    now_ns = robot.stamp_ns
    while robot.pending > 0 and pending[0, 0] <= now_ns:
        robot.target_since_ns = int(pending[0, 0])
        robot.target_speed = pending[0, 1]
        robot.target_turn = pending[0, 2]
        robot.timed_out = False
        robot.pending -= 1
        # Number by number: numba would copy a row to memory in between.
        for k in range(robot.pending):
            for column in range(3):
                pending[k, column] = pending[k + 1, column]

    # The watchdog stops the robot once; the next command starts it again.
    if now_ns - robot.target_since_ns >= settings.timeout_ns and not robot.timed_out:
        robot.target_speed = 0.0
        robot.target_turn = 0.0
        robot.timed_out = True

    speed = max(-settings.max_reverse, min(settings.max_speed, robot.target_speed))
    turn = _limit(robot.target_turn, settings.max_turn)
    turn -= _limit(turn, settings.turn_deadband)
    robot.speed += _limit(speed - robot.speed, settings.speed_step)
    robot.turn += _limit(turn - robot.turn, settings.turn_step)

    # The controller limits speed and yaw rate, not wheels: turning is not slowed by
    # speed.
    left = robot.speed - robot.turn * settings.half_separation_m
    right = robot.speed + robot.turn * settings.half_separation_m
    if settings.lag_share < 1.0:
        left = robot.left_m_s + settings.lag_share * (left - robot.left_m_s)
        right = robot.right_m_s + settings.lag_share * (right - robot.right_m_s)
    robot.left_m_s = left
    robot.right_m_s = right


@kernel
def _limit(value: float, largest: float) -> float:
    """Return a value clamped to the range from -largest to largest."""
    return max(-largest, min(largest, value))
