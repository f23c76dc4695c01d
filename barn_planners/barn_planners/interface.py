"""The interface between a planner and whatever runs it.

A direct trial, a ROS node and a learning environment all call a planner the same way:
`start` once per trial, then `step` once per control cycle. The smallest planner is::

    class Straight(Planner):
        def start(self, task: Task, seed: int) -> None:
            self._goal = task.goal

        def step(self, observation: Observation) -> Decision:
            goal = observation.pose.inverse() @ self._goal  # as the robot sees it
            bearing = math.atan2(goal.y, goal.x)
            return Decision(Velocity2D(linear=0.5, angular=bearing))

Units are SI: meters, radians, seconds. Frames follow REP-105. `odom` begins where the
robot starts; `map` exists only if the task has a map. The planning frame is `map` if
the task has a map, and `odom` otherwise.
"""

from abc import ABC, abstractmethod
from collections.abc import Mapping
from dataclasses import dataclass, field
from enum import Enum

from barn_worlds.base.arrays import Floats
from barn_worlds.base.types import OccupancyMap, Odometry, Pose2D, Scan, Velocity2D

FloatArray = Floats


class PlannerStatus(str, Enum):
    """What a planner says about its own progress after a control cycle."""

    RUNNING = "running"
    """On the way to the goal."""
    GOAL_REACHED = "goal_reached"
    """Standing within the goal tolerance; the trial may end."""
    RECOVERING = "recovering"
    """Driving to free itself, for example turning in place, before it goes on."""
    BLOCKED = "blocked"
    """No command is safe in this cycle; one may be in the next."""
    FAILED = "failed"
    """The planner has given up on this trial."""


@dataclass(frozen=True, slots=True)
class Task:
    """What a planner has to do in a trial: drive to a goal."""

    goal: Pose2D
    """Pose to reach, in the planning frame."""
    map: OccupancyMap | None = None
    """Occupancy grid in the map frame; None if the protocol gives no map."""


@dataclass(frozen=True, slots=True)
class Observation:
    """The sensor readings of one control cycle."""

    stamp_ns: int
    """Simulated time since the start of the trial, in nanoseconds."""
    odometry: Odometry
    """Odometry as measured: `pose` (x and y in m, yaw in rad) in odom, `velocity`
    (`linear` in m/s, `angular` in rad/s) in base_link."""
    scan: Scan
    """Lidar scan: `ranges` is float32 (beams,) in m, +inf where a beam returned nothing
    (REP-117). `angles()` is float64 (beams,) in rad in the lidar's frame, 0 ahead and
    positive to the left. Ranges are valid from `range_min` to `range_max`. All planners
    of the suite treat any other range, and 0, as no return (`shortest_return_m`)."""
    pose: Pose2D
    """Pose of the robot in the planning frame, which is also the frame of the goal."""


@dataclass(frozen=True, slots=True)
class Decision:
    """The outcome of one control cycle."""

    command: Velocity2D | None
    """Speed in m/s and yaw rate in rad/s to send. With None the last command holds."""
    status: PlannerStatus = PlannerStatus.RUNNING
    reason: str = ""
    """One line that explains a status other than RUNNING, for people."""
    plan: FloatArray | None = None
    """Points (n, 2) in m in the planning frame, if this cycle has a new global plan."""
    diagnostics: Mapping[str, float] = field(default_factory=dict)
    """Values of this cycle for logs, by name. Names end in SI units."""


@dataclass(frozen=True, slots=True)
class PlannerView:
    """What a planner considered in its last cycle, for display.

    `plan` is in the planning frame. All other fields are in odom, or also in the
    planning frame if `in_planning_frame` is true.
    """

    plan: FloatArray | None = None
    """Global plan: (n, 2) x and y in m."""
    local_plan: FloatArray | None = None
    """Trajectory the planner intends to drive: (n, 3) x and y in m, yaw in rad."""
    costmap: OccupancyMap | None = None
    """Costs around the robot, as occupancy from 0 to 100."""
    band: FloatArray | None = None
    """Elastic band: (n, 3) x, y and radius of each bubble in m."""
    candidates: FloatArray | None = None
    """Trajectories that were compared: (k, n, 2) x and y in m."""
    candidate_costs: FloatArray | None = None
    """Cost of each candidate: (k,), +inf if rejected, NaN if unknown."""
    in_planning_frame: bool = False


class Planner(ABC):
    """A local planner. One object drives one robot, trial after trial."""

    @abstractmethod
    def start(self, task: Task, seed: int) -> None:
        """Begin a new trial and forget the last one; called before its first `step`.

        Args:
            task: Goal to reach, and a map if the protocol gives one.
            seed: Source of all randomness. Equal seeds and equal observations must lead
                to equal commands, or the trial cannot be repeated.
        """

    @abstractmethod
    def step(self, observation: Observation) -> Decision:
        """Return the decision of one control cycle: a command and a status.

        An implementation must not raise, whatever the observation contains: it answers
        unusable readings with a stop and a reason. The command must be finite.
        """

    def view(self) -> PlannerView:
        """Return what the last cycle considered, for display; empty by default.

        The runtime calls it only if someone is watching.
        """
        return PlannerView()
