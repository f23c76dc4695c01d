"""Recovery as in move_base, without a plan or a valid command: patience, clearing, turning in place, giving up."""

import math
from dataclasses import dataclass

from barn_planners.costmap.costmap import Costmap
from barn_worlds.base.config import Checked, quantity
from barn_worlds.base.types import Pose2D, Velocity2D, nanoseconds, wrap_angle


@dataclass(frozen=True)
class RecoveryConfig(Checked):
    """The recovery behaviours of move_base and the time before them."""

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
        True, "false: clearing changes nothing (a quirk of the paper's set-up)"
    )
    min_turn_radps: float = quantity(0.4, "slowest turn in place", "rad/s", 0.01, 10.0)
    max_turn_radps: float = quantity(1.0, "fastest turn in place", "rad/s", 0.01, 10.0)
    turn_acceleration_radps2: float = quantity(
        3.2, "assumed deceleration of the turn", "rad/s2", minimum=0.01
    )
    turn_tolerance_rad: float = quantity(
        0.1, "tolerance of a full turn", "rad", 0.0, 3.0
    )


class Recovery:
    """The recovery of one trial: measures patience and, when it runs out, runs the four behaviours in order."""

    def __init__(self, config: RecoveryConfig):
        self.config = config
        self.restart(0)

    def restart(self, stamp_ns: int) -> None:
        """Restart, as for a new goal."""
        self.active = False
        self.aborted = False
        self._next = 0
        self._for_plan = False
        self._plan_ns = self._control_ns = stamp_ns
        self._turning_from: float | None = None  # yaw of the last cycle of a turn

    def found_plan(self, stamp_ns: int) -> None:
        """Record that there is a plan."""
        self._plan_ns = stamp_ns
        if self._for_plan:
            self._next = 0

    def found_command(self, stamp_ns: int) -> None:
        """Record a valid command."""
        self._control_ns = stamp_ns
        if not self._for_plan:
            self._next = 0

    def missing_plan(self, stamp_ns: int) -> None:
        """Record a cycle without a plan; starts recovery when patience runs out."""
        if stamp_ns - self._plan_ns > nanoseconds(self.config.planner_patience_s):
            self.active = self._for_plan = True

    def missing_command(self, stamp_ns: int) -> None:
        """Record a cycle without a valid command; starts recovery when patience runs out."""
        if stamp_ns - self._control_ns > nanoseconds(self.config.controller_patience_s):
            self.active, self._for_plan = True, False

    def step(
        self,
        stamp_ns: int,
        pose: Pose2D,
        local: Costmap,
        clear: tuple[tuple[Costmap, Pose2D], ...],
    ) -> Velocity2D:
        """Continue for a cycle and return its command; clear: costmaps to clear, each with the robot in its frame."""
        command = None
        if self._turning_from is not None or self._next in (1, 3):
            command = self._turn(pose, local)
        elif self._next in (0, 2) and self.config.clearing_clears:
            side_m = (
                self.config.conservative_reset_m
                if self._next == 0
                else self.config.aggressive_reset_m
            )
            for costmap, robot in clear:
                costmap.clear_outside(robot, side_m)
        self.aborted |= self._turning_from is None and self._next > 3
        if command is None:
            self._turning_from, self.active = None, False
            self._next += 1
            self._plan_ns = self._control_ns = stamp_ns
        return command or Velocity2D()

    def _turn(self, pose: Pose2D, costmap: Costmap) -> Velocity2D | None:
        """Return the next command of a full turn to the left, None when it is done or blocked."""
        config = self.config
        if self._turning_from is None:
            self._turning_from, self._left = pose.yaw, 2.0 * math.pi
        self._left -= wrap_angle(pose.yaw - self._turning_from)
        self._turning_from = pose.yaw
        yaws = (pose.yaw + 0.02 * k for k in range(int(self._left / 0.02) + 1))
        if self._left <= config.turn_tolerance_rad or not all(
            costmap.has_room(pose.x, pose.y, yaw) for yaw in yaws
        ):
            return None
        speed = math.sqrt(2.0 * config.turn_acceleration_radps2 * self._left)
        return Velocity2D(
            0.0, min(max(speed, config.min_turn_radps), config.max_turn_radps)
        )
