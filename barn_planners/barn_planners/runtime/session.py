"""The core of a planner's node: readings to observations, tasks, readiness, restarts and which command to send."""

import math
from collections import OrderedDict
from dataclasses import dataclass
from typing import Generic, TypeVar

import numpy as np

from barn_planners.interface import Decision, Observation, Planner, PlannerStatus, Task
from barn_worlds.base.config import Checked, quantity
from barn_worlds.base.types import (
    NANOSECONDS_PER_SECOND,
    STOP,
    OccupancyMap,
    Odometry,
    Pose2D,
    Scan,
    Velocity2D,
    nanoseconds,
)

T = TypeVar("T")

_KEPT = 200  # readings of a source
_NEW_GOAL_NS = (
    NANOSECONDS_PER_SECOND  # after a pause this long an equal goal is a new one
)


@dataclass(frozen=True, slots=True)
class Answer:
    """The command to send for one observation, None for nothing; `decision` is None while there is no task."""

    command: Velocity2D | None
    decision: Decision | None = None


class PlannerSession:
    """Runs one planner, task after task; repeat_command: in cycles without one, so that a simulator need not wait."""

    def __init__(
        self, planner: Planner, *, seed: int, use_map: bool, repeat_command: bool = True
    ):
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
        """Set a goal; return whether it starts a task. An equal one does only after a pause when the task is over."""
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
        known = (
            OccupancyMap(np.zeros((60, 60), np.int8), 0.15, -4.5, -4.5)
            if self._use_map
            else None
        )
        self.planner.start(Task(Pose2D(3.0, 0.0, 0.0), known), self.seed)
        ranges = np.full(720, 2.0, np.float32)
        for cycle in range(4):
            stamp = cycle * NANOSECONDS_PER_SECOND // 20
            scan = Scan(stamp, ranges, -2.35, 4.7 / 719, 0.1, 30.0)
            pose = Pose2D(0.0, 0.0, 0.0)
            self.planner.step(
                Observation(stamp, Odometry(stamp, pose, STOP), scan, pose)
            )
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
    places = {
        (known.resolution, known.origin_x, known.origin_y) for known in (one, other)
    }
    return len(places) == 1 and np.array_equal(one.data, other.data)


@dataclass(frozen=True)
class SyncConfig(Checked):
    """How old a reading may be that is combined with a scan."""

    odometry_age_s: float = quantity(
        0.25, "oldest odometry that is combined with a scan", "s", 0.0, 60.0
    )
    pose_age_s: float = quantity(
        600.0,
        "oldest localisation taken with a scan, and extrapolated",
        "s",
        minimum=0.0,
    )


class Synchroniser:
    """Collects readings and returns an observation for each scan once its readings have arrived.

    If a source sends one reading per scan with the scan's own stamp, as in lockstep, that reading is waited for.
    Otherwise the latest one not after the scan is used, as soon as a later one or the next scan shows that none will
    come; the source is then not waited for until it matches a stamp again.
    """

    def __init__(self, config: SyncConfig, *, use_pose: bool):
        self.config = config
        self._use_pose = use_pose
        self.reset()

    def reset(self) -> None:
        """Forget all readings."""
        self._odometry: _History[Odometry] = _History()
        self._poses: _History[Pose2D] = _History()
        self._scan: Scan | None = None
        self._last_ns: int | None = None
        self.skipped = 0
        self.restarted = False
        self.missing = "no scan yet"

    def add_odometry(self, odometry: Odometry) -> Observation | None:
        """Add odometry; returns the observation that it completes."""
        self._odometry.add(odometry.stamp_ns, odometry, self._last_ns)
        return self._complete(overtaken=False)

    def add_pose(self, stamp_ns: int, pose: Pose2D) -> Observation | None:
        """Add the robot's pose in the map frame; returns the observation that it completes."""
        self._poses.add(stamp_ns, pose, self._last_ns)
        return self._complete(overtaken=False)

    def add_scan(self, scan: Scan) -> list[Observation]:
        """Add a scan; return the observations that it completes, also of the scan before. `restarted`: it is older."""
        newest = self._scan.stamp_ns if self._scan is not None else self._last_ns
        if newest is not None and scan.stamp_ns < newest:
            self.reset()
            self.restarted = True
        overtaken = self._complete(overtaken=True)
        if self._scan is not None:
            self.skipped += 1
        self._scan = scan
        completed = self._complete(overtaken=False)
        return [
            observation
            for observation in (overtaken, completed)
            if observation is not None
        ]

    def _complete(self, *, overtaken: bool) -> Observation | None:
        """Return the observation of the pending scan if it is complete; `overtaken`: do not wait any longer."""
        scan = self._scan
        if scan is None:
            return None
        stamp = scan.stamp_ns
        if not self._odometry.settled(stamp, overtaken):
            self.missing = "no odometry yet"
            return None
        if self._use_pose and not self._poses.settled(stamp, overtaken):
            self.missing = "no localisation yet"
            return None
        odometry = self._odometry.latest(stamp, nanoseconds(self.config.odometry_age_s))
        if odometry is None:
            self.missing = f"no odometry of the last {self.config.odometry_age_s:g} s"
            return None
        pose = self._pose(stamp, odometry) if self._use_pose else odometry.pose
        if pose is None:
            self.missing = "no localisation yet"
            return None
        self._scan, self._last_ns, self.missing = None, stamp, ""
        return Observation(stamp, odometry, scan, pose)

    def _pose(self, stamp_ns: int, odometry: Odometry) -> Pose2D | None:
        """Return the pose in the map frame: localised at this stamp, or earlier and extrapolated by odometry."""
        exact = self._poses.at(stamp_ns)
        if exact is not None and odometry.stamp_ns == stamp_ns:
            return exact
        pose_ns = self._poses.latest_stamp(stamp_ns)
        pose = self._poses.latest(stamp_ns, nanoseconds(self.config.pose_age_s))
        if pose is None or pose_ns is None:
            return None
        then = self._odometry.latest(pose_ns, nanoseconds(self.config.odometry_age_s))
        if then is None:
            return pose
        return pose @ (then.pose.inverse() @ odometry.pose)


class _History(Generic[T]):
    """The last readings of one source by stamp, and whether it sends one per scan."""

    def __init__(self) -> None:
        self._readings: OrderedDict[int, T] = OrderedDict()
        self._per_scan = True

    def add(self, stamp_ns: int, reading: T, last_scan_ns: int | None) -> None:
        self._readings[stamp_ns] = reading
        if stamp_ns == last_scan_ns:
            self._per_scan = True
        while len(self._readings) > _KEPT:
            self._readings.popitem(last=False)

    def at(self, stamp_ns: int) -> T | None:
        return self._readings.get(stamp_ns)

    def settled(self, stamp_ns: int, overtaken: bool) -> bool:
        """Tell whether there is a reading and no better one is expected."""
        if stamp_ns in self._readings:
            self._per_scan = True
            return True
        if overtaken or (self._readings and max(self._readings) > stamp_ns):
            self._per_scan = False
        return not self._per_scan and self.latest_stamp(stamp_ns) is not None

    def latest_stamp(self, stamp_ns: int) -> int | None:
        return max(
            (stamp for stamp in self._readings if stamp <= stamp_ns), default=None
        )

    def latest(self, stamp_ns: int, age_ns: int) -> T | None:
        """Return the last reading not after the stamp and not older than the age."""
        stamp = self.latest_stamp(stamp_ns)
        return (
            None
            if stamp is None or stamp_ns - stamp > age_ns
            else self._readings[stamp]
        )
