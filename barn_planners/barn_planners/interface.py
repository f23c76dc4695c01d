"""The interface between a planner and whatever runs it: a direct trial, a ROS node, a learning environment."""

from abc import ABC, abstractmethod
from collections.abc import Mapping
from dataclasses import dataclass, field
from enum import Enum

import numpy as np
import numpy.typing as npt

from barn_worlds.base.types import OccupancyMap, Odometry, Pose2D, Scan, Velocity2D

FloatArray = npt.NDArray[np.float64]


class PlannerStatus(str, Enum):
    """The status of a planner after a cycle."""

    RUNNING = "running"
    GOAL_REACHED = "goal_reached"
    RECOVERING = "recovering"
    BLOCKED = "blocked"
    FAILED = "failed"


@dataclass(frozen=True, slots=True)
class Task:
    """Drive to `goal`. Goal and map are in the planning frame: map if there is a map, else odom."""

    goal: Pose2D
    map: OccupancyMap | None = None


@dataclass(frozen=True, slots=True)
class Observation:
    """What a planner is given in a control cycle.

    Attributes:
        stamp_ns: Simulated time since the trial's start, in nanoseconds.
        odometry: As measured: `pose` (`x`, `y` in m, `yaw` in rad) in the odom frame, which begins where the robot
            starts; `velocity` (`linear` in m/s, `angular` in rad/s) in base_link.
        scan: `ranges`, float32 of shape (beams,), in m, +inf where nothing was seen (REP-117); `angles()`, float64 of
            shape (beams,), in rad in the lidar's frame, 0 ahead and positive to the left; `range_min` and `range_max`.
        pose: The robot in the planning frame, that of the goal: map if a map is given, else odom.
    """

    stamp_ns: int
    odometry: Odometry
    scan: Scan
    pose: Pose2D


@dataclass(frozen=True, slots=True)
class Decision:
    """The outcome of one control cycle.

    command: the command to send; None sends nothing (the last command holds).
    plan: (n, 2) metres in the planning frame if the global plan is new in this cycle, else None.
    reason: in one line, why the status is not running.
    diagnostics: figures of this cycle by name, SI units in the names.
    """

    command: Velocity2D | None
    status: PlannerStatus = PlannerStatus.RUNNING
    reason: str = ""
    plan: FloatArray | None = None
    diagnostics: Mapping[str, float] = field(default_factory=dict)


@dataclass(frozen=True, slots=True)
class PlannerView:
    """Plans and candidates of a planner's last cycle, for display; computed only when requested.

    The plan is in the planning frame, all else in the odom frame, or also in the planning frame if `in_planning_frame`.

    plan: (n, 2) m; local_plan: (n, 3) x, y m, yaw rad; band: (n, 3) x, y, radius m;
    candidates: (k, n, 2) m sampled trajectories with costs (k,), +inf where rejected.
    """

    plan: FloatArray | None = None
    local_plan: FloatArray | None = None
    costmap: OccupancyMap | None = None
    band: FloatArray | None = None
    candidates: FloatArray | None = None
    candidate_costs: FloatArray | None = None
    in_planning_frame: bool = False


class Planner(ABC):
    """A local planner; one object drives one robot, trial after trial."""

    @abstractmethod
    def start(self, task: Task, seed: int) -> None:
        """Begin a new trial and forget the last one; all randomness comes from `seed`."""

    @abstractmethod
    def step(self, observation: Observation) -> Decision:
        """Return the decision of one control cycle; never raises for an observation, never commands NaN."""

    def view(self) -> PlannerView:
        """Return the view of the last cycle."""
        return PlannerView()
