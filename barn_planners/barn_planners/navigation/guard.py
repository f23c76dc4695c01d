"""Checks of observations and of progress, so that a planner stops with a reason instead of acting on bad data."""

import math
from abc import abstractmethod
from dataclasses import dataclass

import numpy as np
from numba import njit

from barn_planners.interface import Decision, Observation, Planner, PlannerStatus, Task
from barn_worlds.base.config import Checked, quantity
from barn_worlds.base.types import STOP, Pose2D, Scan, nanoseconds

_FURTHEST_M = 1.0e5
_FASTEST = 1.0e3
_INTERRUPTION_NS = nanoseconds(1.0)


@dataclass(frozen=True)
class LidarPlace(Checked):
    """Where the lidar is on the robot."""

    lidar_x_m: float = quantity(0.055, "lidar forward of base_link", "m", -10.0, 10.0)
    lidar_y_m: float = quantity(
        0.0, "lidar left of base_link", "m", -10.0, 10.0, optional=True
    )
    lidar_yaw_rad: float = quantity(
        0.0, "direction of angle 0 of a scan", "rad", -3.15, 3.15, optional=True
    )

    @property
    def lidar(self) -> Pose2D:
        """Pose of the lidar in base_link."""
        return Pose2D(self.lidar_x_m, self.lidar_y_m, self.lidar_yaw_rad)


@dataclass(frozen=True)
class GuardConfig(Checked):
    """When a scan without any return means that the lidar is blind, not that nothing is there."""

    stop_when_blind: bool = quantity(True, "stop while the lidar seems blind")
    blind_near_m: float = quantity(
        2.5,
        "blind at once if the last return was nearer, or none yet",
        "m",
        minimum=0.0,
    )
    blind_limit_s: float = quantity(
        2.0, "blind after this long without a return", "s", minimum=0.0
    )


class ObservationGuard:
    """Finds problems of observations; remembers stamps and returns of one trial."""

    def __init__(self, config: GuardConfig):
        self.config = config
        self.reset()

    def reset(self) -> None:
        """Forget the last trial."""
        self._last_stamp_ns: int | None = None
        self._seen_ns: int | None = None
        self._nearest_m = 0.0

    def problem(self, observation: Observation) -> str:
        """Return in one line why this observation cannot be used, or an empty text."""
        stamp = observation.stamp_ns
        if self._last_stamp_ns is not None and stamp < self._last_stamp_ns:
            return f"the observation is {self._last_stamp_ns - stamp} ns older than the last one"
        self._last_stamp_ns = stamp
        velocity = observation.odometry.velocity
        if not (_usable(observation.odometry.pose) and abs(velocity.linear) < _FASTEST):
            return "the odometry holds no usable pose or velocity"
        if not abs(velocity.angular) < _FASTEST:
            return "the odometry holds no usable yaw rate"
        if not _usable(observation.pose):
            return "the localisation holds no usable pose"
        return self._scan_problem(stamp, observation.scan)

    def _scan_problem(self, stamp_ns: int, scan: Scan) -> str:
        if len(scan.ranges) == 0:
            return "the scan is empty"
        if not all(
            map(math.isfinite, (scan.angle_min, scan.angle_increment, scan.range_min))
        ):
            return "the scan holds no usable angles"
        nearest_m, beyond = _nearest(scan.ranges, scan.range_min, scan.range_max)
        if nearest_m < math.inf:
            self._seen_ns, self._nearest_m = stamp_ns, nearest_m
            return ""
        if not beyond:
            return "the scan holds no valid range"
        return self._blind_problem(stamp_ns)

    def _blind_problem(self, stamp_ns: int) -> str:
        if not self.config.stop_when_blind:
            return ""
        if self._seen_ns is None:
            return "the lidar has returned nothing yet"
        if self._nearest_m < self.config.blind_near_m:
            return f"the lidar returns nothing though an obstacle was {self._nearest_m:.2f} m away"
        if stamp_ns - self._seen_ns > nanoseconds(self.config.blind_limit_s):
            return f"the lidar has returned nothing for more than {self.config.blind_limit_s:g} s"
        return ""


@njit(cache=True)
def _nearest(ranges, range_min, range_max):  # type: ignore[no-untyped-def]
    """Return the least valid range of a scan, inf if there is none, and whether a beam went beyond the highest."""
    lowest, highest = np.float32(range_min), np.float32(range_max)
    nearest, beyond = np.float32(np.inf), False
    for k in range(len(ranges)):
        beyond |= ranges[k] >= highest
        if lowest <= ranges[k] < highest:
            nearest = min(nearest, ranges[k])
    return float(nearest), beyond


def _usable(pose: Pose2D) -> bool:
    return (
        abs(pose.x) < _FURTHEST_M
        and abs(pose.y) < _FURTHEST_M
        and math.isfinite(pose.yaw)
    )


class ScanPlanner(Planner):
    """Drives to the goal by what it sees: a map is ignored, and nothing is random."""

    def __init__(self, guard: GuardConfig, goal_tolerance_m: float):
        self._guard, self._goal_tolerance_m = ObservationGuard(guard), goal_tolerance_m
        self._task: Task | None = None

    def start(self, task: Task, seed: int) -> None:
        """Begin a new trial."""
        del seed
        self._task = task
        self._guard.reset()

    def step(self, observation: Observation) -> Decision:
        """Return a stop with a reason, at the goal or where an observation is of no use; else drive."""
        if self._task is None:
            return Decision(STOP, PlannerStatus.BLOCKED, "no task yet")
        problem, goal = (
            self._guard.problem(observation) or self.problem(observation.scan),
            self._task.goal,
        )
        distance_m = observation.pose.distance(goal)
        if not problem and not math.isfinite(distance_m):
            problem = "the goal is not at a usable position"
        if problem:
            return Decision(STOP, PlannerStatus.BLOCKED, problem)
        if distance_m <= self._goal_tolerance_m:
            return Decision(STOP, PlannerStatus.GOAL_REACHED, "the goal is reached")
        return self.drive(observation, goal)

    def problem(self, scan: Scan) -> str:
        """Return in one line why this planner cannot use a scan, or an empty text."""
        del scan
        return ""

    @abstractmethod
    def drive(self, observation: Observation, goal: Pose2D) -> Decision:
        """Return the decision on the way to a goal in the planning frame."""


class ProgressCheck:
    """Requires `distance_m` of motion every `limit_s`; restarts after a pause of control, such as a recovery."""

    def __init__(self, distance_m: float, limit_s: float):
        self._distance_m = distance_m
        self._limit_ns = nanoseconds(limit_s)
        self.reset()

    def reset(self) -> None:
        """Forget the last trial."""
        self._place: Pose2D | None = None
        self._since_ns = 0
        self._last_ns = 0

    def stuck(self, stamp_ns: int, pose: Pose2D) -> bool:
        """Update with the robot's pose; tell whether it has been near one place for too long."""
        interrupted = stamp_ns - self._last_ns > _INTERRUPTION_NS
        self._last_ns = stamp_ns
        if (
            self._place is None
            or interrupted
            or self._place.distance(pose) >= self._distance_m
        ):
            self._place, self._since_ns = pose, stamp_ns
        return stamp_ns - self._since_ns > self._limit_ns
