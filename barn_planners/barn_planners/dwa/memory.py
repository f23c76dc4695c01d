"""What the dynamic window approach remembers between cycles: allowed turns, an escape, the final turn at the goal."""

import math
from collections.abc import Callable

from barn_planners.dwa.config import DwaConfig
from barn_planners.navigation.loop import Control, ControlInput
from barn_worlds.base.types import STOP, Pose2D, Velocity2D, wrap_angle

LEFT, RIGHT = 0, 1


class GoalTurn:
    """Brakes, then turns in place. Once it turns it does not brake again."""

    def __init__(self, config: DwaConfig):
        self._config = config
        self._turning = False

    def reset(self) -> None:
        """Forget the last trial."""
        self._turning = False

    def reached(self, inputs: ControlInput, goal: Pose2D) -> bool:
        """Tell whether the goal's heading is reached."""
        return abs(wrap_angle(goal.yaw - inputs.pose.yaw)) <= self._config.yaw_tolerance_rad

    def control(self, inputs: ControlInput, goal: Pose2D, allows: Callable[[Velocity2D], bool]) -> Control:
        """Return the command at the goal's position; allows: tells whether there is room for a command."""
        if self.reached(inputs, goal):
            self._turning = False
            return Control(STOP, goal_reached=True)
        angle = wrap_angle(goal.yaw - inputs.pose.yaw)
        velocity = inputs.velocity
        standing = (
            abs(velocity.linear) <= self._config.stopped_mps and abs(velocity.angular) <= self._config.stopped_radps
        )
        if not self._turning and not standing:
            braking = self._braking(velocity)
            if self._config.roll_out_goal_turn and not allows(braking):
                return Control(None, reason="no room to brake at the goal")
            return Control(braking)
        self._turning = True
        turn = Velocity2D(0.0, self._rate(angle, velocity.angular))
        if not allows(turn):
            return Control(None, reason="no room to turn to the goal's heading")
        return Control(turn)

    def _braking(self, velocity: Velocity2D) -> Velocity2D:
        config = self._config
        drop = config.acceleration_mps2 * config.window_period_s
        turn_drop = config.turn_acceleration_radps2 * config.window_period_s
        return Velocity2D(
            math.copysign(max(0.0, abs(velocity.linear) - drop), velocity.linear),
            math.copysign(max(0.0, abs(velocity.angular) - turn_drop), velocity.angular),
        )

    def _rate(self, angle: float, rate_now: float) -> float:
        """Return the turn rate for a remaining angle; slow enough to stop in time."""
        config = self._config
        slowest = config.min_turn_in_place_radps
        wanted = min(config.max_goal_turn_radps, max(slowest, abs(angle)))
        change = config.turn_acceleration_radps2 * config.window_period_s
        wanted = min(max(wanted, abs(rate_now) - change), abs(rate_now) + change)
        wanted = min(wanted, math.sqrt(2.0 * config.turn_acceleration_radps2 * abs(angle)))
        wanted = min(config.max_goal_turn_radps, max(slowest, wanted))
        return math.copysign(wanted, angle)


class DwaMemory:
    """Keeps the robot from oscillating in place, and from driving forward during an escape."""

    def __init__(self, config: DwaConfig):
        self._config = config
        self.reset()

    def reset(self) -> None:
        """Forget everything."""
        self._turned = [False, False]
        self._committed = [False, False]
        self._turned_at: Pose2D | None = None
        self._escape_from: Pose2D | None = None

    @property
    def escaping(self) -> bool:
        """Whether an escape is in progress, so that driving forward is forbidden."""
        return self._escape_from is not None

    def allowed_turns(self) -> tuple[bool, bool]:
        """Return whether turns to left and right are allowed; after two to one side the other is forbidden."""
        return not self._committed[RIGHT], not self._committed[LEFT]

    def chose(self, pose: Pose2D, speed: float, turn: float) -> None:
        """Record the sample chosen at a pose."""
        if speed <= 0.0:
            side = LEFT if turn > 0.0 else RIGHT
            self._committed[side] = self._turned[side]
            self._turned[side] = True
            self._turned_at = pose
        self._moved(pose)

    def escapes(self, pose: Pose2D, *, begin: bool) -> None:
        """Record an escape at a pose; `begin`: it may be the first cycle of one."""
        if begin and self._escape_from is None:
            self._escape_from = pose
        self._moved(pose)

    def _moved(self, pose: Pose2D) -> None:
        if self._turned_at is not None and pose.distance(self._turned_at) > self._config.oscillation_reset_m:
            self._turned, self._committed, self._turned_at = [False, False], [False, False], None
        start = self._escape_from
        if start is not None and (
            pose.distance(start) > self._config.escape_reset_m
            or abs(wrap_angle(pose.yaw - start.yaw)) > self._config.escape_reset_rad
        ):
            self._escape_from = None
