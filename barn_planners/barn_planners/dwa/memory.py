"""What the dynamic window approach remembers between cycles."""

import math
from collections.abc import Callable

from barn_planners.dwa.config import DwaConfig
from barn_planners.navigation.loop import Control, ControlInput
from barn_worlds.base.types import STOP, Pose2D, Velocity2D, wrap_angle

LEFT = 0
RIGHT = 1


class GoalTurn:
    """Brakes at the goal's position, then turns in place to its heading.

    Follows `TrajectoryPlannerROS::stopWithAccLimits` and `rotateToGoal`
    (trajectory_planner_ros.cpp). Once it turns, it does not brake again.
    """

    def __init__(self, config: DwaConfig):
        """Store the limits; braking comes first."""
        self._config = config
        self._speed_change = config.acceleration_mps2 * config.window_period_s
        self._turn_change = config.turn_acceleration_radps2 * config.window_period_s
        self.reset()

    def reset(self) -> None:
        """Forget that the robot has begun to turn at the goal."""
        self._is_turning = False

    def is_aligned(self, pose: Pose2D, goal: Pose2D) -> bool:
        """Return whether the robot's yaw is within the tolerance of the goal's.

        Args:
            pose: Pose of the robot.
            goal: Goal in the same frame.
        """
        return abs(wrap_angle(goal.yaw - pose.yaw)) <= self._config.yaw_tolerance_rad

    def control(
        self, inputs: ControlInput, goal: Pose2D, allows: Callable[[Velocity2D], bool]
    ) -> Control:
        """Return a command to brake, then turn; STOP once aligned; none if refused.

        Args:
            inputs: Input of the cycle.
            goal: Goal in the frame of the input.
            allows: Tells whether there is room for a command.
        """
        # Before everything else: a robot that rolls through the heading has reached the
        # goal.
        if self.is_aligned(inputs.pose, goal):
            self._is_turning = False
            return Control(STOP, goal_reached=True)

        config = self._config
        speed = inputs.velocity.linear
        turn = inputs.velocity.angular
        if abs(speed) <= config.stopped_mps and abs(turn) <= config.stopped_radps:
            self._is_turning = True
        # Once it turns, it goes on though it is no longer at rest.
        if self._is_turning:
            angle = wrap_angle(goal.yaw - inputs.pose.yaw)
            command = Velocity2D(0.0, self._turn_rate(angle, abs(turn)))
            if allows(command):
                return Control(command)
            return Control(None, reason="no room to turn to the goal's heading")

        slower = max(0.0, abs(speed) - self._speed_change)
        turning_slower = max(0.0, abs(turn) - self._turn_change)
        command = Velocity2D(
            math.copysign(slower, speed), math.copysign(turning_slower, turn)
        )
        if config.roll_out_goal_turn and not allows(command):
            return Control(None, reason="no room to brake at the goal")
        return Control(command)

    def _turn_rate(self, angle: float, present: float) -> float:
        """Return the signed yaw rate in rad/s for an angle in rad that remains.

        The rate is low enough to stop in time, but at least `min_turn_in_place_radps`.
        `present` is the absolute yaw rate now.
        """
        config = self._config
        slowest = config.min_turn_in_place_radps
        fastest = config.max_goal_turn_radps
        # Proportional to the angle, then within what the robot can change in a cycle.
        rate = min(fastest, max(slowest, abs(angle)))
        rate = max(rate, present - self._turn_change)
        rate = min(rate, present + self._turn_change)
        # v^2 = 2 a s: from this rate it can stop at the goal's heading.
        rate = min(rate, math.sqrt(2.0 * config.turn_acceleration_radps2 * abs(angle)))
        return math.copysign(min(fastest, max(slowest, rate)), angle)


class DwaMemory:
    """Forbids samples by which a robot would oscillate in place or undo an escape.

    Follows the flags stuck_left, stuck_right and escaping_ of trajectory_planner.cpp.
    """

    def __init__(self, config: DwaConfig):
        """Begin with both turns in place allowed and without an escape."""
        self._config = config
        self.reset()

    def reset(self) -> None:
        """Allow turns in place to both sides and end any escape."""
        self._escape_start: Pose2D | None = None
        self._allow_both_turns()

    def _allow_both_turns(self) -> None:
        """Forget past turns in place, so that neither side is forbidden."""
        self._last_turn_pose: Pose2D | None = None
        # By side: whether the robot turned in place to it, and whether twice.
        self._turns_once = [False, False]
        self._turns_twice = [False, False]

    @property
    def is_escaping(self) -> bool:
        """Whether an escape backwards goes on, so that driving forward is forbidden."""
        return self._escape_start is not None

    def allowed_turns(self) -> tuple[bool, bool]:
        """Return whether turns in place are allowed: (to the left, to the right).

        After two turns to one side, the other side is forbidden until the robot moves.
        """
        return not self._turns_twice[RIGHT], not self._turns_twice[LEFT]

    def record_sample(self, pose: Pose2D, speed: float, turn: float) -> None:
        """Record a cycle's best sample; its pose may end an escape or a ban on turns.

        Args:
            pose: Pose of the robot.
            speed: Forward speed of the sample in m/s.
            turn: Yaw rate of the sample in rad/s.
        """
        # Only turns in place can go on forever.
        if speed <= 0.0:
            side = LEFT if turn > 0.0 else RIGHT
            self._turns_twice[side] = self._turns_once[side]
            self._turns_once[side] = True
            self._last_turn_pose = pose
        self._record_pose(pose)

    def record_escape(self, pose: Pose2D, *, may_begin: bool) -> None:
        """Record a cycle without an allowed sample, which may begin or end an escape.

        Args:
            pose: Pose of the robot.
            may_begin: Whether this may be the first cycle of an escape.
        """
        if may_begin and self._escape_start is None:
            self._escape_start = pose
        self._record_pose(pose)

    def _record_pose(self, pose: Pose2D) -> None:
        """Allow both turns, and end the escape, once the robot has moved far enough."""
        config = self._config
        turn_pose = self._last_turn_pose
        if turn_pose and pose.distance(turn_pose) > config.oscillation_reset_m:
            self._allow_both_turns()

        start = self._escape_start
        if start and (
            pose.distance(start) > config.escape_reset_m
            or abs(wrap_angle(pose.yaw - start.yaw)) > config.escape_reset_rad
        ):
            self._escape_start = None
