"""The core of a planner's node: tasks, readiness, restarts and which command to send."""

import math
from dataclasses import dataclass

import numpy as np

from barn_planners.interface import Decision, Observation, Planner, PlannerStatus, Task
from barn_worlds.base.types import NANOSECONDS, STOP, OccupancyMap, Odometry, Pose2D, Scan, Velocity2D

_NEW_GOAL_NS = NANOSECONDS  # after a pause this long an equal goal is a new one


@dataclass(frozen=True, slots=True)
class Answer:
    """The command to send for one observation, None for nothing; `decision` is None while there is no task."""

    command: Velocity2D | None
    decision: Decision | None = None


class PlannerSession:
    """Runs one planner, task after task, as goals, maps and observations arrive.

    repeat_command: repeat the last command if the planner sends none, so that a simulator in lockstep need not wait.
    """

    def __init__(self, planner: Planner, *, seed: int, use_map: bool, repeat_command: bool = True):
        self.planner = planner
        self.seed = seed
        self._use_map = use_map
        self._repeat = repeat_command
        self.reset()

    def reset(self) -> None:
        """Forget goal, map and task."""
        self._goal: Pose2D | None = None
        self._map: OccupancyMap | None = None
        self._task: Task | None = None
        self._command = STOP
        self._status = PlannerStatus.RUNNING
        self._now_ns = 0
        self._goal_ns = 0

    def missing(self) -> str:
        """Return what is missing before the planner can drive, or an empty text."""
        missing = [] if self._goal is not None else ["no goal yet"]
        if self._use_map and self._map is None:
            missing.append("no map yet")
        return ", ".join(missing)

    def set_goal(self, goal: Pose2D) -> bool:
        """Set a goal in the planning frame; returns whether it starts a new task.

        An equal goal changes nothing, unless the task is over and the goal comes after a pause.
        """
        finished = self._status in (PlannerStatus.GOAL_REACHED, PlannerStatus.FAILED)
        paused = self._now_ns - self._goal_ns > _NEW_GOAL_NS
        self._goal_ns = self._now_ns
        if goal == self._goal and not (finished and paused):
            return False
        self._goal = goal
        return self._begin()

    def set_map(self, known: OccupancyMap) -> bool:
        """Set the map; returns whether it starts a new task. An equal map does not."""
        if not self._use_map or (self._map is not None and _equal(self._map, known)):
            return False
        self._map = known
        return self._begin()

    def restart(self) -> None:
        """Restart the task, because time has restarted."""
        self._now_ns = self._goal_ns = 0
        self._begin()

    def answer(self, observation: Observation) -> Answer:
        """Return the answer to an observation; a stop while there is no task."""
        self._now_ns = observation.stamp_ns
        if self._task is None:
            return Answer(STOP)
        decision = self.planner.step(observation)
        self._status = decision.status
        command = decision.command
        if command is None:
            return Answer(self._command if self._repeat else None, decision)
        self._command = command
        return Answer(command, decision)

    def warm_up(self) -> None:
        """Run the planner a few times on made-up readings, so that its first real cycles are not slower."""
        known = OccupancyMap(np.zeros((60, 60), np.int8), 0.15, -4.5, -4.5) if self._use_map else None
        self.planner.start(Task(Pose2D(3.0, 0.0, 0.0), known), self.seed)
        ranges = np.full(720, 2.0, np.float32)
        for cycle in range(4):
            stamp = cycle * NANOSECONDS // 20
            scan = Scan(stamp, ranges, -2.35, 4.7 / 719, 0.1, 30.0)
            pose = Pose2D(0.0, 0.0, 0.0)
            self.planner.step(Observation(stamp, Odometry(stamp, pose, STOP), scan, pose))
        self.planner.view()

    def _begin(self) -> bool:
        if self._goal is None or (self._use_map and self._map is None):
            return False
        self._task = Task(self._goal, self._map)
        self._command, self._status = STOP, PlannerStatus.RUNNING
        self.planner.start(self._task, self.seed)
        return True


def goal_problem(goal: Pose2D, frame: str, planning_frame: str) -> str:
    """Return in one line why a goal is refused, or an empty text."""
    if frame.lstrip("/") != planning_frame:
        return f"goal refused: it is in frame {frame!r}, this planner plans in {planning_frame!r}"
    if not all(math.isfinite(value) for value in (goal.x, goal.y, goal.yaw)):
        return "goal refused: it is not a number"
    return ""


def _equal(one: OccupancyMap, other: OccupancyMap) -> bool:
    return (one.resolution, one.origin_x, one.origin_y) == (
        other.resolution,
        other.origin_x,
        other.origin_y,
    ) and np.array_equal(one.data, other.data)
