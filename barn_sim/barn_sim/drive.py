"""Wheel speeds from velocity commands, as the robot's skid-steering controller computes them."""

from collections import deque

from barn_sim.config import DriveConfig
from barn_worlds.types import STOP, Velocity2D, nanoseconds


class DriveController:
    """Latency, watchdog, limits and skid-steering kinematics between a command and the wheels.

    left_m_s, right_m_s: speeds of the wheel rims on either side.
    """

    def __init__(self, config: DriveConfig, track_m: float, tick_s: float) -> None:
        self._config = config
        self._half_separation_m = 0.5 * track_m * config.wheel_separation_multiplier
        self._latency_ns = nanoseconds(config.command_latency_s)
        self._timeout_ns = nanoseconds(config.command_timeout_s)
        self._speed_step = config.max_acceleration_m_s2 * tick_s
        self._turn_step = config.max_yaw_acceleration_rad_s2 * tick_s
        self._on_the_way: deque[tuple[int, Velocity2D]] = deque()
        self._target = STOP
        self._target_since_ns = 0
        self._speed = 0.0
        self._turn = 0.0
        self._settled = False  # the rims turn as they should, so that nothing changes before the next command
        self.left_m_s = 0.0
        self.right_m_s = 0.0

    def command(self, velocity: Velocity2D, now_ns: int) -> None:
        """Take a command that arrives now."""
        self._on_the_way.append((now_ns + self._latency_ns, velocity))

    def advance(self, now_ns: int) -> None:
        """Set the rim speeds for the step that begins now."""
        while self._on_the_way and self._on_the_way[0][0] <= now_ns:
            self._target_since_ns, self._target = self._on_the_way.popleft()
            self._settled = False
        limits = self._config
        if now_ns - self._target_since_ns >= self._timeout_ns and self._target is not STOP:
            self._target, self._settled = STOP, False
        if self._settled:
            return
        speed = _within(self._target.linear, limits.max_speed_m_s)
        turn = _within(self._target.angular, limits.max_yaw_rate_rad_s)
        self._settled = speed == self._speed and turn == self._turn
        self._speed += _within(speed - self._speed, self._speed_step)
        self._turn += _within(turn - self._turn, self._turn_step)
        self.left_m_s = self._speed - self._turn * self._half_separation_m
        self.right_m_s = self._speed + self._turn * self._half_separation_m


def _within(value: float, limit: float) -> float:
    return max(-limit, min(limit, value))
