"""The last stage of the dynamic window approach: stop at the goal and turn to its heading."""

import math

from barn_planners.controller import Control, ControlInput
from barn_planners.dwa_config import DwaConfig
from barn_worlds.types import STOP, Pose2D, Velocity2D, wrap_angle


class GoalTurn:
    """Brakes, then turns in place. Once it turns it does not brake again."""

    def __init__(self, config: DwaConfig):
        self._config = config
        self.reset()

    def reset(self) -> None:
        """Forget the last trial."""
        self._turning = False

    def control(self, inputs: ControlInput, goal: Pose2D) -> Control:
        """Return the command at the goal's position; the goal is reached once the heading is."""
        angle = wrap_angle(goal.yaw - inputs.pose.yaw)
        if abs(angle) <= self._config.yaw_tolerance_rad:
            self._turning = False
            return Control(STOP, goal_reached=True)
        velocity = inputs.velocity
        standing = (
            abs(velocity.linear) <= self._config.stopped_mps and abs(velocity.angular) <= self._config.stopped_radps
        )
        if not self._turning and not standing:
            return Control(self._braking(velocity))
        self._turning = True
        if not inputs.costmap.has_room(inputs.pose.x, inputs.pose.y, inputs.pose.yaw):
            return Control(None, reason="no room to turn to the goal's heading")
        return Control(Velocity2D(0.0, self._rate(angle, velocity.angular)))

    def _braking(self, velocity: Velocity2D) -> Velocity2D:
        """Return the velocity after one period of braking as hard as allowed."""
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
