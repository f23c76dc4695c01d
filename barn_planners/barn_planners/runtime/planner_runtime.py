"""What a planner's node and a direct trial share: tasks, readiness and commands."""

import math
from dataclasses import dataclass

import numpy as np

from barn_planners.interface import Decision, Observation, Planner, PlannerStatus, Task
from barn_worlds.base.types import (
    NANOSECONDS_PER_SECOND,
    STOP,
    OccupancyMap,
    Odometry,
    Pose2D,
    Scan,
    Velocity2D,
)
from barn_worlds.worlds.cells import OCCUPIED

# After a pause this long, an equal goal is a new task and no repetition of the message.
_NEW_GOAL_PAUSE_NS = NANOSECONDS_PER_SECOND


@dataclass(frozen=True, slots=True)
class RuntimeOutput:
    """What one observation leads to."""

    # Command to send; with None, nothing is sent.
    command: Velocity2D | None
    # What the planner decided; None while there is no task.
    decision: Decision | None = None


class PlannerRuntime:
    """Runs one planner, task after task."""

    def __init__(
        self, planner: Planner, *, seed: int, use_map: bool, repeat_command: bool = True
    ):
        """Hold a planner without goal, map and task; it is not started yet.

        Args:
            planner: Planner to run.
            seed: Seed of the next tasks; it can be changed between them.
            use_map: Whether a task needs a map.
            repeat_command: Whether to send the last command again in cycles without
                one, so that a simulator in lockstep does not wait.
        """
        self.planner = planner
        self.seed = seed
        self._use_map = use_map
        self._repeat_command = repeat_command
        self.reset()

    def reset(self) -> None:
        """Forget goal, map, task and last command; leave the planner as it is."""
        self._goal: Pose2D | None = None
        self._map: OccupancyMap | None = None
        self._task: Task | None = None
        self._command = STOP
        self._status = PlannerStatus.RUNNING
        self._now_ns = 0
        self._goal_ns = 0

    def missing(self) -> str:
        """Return which of goal and map are still missing, empty if none is."""
        missing = [] if self._goal is not None else ["no goal yet"]
        if self._use_map and self._map is None:
            missing.append("no map yet")
        return ", ".join(missing)

    def set_goal(self, goal: Pose2D) -> bool:
        """Set a goal; start a task if new and possible; return whether it has started.

        An equal goal starts a task only if the last one is over and a pause has passed.
        """
        # Goals are repeated, since a planner may start after the first one; a
        # repetition is no new task.
        is_over = self._status in (PlannerStatus.GOAL_REACHED, PlannerStatus.FAILED)
        is_after_pause = self._now_ns - self._goal_ns > _NEW_GOAL_PAUSE_NS
        self._goal_ns = self._now_ns
        if goal == self._goal and not (is_over and is_after_pause):
            return False
        self._goal = goal
        return self._start_task()

    def set_map(self, occupancy: OccupancyMap) -> bool:
        """Set the map if it is used and new; return whether that starts a task."""
        if not self._use_map:
            return False
        # A latched map comes again with each new publisher.
        if self._map is not None and _are_equal(self._map, occupancy):
            return False
        self._map = occupancy
        return self._start_task()

    def restart(self) -> None:
        """Start the same task again if there is one: time has restarted at 0."""
        self._now_ns = self._goal_ns = 0
        self._start_task()

    def step(self, observation: Observation) -> RuntimeOutput:
        """Return decision and command (the last one if it has none; STOP if no task).

        Without `repeat_command`, there is no command where the decision has none.

        Raises:
            TypeError: If the planner's `step` returns no `Decision`.
        """
        self._now_ns = observation.stamp_ns
        if self._task is None:
            return RuntimeOutput(STOP)

        decision = self.planner.step(observation)
        if not isinstance(decision, Decision):
            raise TypeError(
                "a planner's step must return a Decision, such as"
                f" Decision(Velocity2D(0.5, 0.0)), got {decision!r}"
            )
        self._status = decision.status
        if decision.command is not None:
            self._command = decision.command
        elif not self._repeat_command:
            return RuntimeOutput(None, decision)
        return RuntimeOutput(self._command, decision)

    def warm_up(self) -> None:
        """Start the planner and run it on made-up readings, so that kernels compile.

        Otherwise the first cycles of the first trial would be much slower than the
        others.
        """
        occupancy = None
        if self._use_map:
            cells = np.zeros((60, 60), np.int8)
            cells[30, 45] = OCCUPIED
            occupancy = OccupancyMap(cells, 0.15, -4.5, -4.5)
        self.planner.start(Task(Pose2D(4.0, 0.0, 0.0), occupancy), self.seed)

        # The way is free at first, then leads between walls to an obstacle before the
        # goal. In the end the robot is turned away and shut in for long. So most
        # branches are taken, those of recovery too. Each pose comes twice, for plans
        # that are used again, and strides of half a meter move the costmaps along.
        ranges = np.full(720, 5.0, np.float32)
        stamp_ns = 0
        for cycle in range(40):
            stride = min(cycle // 2, 7)
            yaw = 0.1
            stamp_ns += NANOSECONDS_PER_SECOND // 20
            if cycle == 8:
                ranges[:100] = ranges[620:] = 0.5
                ranges[200:240] = np.inf
                ranges[340:380] = 1.0
            if cycle >= 16:
                ranges[:] = 0.4
                yaw = 2.0
                stamp_ns += 2 * NANOSECONDS_PER_SECOND
            pose = Pose2D(0.5 * stride, 0.05 * stride, yaw)
            scan = Scan(stamp_ns, ranges.copy(), -2.35, 4.7 / 719, 0.1, 30.0)
            odometry = Odometry(stamp_ns, pose, Velocity2D(1.0, 0.0))
            self.planner.step(Observation(stamp_ns, odometry, scan, pose))
        self.planner.view()

    def _start_task(self) -> bool:
        """Start a task unless goal or map is missing; return whether it started."""
        if self._goal is None or (self._use_map and self._map is None):
            return False
        self._task = Task(self._goal, self._map)
        self._command = STOP
        self._status = PlannerStatus.RUNNING
        self.planner.start(self._task, self.seed)
        return True


def goal_problem(goal: Pose2D, frame: str, planning_frame: str) -> str:
    """Return why a goal is refused: its frame or its numbers; empty if it is not.

    Args:
        goal: Goal from a message.
        frame: Frame in the header of the message, with or without a leading slash.
        planning_frame: Frame that the planner plans in.
    """
    if frame.lstrip("/") != planning_frame:
        frames = f"{frame!r}, but this planner plans in {planning_frame!r}"
        return f"goal refused: it is in frame {frames}"
    if not all(map(math.isfinite, goal.numbers)):
        return "goal refused: its numbers are not finite"
    return ""


def _are_equal(first: OccupancyMap, second: OccupancyMap) -> bool:
    """Return whether two maps have equal cells, resolutions and origins."""
    return (
        first.resolution == second.resolution
        and first.origin_x == second.origin_x
        and first.origin_y == second.origin_y
        and np.array_equal(first.data, second.data)
    )
