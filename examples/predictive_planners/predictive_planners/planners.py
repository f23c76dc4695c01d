"""Follow-the-gap and MPPI that predict moving obstacles.

Everything else is as in `gap` and `mppi`, so a comparison shows what prediction is
worth. setup.py announces the entries at the end of this file.
"""

from dataclasses import dataclass, field

import numpy as np

from barn_planners.costmap.costmap import Costmap
from barn_planners.gap.planner import GapConfig, GapPlanner
from barn_planners.interface import FloatArray, Observation, Task
from barn_planners.mppi.config import MppiPlannerConfig
from barn_planners.mppi.planner import MppiController
from barn_planners.navigation.loop import NavigationPlanner
from barn_planners.registry import ANY_PROTOCOL, PlannerEntry
from barn_planners.robots import fit_to_robot
from barn_worlds.base.arrays import Singles, kernel
from barn_worlds.base.config import quantity
from predictive_planners.tracker import (
    Tracker,
    TrackerConfig,
    meeting_distances,
    transform_discs,
)

_NO_DISCS = np.empty((0, 5))


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
    """Takes a direction to be free only until a predicted disc is met at top speed."""

    def __init__(self, config: PredictiveGapConfig) -> None:
        super().__init__(config)
        self._horizon_s = config.horizon_s
        self._tracker = Tracker(config.tracker, config.lidar)

    def start(self, task: Task, seed: int) -> None:
        """Begin a new trial.

        Args:
            task: Goal in the planning frame; its map is ignored.
            seed: Ignored.
        """
        super().start(task, seed)
        self._tracker.reset()

    def free_distances(
        self, observation: Observation, points: FloatArray
    ) -> FloatArray:
        """Return how far each direction is free of points and of predicted discs.

        Args:
            observation: Readings of this cycle.
            points: Returns of its scan, (n, 2) in m in base_link.

        Returns:
            Distances (directions,) in m, up to the look-ahead distance.
        """
        free_m = super().free_distances(observation, points)
        config = self.config
        discs = self._tracker.update(observation)
        if not len(discs) or config.max_speed_mps <= 0.0:
            return free_m

        base_discs = transform_discs(discs, observation.odometry.pose.inverse())
        meeting_m = meeting_distances(
            base_discs, self._directions, config.robot_radius_m, config.max_speed_mps
        )
        # Beyond the horizon a prediction is worth nothing.
        horizon_m = min(config.look_ahead_m, self._horizon_s * config.max_speed_mps)
        meeting_m[meeting_m > horizon_m] = config.look_ahead_m
        return np.minimum(free_m, meeting_m)


class PredictiveMppiController(MppiController):
    """Adds costs to trajectories that meet a predicted disc, the more the sooner."""

    def __init__(self, config: PredictiveMppiConfig) -> None:
        super().__init__(config.mppi)
        self._moving_weight = config.moving_weight
        self._margin_m = config.moving_margin_m
        # Discs that move, (k, 5) as of `Tracker`, in the frame of the local costmap.
        self.discs: FloatArray = _NO_DISCS

    def reset(self, seed: int) -> None:
        """Begin a new trial and forget the last one."""
        super().reset(seed)
        self.discs = _NO_DISCS

    def add_obstacle_costs(self, costmap: Costmap, goal_distance_m: float) -> int:
        """Add the costs on the costmap and of meeting discs.

        Args:
            costmap: Costs around the robot.
            goal_distance_m: Distance of the robot from the goal.

        Returns:
            Number of trajectories that collide on the costmap.
        """
        collisions = super().add_obstacle_costs(costmap, goal_distance_m)
        if len(self.discs):
            add_moving_costs(
                self._costs,
                self._poses,
                self.config.step_s,
                self.discs,
                costmap.config.inscribed_m + self._margin_m,
                self._moving_weight,
            )
        return collisions


class PredictiveNavigationPlanner(NavigationPlanner):
    """The navigation loop, which tells its controller about moving discs."""

    def __init__(self, config: PredictiveMppiConfig) -> None:
        self._predictive_controller = PredictiveMppiController(config)
        super().__init__(config, self._predictive_controller)
        self._tracker = Tracker(config.tracker, config.lidar)

    def start(self, task: Task, seed: int) -> None:
        """Begin a new trial: forget costmaps, plan, recovery and tracks.

        Args:
            task: Goal in the planning frame, and the map if there is one.
            seed: Seed of the controller's noise.
        """
        super().start(task, seed)
        self._tracker.reset()

    def prepare_control(self, observation: Observation) -> None:
        """Track discs and hand them to the controller in its frame."""
        discs = self._tracker.update(observation)
        odometry_pose = observation.odometry.pose
        control_pose = self.control_pose(observation)
        if control_pose is not odometry_pose:
            discs = transform_discs(discs, control_pose @ odometry_pose.inverse())
        self._predictive_controller.discs = discs


@kernel
def add_moving_costs(
    costs: FloatArray,
    poses: Singles,
    step_s: float,
    discs: FloatArray,
    reach: float,
    weight: float,
) -> None:
    """Add the costs of meeting discs that move at constant velocity.

    Args:
        costs: Costs (samples,), changed in place.
        poses: Poses (steps, 3, samples): x and y in m, yaw in rad.
        step_s: Time between two poses in s.
        discs: Discs (k, 5): x and y in m, velocity in m/s, radius in m.
        reach: Distance from a disc in m that counts as meeting it.
        weight: Cost of meeting a disc now; at the last step it is half of that.
    """
    steps, _, samples = poses.shape
    for k in range(samples):
        for t in range(steps):
            time_s = step_s * (t + 1)
            meets = False
            for i in range(len(discs)):
                dx = discs[i, 0] + time_s * discs[i, 2] - poses[t, 0, k]
                dy = discs[i, 1] + time_s * discs[i, 3] - poses[t, 1, k]
                distance = discs[i, 4] + reach
                meets = meets or dx * dx + dy * dy < distance * distance
            if meets:
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
