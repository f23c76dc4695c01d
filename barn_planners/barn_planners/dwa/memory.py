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
        self._drop = config.acceleration_mps2 * config.window_period_s
        self._turn_drop = config.turn_acceleration_radps2 * config.window_period_s
        self.reset()

    def reset(self) -> None:
        """Forget the last trial."""
        self._turning = False

    def reached(self, inputs: ControlInput, goal: Pose2D) -> bool:
        """Tell whether the goal's heading is reached."""
        return (
            abs(wrap_angle(goal.yaw - inputs.pose.yaw))
            <= self._config.yaw_tolerance_rad
        )

    def control(
        self, inputs: ControlInput, goal: Pose2D, allows: Callable[[Velocity2D], bool]
    ) -> Control:
        """Return the command at the goal's position; allows: tells whether there is room for a command."""
        config, (linear, angular) = (
            self._config,
            (inputs.velocity.linear, inputs.velocity.angular),
        )
        if self.reached(inputs, goal):
            self._turning = False
            return Control(STOP, goal_reached=True)
        self._turning |= (
            abs(linear) <= config.stopped_mps and abs(angular) <= config.stopped_radps
        )
        if self._turning:
            turn = Velocity2D(
                0.0, self._rate(wrap_angle(goal.yaw - inputs.pose.yaw), abs(angular))
            )
            return (
                Control(turn)
                if allows(turn)
                else Control(None, reason="no room to turn to the goal's heading")
            )
        braking = Velocity2D(
            math.copysign(max(0.0, abs(linear) - self._drop), linear),
            math.copysign(max(0.0, abs(angular) - self._turn_drop), angular),
        )
        if config.roll_out_goal_turn and not allows(braking):
            return Control(None, reason="no room to brake at the goal")
        return Control(braking)

    def _rate(self, angle: float, rate_now: float) -> float:
        """Return the turn rate for a remaining angle; slow enough to stop in time."""
        slowest, fastest = (
            self._config.min_turn_in_place_radps,
            self._config.max_goal_turn_radps,
        )
        wanted = min(fastest, max(slowest, abs(angle)))
        wanted = min(
            max(wanted, rate_now - self._turn_drop), rate_now + self._turn_drop
        )
        wanted = min(
            wanted, math.sqrt(2.0 * self._config.turn_acceleration_radps2 * abs(angle))
        )
        return math.copysign(min(fastest, max(slowest, wanted)), angle)


class DwaMemory:
    """Keeps the robot from oscillating in place, and from driving forward during an escape."""

    def __init__(self, config: DwaConfig):
        self._config = config
        self.reset()

    def reset(self) -> None:
        """Forget everything."""
        self._turned, self._committed = [False, False], [False, False]
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
            self._committed[side], self._turned[side], self._turned_at = (
                self._turned[side],
                True,
                pose,
            )
        self._moved(pose)

    def escapes(self, pose: Pose2D, *, begin: bool) -> None:
        """Record an escape at a pose; `begin`: it may be the first cycle of one."""
        if begin and self._escape_from is None:
            self._escape_from = pose
        self._moved(pose)

    def _moved(self, pose: Pose2D) -> None:
        config, start = self._config, self._escape_from
        if (
            self._turned_at is not None
            and pose.distance(self._turned_at) > config.oscillation_reset_m
        ):
            self._turned, self._committed, self._turned_at = (
                [False, False],
                [False, False],
                None,
            )
        if start is not None:
            turned_rad = abs(wrap_angle(pose.yaw - start.yaw))
            if (
                pose.distance(start) > config.escape_reset_m
                or turned_rad > config.escape_reset_rad
            ):
                self._escape_from = None
