"""Recovery as in move_base: what the robot does without a plan or a valid command.

Recovery begins when patience runs out. Four behaviors follow one another: clear the
costmaps far from the robot, turn in place, clear them nearby too, and turn again. The
controller is tried after each. If the last one does not help, the planner gives up.
"""

import math
from collections.abc import Sequence
from dataclasses import dataclass

from barn_planners.costmap.costmap import Costmap
from barn_worlds.base.config import Checked, quantity
from barn_worlds.base.types import STOP, Pose2D, Velocity2D, nanoseconds, wrap_angle

# Behaviors by their place in the sequence.
_CONSERVATIVE_CLEARING = 0
_AGGRESSIVE_CLEARING = 2
_TURNS = (1, 3)
_LAST_BEHAVIOR = 3
# Angle between the poses at which a turn is checked for collisions, in rad.
_TURN_STEP_RAD = 0.02


@dataclass(frozen=True)
class RecoveryConfig(Checked):
    """Settings of move_base's recovery behaviors, and the patience before them."""

    controller_patience_s: float = quantity(
        15.0, "time without a valid command before recovery", "s", minimum=0.0
    )
    planner_patience_s: float = quantity(
        5.0, "time without a plan before recovery", "s", minimum=0.0
    )
    conservative_reset_m: float = quantity(
        3.0, "side of the square that the first clearing keeps", "m", minimum=0.0
    )
    aggressive_reset_m: float = quantity(
        1.84, "side of the square that the second clearing keeps", "m", minimum=0.0
    )
    clearing_clears: bool = quantity(
        True, "false: clearing changes nothing (a quirk of the paper's setup)"
    )
    min_turn_radps: float = quantity(0.4, "slowest turn in place", "rad/s", 0.01, 10.0)
    max_turn_radps: float = quantity(1.0, "fastest turn in place", "rad/s", 0.01, 10.0)
    turn_acceleration_radps2: float = quantity(
        3.2, "deceleration assumed for the turn", "rad/s2", minimum=0.01
    )
    turn_tolerance_rad: float = quantity(
        0.1, "angle by which a full turn may fall short", "rad", 0.0, 3.0
    )


class Recovery:
    """Decides when recovery begins and runs its behaviors, one cycle at a time."""

    def __init__(self, config: RecoveryConfig):
        """Store the configuration; patience starts at time 0."""
        self.config = config
        self.restart(0)

    def restart(self, stamp_ns: int) -> None:
        """Restart patience at a stamp in ns; return to the first behavior, inactive."""
        self.active = False
        self.aborted = False
        self._behavior = 0
        self._is_for_plan = False
        self._plan_ns = self._command_ns = stamp_ns
        # Yaw in the last cycle of a turn; None while the robot does not turn.
        self._last_yaw: float | None = None

    def record_plan(self, stamp_ns: int) -> None:
        """Restart patience for plans, and behaviors if a plan was missing; clear no flag.

        `active` stays as it is.
        """
        self._plan_ns = stamp_ns
        # move_base starts over only if what it waited for has come: the plan, not a
        # command.
        if self._is_for_plan:
            self._behavior = 0

    def record_command(self, stamp_ns: int) -> None:
        """Restart the patience for commands, and behaviors unless a plan was missing.

        `active` stays as it is.
        """
        self._command_ns = stamp_ns
        if not self._is_for_plan:
            self._behavior = 0

    def record_missing_plan(self, stamp_ns: int) -> None:
        """Start recovery (`active`) if the last plan is older than the patience."""
        if stamp_ns - self._plan_ns > nanoseconds(self.config.planner_patience_s):
            self.active = self._is_for_plan = True

    def record_missing_command(self, stamp_ns: int) -> None:
        """Start recovery (`active`) if the last command is older than the patience."""
        if stamp_ns - self._command_ns > nanoseconds(self.config.controller_patience_s):
            self.active = True
            self._is_for_plan = False

    def step(
        self, stamp_ns: int, costmap_poses: Sequence[tuple[Costmap, Pose2D]]
    ) -> Velocity2D:
        """Clear costmaps or turn for one cycle; return the command, STOP at the end.

        Sets `active` to False at the end of a behavior, and `aborted` after the last.

        Args:
            stamp_ns: Simulated time in ns.
            costmap_poses: Costmaps to clear, each with the robot's pose in its frame.
                The first is the local one, which turns are checked against.

        Returns:
            The command of this cycle; a stop at the end of a behavior.
        """
        command = None
        # A plan that arrives during a turn resets the sequence, but the turn goes on.
        if self._last_yaw is not None or self._behavior in _TURNS:
            command = self._turn(*costmap_poses[0])
        elif self.config.clearing_clears:
            self._clear(costmap_poses)

        self.aborted |= self._last_yaw is None and self._behavior > _LAST_BEHAVIOR
        if command is not None:
            return command
        self._last_yaw = None
        self.active = False
        self._behavior += 1
        self._plan_ns = self._command_ns = stamp_ns
        return STOP

    def _clear(self, costmap_poses: Sequence[tuple[Costmap, Pose2D]]) -> None:
        """Clear lidar marks outside a square at the robot if the behavior clears."""
        if self._behavior == _CONSERVATIVE_CLEARING:
            side_m = self.config.conservative_reset_m
        elif self._behavior == _AGGRESSIVE_CLEARING:
            side_m = self.config.aggressive_reset_m
        else:
            return
        for costmap, pose in costmap_poses:
            costmap.clear_outside(pose, side_m)

    def _turn(self, costmap: Costmap, pose: Pose2D) -> Velocity2D | None:
        """Return the next command of a full left turn, None if done or blocked."""
        config = self.config
        if self._last_yaw is None:
            self._last_yaw = pose.yaw
            self._angle_left = 2.0 * math.pi
        self._angle_left -= wrap_angle(pose.yaw - self._last_yaw)
        self._last_yaw = pose.yaw
        if self._angle_left <= config.turn_tolerance_rad:
            return None

        for k in range(int(self._angle_left / _TURN_STEP_RAD) + 1):
            if not costmap.has_room(*pose.position, pose.yaw + _TURN_STEP_RAD * k):
                return None

        # The highest rate from which the robot can still stop at the end of the turn.
        rate = math.sqrt(2.0 * config.turn_acceleration_radps2 * self._angle_left)
        rate = min(max(rate, config.min_turn_radps), config.max_turn_radps)
        return Velocity2D(0.0, rate)
