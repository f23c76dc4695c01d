"""Recovery as in move_base, without a plan or a valid command: patience, clearing, turning in place, giving up."""

import math
from dataclasses import dataclass

from barn_planners.costmap.costmap import Costmap
from barn_worlds.base.config import Checked, quantity
from barn_worlds.base.types import Pose2D, Velocity2D, nanoseconds, wrap_angle


@dataclass(frozen=True)
class RecoveryConfig(Checked):
    """The recovery behaviours of move_base and the time before them."""

    controller_patience_s: float = quantity(15.0, "time without a valid command before recovery", "s", minimum=0.0)
    planner_patience_s: float = quantity(5.0, "time without a plan before recovery", "s", minimum=0.0)
    conservative_reset_m: float = quantity(3.0, "side of the square that the first clearing keeps", "m", minimum=0.0)
    aggressive_reset_m: float = quantity(1.84, "side of the square that the second clearing keeps", "m", minimum=0.0)
    clearing_clears: bool = quantity(True, "false: clearing changes nothing (a quirk of the paper's set-up)")
    min_turn_radps: float = quantity(0.4, "slowest turn in place", "rad/s", 0.01, 10.0)
    max_turn_radps: float = quantity(1.0, "fastest turn in place", "rad/s", 0.01, 10.0)
    turn_acceleration_radps2: float = quantity(3.2, "assumed deceleration of the turn", "rad/s2", minimum=0.01)
    turn_tolerance_rad: float = quantity(0.1, "tolerance of a full turn", "rad", 0.0, 3.0)


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
        self._turn: _Turn | None = None

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
        self, stamp_ns: int, pose: Pose2D, local: Costmap, clear: tuple[tuple[Costmap, Pose2D], ...]
    ) -> Velocity2D:
        """Continue for a cycle and return its command; clear: costmaps to clear, each with the robot in its frame."""
        command = None
        if self._turn is not None:
            command = self._turn.step(pose, local)
        elif self._next in (0, 2):
            if self.config.clearing_clears:
                side_m = self.config.conservative_reset_m if self._next == 0 else self.config.aggressive_reset_m
                for costmap, robot in clear:
                    costmap.clear_outside(robot, side_m)
        elif self._next in (1, 3):
            self._turn = _Turn(self.config, pose.yaw)
            command = self._turn.step(pose, local)
        else:
            self.aborted = True
        if command is None:
            self._turn = None
            self._next += 1
            self.active = False
            self._plan_ns = self._control_ns = stamp_ns
        return command or Velocity2D()


class _Turn:
    """One full turn to the left."""

    def __init__(self, config: RecoveryConfig, yaw: float):
        self._config = config
        self._yaw = yaw
        self._left = 2.0 * math.pi

    def step(self, pose: Pose2D, costmap: Costmap) -> Velocity2D | None:
        """Return the next command, None when the turn is done or blocked."""
        self._left -= wrap_angle(pose.yaw - self._yaw)
        self._yaw = pose.yaw
        if self._left <= self._config.turn_tolerance_rad or not _turn_is_free(pose, self._left, costmap):
            return None
        speed = math.sqrt(2.0 * self._config.turn_acceleration_radps2 * self._left)
        return Velocity2D(0.0, min(max(speed, self._config.min_turn_radps), self._config.max_turn_radps))


def _turn_is_free(pose: Pose2D, angle: float, costmap: Costmap) -> bool:
    return all(costmap.has_room(pose.x, pose.y, pose.yaw + 0.02 * k) for k in range(int(angle / 0.02) + 1))
