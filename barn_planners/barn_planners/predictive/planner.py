"""Follow-the-gap and MPPI that predict what moves: discs tracked in the scans, each with a constant velocity.

Everything else is as in `gap` and `mppi`, so that a comparison tells what prediction is worth.
"""

import math
from dataclasses import dataclass, field

import numpy as np

from barn_planners.costmap.costmap import Costmap
from barn_planners.gap.planner import GapConfig, GapPlanner
from barn_planners.interface import FloatArray, Observation, Task
from barn_planners.mppi import kernels
from barn_planners.mppi.config import MppiPlannerConfig
from barn_planners.mppi.planner import MppiController
from barn_planners.navigation.loop import NavigationPlanner
from barn_planners.predictive.tracking import Tracker, TrackerConfig
from barn_planners.registry import ANY_PROTOCOL, PlannerEntry
from barn_planners.robots import fitted
from barn_worlds.base.config import quantity
from barn_worlds.base.types import Pose2D

_NOTHING = np.empty((0, 5))


@dataclass(frozen=True)
class PredictiveGapConfig(GapConfig):
    """Follow-the-gap with prediction."""

    horizon_s: float = quantity(2.0, "how far ahead discs are predicted", "s", minimum=0.0, maximum=60.0)
    tracker: TrackerConfig = field(default_factory=TrackerConfig)


@dataclass(frozen=True)
class PredictiveMppiConfig(MppiPlannerConfig):
    """MPPI with prediction."""

    moving_weight: float = quantity(1000.0, "meeting a predicted disc at once, half of that at the end", minimum=0.0)
    moving_margin_m: float = quantity(0.1, "margin around robot and disc", "m", minimum=0.0, maximum=5.0)
    tracker: TrackerConfig = field(default_factory=TrackerConfig)


class PredictiveGapPlanner(GapPlanner):
    """Also counts a direction as free only as far as no predicted disc is met on the way at the highest speed."""

    def __init__(self, config: PredictiveGapConfig) -> None:
        super().__init__(config)
        self._predictive = config
        self._tracker = Tracker(config.tracker, config.lidar)

    def start(self, task: Task, seed: int) -> None:
        """Begin a new trial; a map is ignored."""
        super().start(task, seed)
        self._tracker.reset()

    def _free_distances(self, observation: Observation, points: FloatArray) -> FloatArray:
        free = super()._free_distances(observation, points)
        config = self._predictive
        discs = in_frame_of(self._tracker.update(observation), observation.odometry.pose)
        if not len(discs) or config.max_speed_mps <= 0.0:
            return free
        longest_m = min(config.look_ahead_m, config.horizon_s * config.max_speed_mps)
        met = meeting_distances(discs, self._directions, config.robot_radius_m, config.max_speed_mps)
        return np.minimum(free, np.where(met <= longest_m, met, config.look_ahead_m))


class PredictiveMppiController(MppiController):
    """Also makes trajectories dear that meet a predicted disc, the more the sooner."""

    def __init__(self, config: PredictiveMppiConfig) -> None:
        super().__init__(config.mppi)
        self._weight, self._margin_m = config.moving_weight, config.moving_margin_m
        self.discs = _NOTHING

    def reset(self, seed: int) -> None:
        """Begin a new trial and forget the last one."""
        super().reset(seed)
        self.discs = _NOTHING

    def _add_obstacle_costs(self, costmap: Costmap, to_goal: float) -> int:
        collisions = super()._add_obstacle_costs(costmap, to_goal)
        if len(self.discs):
            reach_m = costmap.config.inscribed_m + self._margin_m
            sampled = self._xs, self._ys, self.config.step_s
            kernels.add_moving_costs(self._costs, *sampled, self.discs, reach_m, self._weight)
        return collisions


class PredictiveNavigationPlanner(NavigationPlanner):
    """The navigation loop, which tells its controller what moves; tracks and controller are in the odom frame."""

    def __init__(self, config: PredictiveMppiConfig) -> None:
        self._predicting = PredictiveMppiController(config)
        super().__init__(config, self._predicting)
        self._tracker = Tracker(config.tracker, config.lidar)

    def start(self, task: Task, seed: int) -> None:
        """Begin a new trial: forget costmaps, plan, recovery and tracks."""
        super().start(task, seed)
        self._tracker.reset()

    def _prepare(self, observation: Observation) -> None:
        discs = self._tracker.update(observation)
        robot = self._robot(observation)
        in_odom = robot is observation.odometry.pose
        self._predicting.discs = discs if in_odom else moved(discs, robot @ observation.odometry.pose.inverse())


def in_frame_of(discs: FloatArray, robot: Pose2D) -> FloatArray:
    """Return discs (k, 5) of the odom frame in that of a robot at a pose there."""
    return moved(discs, robot.inverse())


def moved(discs: FloatArray, by: Pose2D) -> FloatArray:
    """Return discs (k, 5) in another frame, in which the present one has a pose."""
    if not len(discs):
        return discs
    turn = np.array([[math.cos(by.yaw), -math.sin(by.yaw)], [math.sin(by.yaw), math.cos(by.yaw)]])
    return np.column_stack([by.transform(discs[:, :2]), discs[:, 2:4] @ turn.T, discs[:, 4]])


def meeting_distances(discs: FloatArray, directions: FloatArray, radius_m: float, speed_mps: float) -> FloatArray:
    """Return how far (n,) a disc of a radius comes from the origin in each direction (n,) before it meets another.

    It drives at a constant speed while discs (k, 5) keep their velocities; infinite where it meets none. One that is
    being touched counts only while the two close in on each other.
    """
    ways = np.stack([np.cos(directions), np.sin(directions)], axis=1)[:, None, :]
    relative = discs[None, :, 2:4] / speed_mps - ways  # per metre driven
    offset = discs[None, :, :2]
    a, b = (relative**2).sum(axis=2), (relative * offset).sum(axis=2)
    c = (offset**2).sum(axis=2) - (discs[None, :, 4] + radius_m) ** 2
    root = b**2 - a * c
    with np.errstate(divide="ignore", invalid="ignore"):
        first = np.where(c <= 0.0, 0.0, (-b - np.sqrt(root)) / a)
    nearest: FloatArray = np.where((root >= 0.0) & (b < 0.0), first, np.inf).min(axis=1, initial=np.inf)
    return nearest


GAP_ENTRY = PlannerEntry(
    PredictiveGapPlanner,
    {ANY_PROTOCOL: PredictiveGapConfig()},
    "follow-the-gap that predicts what moves at constant velocity",
    fitted,
)
MPPI_ENTRY = PlannerEntry(
    PredictiveNavigationPlanner,
    {ANY_PROTOCOL: PredictiveMppiConfig()},
    "mppi that predicts what moves at constant velocity",
    fitted,
)
