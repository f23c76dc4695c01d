"""Wheel speeds from velocity commands, as the robot's controller computes them: one for each side of the robot."""

from numba import njit

from barn_sim.body.state import Fleet, Record, Records, set_drive
from barn_sim.config import DriveConfig
from barn_worlds.base.arrays import Floats
from barn_worlds.base.types import Velocity2D, nanoseconds


class DriveController:
    """Latency, watchdog, limits, kinematics and lag of the motors between a command and the wheels.

    fleet, index: whose state it keeps.
    """

    def __init__(
        self,
        config: DriveConfig,
        track_m: float,
        tick_s: float,
        fleet: Fleet,
        index: int,
    ) -> None:
        self.fleet, self._index = fleet, index
        self._latency_ns = nanoseconds(config.command_latency_s)
        set_drive(self.fleet.settings, config, track_m, tick_s)

    def command(self, velocity: Velocity2D, now_ns: int) -> None:
        """Take a command that arrives now."""
        command = (
            self._index,
            now_ns + self._latency_ns,
            velocity.linear,
            velocity.angular,
        )
        if not add_command(self.fleet.robots, self.fleet.pending, *command):
            self.fleet = self.fleet.with_room()
            add_command(self.fleet.robots, self.fleet.pending, *command)


@njit(cache=True)
def add_command(
    robots: Records,
    pending: Floats,
    index: int,
    arrival_ns: int,
    linear: float,
    angular: float,
) -> bool:
    """Put a command behind those on their way; return whether there was room."""
    robot: Record = robots[index]
    if robot.pending == pending.shape[1]:
        return False
    row = pending[index, robot.pending]
    row[0], row[1], row[2] = arrival_ns, linear, angular
    robot.pending += 1
    return True


@njit(cache=True)
def turn_wheels(
    robot: Record, pending: Floats, index: int, settings: Record, now_ns: int
) -> None:
    """Set the rim speeds of a robot for the tick that begins now."""
    while robot.pending > 0 and pending[index, 0, 0] <= now_ns:
        robot.target_since_ns = int(pending[index, 0, 0])
        robot.target_speed, robot.target_turn = (
            pending[index, 0, 1],
            pending[index, 0, 2],
        )
        robot.timed_out = False
        robot.pending -= 1
        for k in range(robot.pending):
            for column in range(3):  # a row at once would be copied in between
                pending[index, k, column] = pending[index, k + 1, column]
    if now_ns - robot.target_since_ns >= settings.timeout_ns and not robot.timed_out:
        robot.target_speed = robot.target_turn = 0.0
        robot.timed_out = True
    speed = max(-settings.max_reverse, min(settings.max_speed, robot.target_speed))
    turn = _within(robot.target_turn, settings.max_turn)
    robot.speed += _within(speed - robot.speed, settings.speed_step)
    robot.turn += _within(turn - robot.turn, settings.turn_step)
    left = robot.speed - robot.turn * settings.half_separation_m
    right = robot.speed + robot.turn * settings.half_separation_m
    if settings.lags:
        left = robot.left_m_s + settings.lag_share * (left - robot.left_m_s)
        right = robot.right_m_s + settings.lag_share * (right - robot.right_m_s)
    robot.left_m_s, robot.right_m_s = left, right


@njit(cache=True)
def _within(value: float, limit: float) -> float:
    return max(-limit, min(limit, value))
