"""Follow-the-gap and MPPI that predict what moves; the entries at the end are announced in setup.py.

Everything else is as in `gap` and `mppi`, so that a comparison tells what prediction is worth.
"""

from dataclasses import dataclass, field

import numpy as np
from numba import njit

from barn_planners.costmap.costmap import Costmap
from barn_planners.gap.planner import GapConfig, GapPlanner
from barn_planners.interface import FloatArray, Observation, Task
from barn_planners.mppi.config import MppiPlannerConfig
from barn_planners.mppi.planner import MppiController
from barn_planners.navigation.loop import NavigationPlanner
from barn_planners.registry import ANY_PROTOCOL, PlannerEntry
from barn_planners.robots import fit_to_robot
from barn_worlds.base.config import quantity
from predictive_planners.tracker import Tracker, TrackerConfig, meeting_distances, moved

_NOTHING = np.empty((0, 5))


@dataclass(frozen=True)
class PredictiveGapConfig(GapConfig):
    """Follow-the-gap with prediction."""

    horizon_s: float = quantity(
        2.0, "how far ahead discs are predicted", "s", 0.0, 60.0
    )
    tracker: TrackerConfig = field(default_factory=TrackerConfig)


@dataclass(frozen=True)
class PredictiveMppiConfig(MppiPlannerConfig):
    """MPPI with prediction."""

    moving_weight: float = quantity(
        1000.0, "meeting a predicted disc at once, half of that at the end", minimum=0.0
    )
    moving_margin_m: float = quantity(
        0.1, "margin around robot and disc", "m", 0.0, 5.0
    )
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

    def free_distances(
        self, observation: Observation, points: FloatArray
    ) -> FloatArray:
        """Return how far each direction is free of points and of predicted discs."""
        free = super().free_distances(observation, points)
        config = self._predictive
        discs = moved(
            self._tracker.update(observation), observation.odometry.pose.inverse()
        )
        if not len(discs) or config.max_speed_mps <= 0.0:
            return free
        longest_m = min(config.look_ahead_m, config.horizon_s * config.max_speed_mps)
        met = meeting_distances(
            discs, self._directions, config.robot_radius_m, config.max_speed_mps
        )
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
            add_moving_costs(self._costs, *sampled, self.discs, reach_m, self._weight)
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

    def prepare_control(self, observation: Observation) -> None:
        """Update the tracks and hand the moving discs to the controller."""
        discs = self._tracker.update(observation)
        robot = self.control_pose(observation)
        in_odom = robot is observation.odometry.pose
        self._predicting.discs = (
            discs
            if in_odom
            else moved(discs, robot @ observation.odometry.pose.inverse())
        )


@njit(cache=True)
def add_moving_costs(costs, xs, ys, step_s, discs, reach, weight):  # type: ignore[no-untyped-def]
    """Add the costs of meeting discs (k, 5) in constant motion: the weight now, half of it at the last step."""
    steps, samples = xs.shape
    for k in range(samples):
        for t in range(steps):
            time_s = step_s * (t + 1)
            met = False
            for i in range(len(discs)):
                dx = discs[i, 0] + time_s * discs[i, 2] - xs[t, k]
                dy = discs[i, 1] + time_s * discs[i, 3] - ys[t, k]
                near = discs[i, 4] + reach
                met = met or dx * dx + dy * dy < near * near
            if met:
                costs[k] += weight * (1.0 - 0.5 * t / steps)
                break


GAP_ENTRY = PlannerEntry(
    PredictiveGapPlanner,
    {ANY_PROTOCOL: PredictiveGapConfig()},
    "follow-the-gap that predicts what moves at constant velocity",
    fit_to_robot,
)
MPPI_ENTRY = PlannerEntry(
    PredictiveNavigationPlanner,
    {ANY_PROTOCOL: PredictiveMppiConfig()},
    "mppi that predicts what moves at constant velocity",
    fit_to_robot,
)
