"""The base of planners that need nothing but the goal and the current scan."""

import math
from abc import abstractmethod

import numpy as np

from barn_planners.interface import (
    Decision,
    FloatArray,
    Observation,
    Planner,
    PlannerStatus,
    Task,
)
from barn_planners.navigation.observation_check import (
    ObservationCheck,
    ObservationCheckConfig,
)
from barn_worlds.base.types import STOP, Pose2D, Scan


class ScanPlanner(Planner):
    """Drives to the goal by its scans, without a map or randomness."""

    def __init__(self, check: ObservationCheckConfig, goal_tolerance_m: float):
        """Make the check of readings; the goal is reached within `goal_tolerance_m`."""
        self._check = ObservationCheck(check)
        self._goal_tolerance_m = goal_tolerance_m
        self._task: Task | None = None

    def start(self, task: Task, seed: int) -> None:
        """Begin a new trial and forget the last one; map and seed are ignored.

        Args:
            task: Goal in the planning frame; its map is ignored.
            seed: Ignored.
        """
        del seed
        self._task = task
        self._check.reset()

    def step(self, observation: Observation) -> Decision:
        """Return a stop at the goal or on unusable readings, else `drive`'s decision."""
        if self._task is None:
            return Decision(STOP, PlannerStatus.BLOCKED, "no task yet")

        goal = self._task.goal
        problem = self._check.problem(observation) or self.problem(observation.scan)
        distance_m = observation.pose.distance(goal)
        if not problem and not math.isfinite(distance_m):
            problem = "the goal's position is unusable"
        if problem:
            return Decision(STOP, PlannerStatus.BLOCKED, problem)
        # Only the position counts; the goal's heading is for planners that follow a
        # plan.
        if distance_m <= self._goal_tolerance_m:
            return Decision(STOP, PlannerStatus.GOAL_REACHED, "the goal is reached")
        return self.drive(observation, goal)

    def problem(self, scan: Scan) -> str:
        """Return why this planner cannot use a scan, an empty string by default."""
        del scan
        return ""

    @abstractmethod
    def drive(self, observation: Observation, goal: Pose2D) -> Decision:
        """Return the decision that drives toward the goal, after all checks.

        Args:
            observation: Readings that passed all checks.
            goal: Goal in the planning frame, beyond the goal tolerance.
        """


def scan_points(scan: Scan, lidar: Pose2D, max_range_m: float) -> FloatArray:
    """Return valid returns below `max_range_m` as points (n, 2) in m in base_link.

    Args:
        scan: Scan of any number of beams.
        lidar: Pose of the lidar in base_link.
        max_range_m: Returns at this range or beyond are left out, in m from the lidar.

    Returns:
        Points (n, 2) in m in base_link.
    """
    # NaN fails both comparisons and drops out with the invalid ranges.
    ranges = scan.ranges.astype(np.float64)
    longest_m = min(scan.range_max, max_range_m)
    is_valid = (ranges >= scan.shortest_return_m) & (ranges < longest_m)
    ranges = ranges[is_valid]
    angles = scan.angles()[is_valid] + lidar.yaw
    x = lidar.x + ranges * np.cos(angles)
    y = lidar.y + ranges * np.sin(angles)
    return np.stack([x, y], axis=1)
