"""Settings of MPPI and its preset."""

import math
from dataclasses import dataclass, replace
from typing import Any

from barn_planners.costmap.config import CostmapConfig, GlobalCostmapConfig
from barn_planners.navigation.loop import NavigationConfig
from barn_worlds.base.config import Checked, quantity

# Samples times steps, which memory holds as several arrays.
_MAX_STATES = 10_000_000


def _weight(default: float, description: str) -> float:
    """Return a field declared as a critic's weight, without unit, from 0 to 1e6."""
    return quantity(default, description, "", 0.0, 1.0e6)


@dataclass(frozen=True)
class CriticsConfig(Checked):
    """What a trajectory costs; the defaults are those of Nav2's critics."""

    limit_weight: float = _weight(
        4.0, "weight of speed and yaw rate beyond their limits"
    )
    obstacle_weight: float = _weight(
        3.81, "weight of the mean cost under the robot's center, a share of 254"
    )
    obstacle_stride: int = quantity(
        2, "check every n-th pose for obstacles", "", 1, 100
    )
    critical_cost: float = _weight(300.0, "cost of a cell within the inscribed radius")
    collision_cost: float = quantity(
        1.0e6, "cost of a trajectory that collides", "", 1.0, 1.0e9
    )
    near_goal_m: float = quantity(
        1.0,
        "within this distance of the goal, only inscribed cells and collisions count",
        "m",
        0.0,
        100.0,
    )
    goal_weight: float = _weight(
        5.0, "weight of the mean distance from the goal in meters"
    )
    goal_within_m: float = quantity(
        1.4, "within this distance of the goal, goal_weight applies", "m", 0.0, 100.0
    )
    goal_angle_weight: float = _weight(
        3.0, "weight of the mean angle to the goal's heading in radians"
    )
    goal_angle_within_m: float = quantity(
        0.5,
        "within this distance of the goal, goal_angle_weight applies",
        "m",
        0.0,
        100.0,
    )
    align_weight: float = _weight(
        14.0, "weight of the mean distance from the path in meters"
    )
    align_stride: int = quantity(4, "compare every n-th pose with the path", "", 1, 100)
    align_points: int = quantity(
        20,
        "align_weight applies once a trajectory reaches this many points along the path",
        "",
        0,
        1000,
    )
    align_most_blocked: float = quantity(
        0.05,
        "align_weight does not apply if a larger share of these points is blocked",
        "",
        0.0,
        1.0,
    )
    follow_weight: float = _weight(
        5.0,
        "weight of the distance in meters from the end to a point ahead on the path",
    )
    follow_points: int = quantity(
        5,
        "follow_weight's point lies this many points beyond the furthest point reached",
        "",
        0,
        1000,
    )
    angle_weight: float = _weight(
        2.0, "weight of the angle in radians from the end's heading to a point ahead"
    )
    angle_points: int = quantity(
        4,
        "angle_weight's point lies this many points beyond the furthest point reached",
        "",
        0,
        1000,
    )
    angle_beyond_rad: float = quantity(
        1.0,
        "angle_weight applies if the bearing of its point exceeds this angle",
        "rad",
        0.0,
        math.pi,
    )
    forward_weight: float = _weight(
        5.0, "weight of the distance in meters driven in reverse"
    )


@dataclass(frozen=True)
class MppiConfig(Checked):
    """Sampling and limits; the defaults are Nav2's with the Jackal's settings."""

    samples: int = quantity(
        2000, "control sequences sampled per cycle", "", 10, 100_000
    )
    steps: int = quantity(56, "steps of a sequence", "", 10, 1000)
    step_s: float = quantity(0.05, "time of a step", "s", 0.005, 1.0)
    iterations: int = quantity(1, "rounds of sampling per cycle", "", 1, 100)
    max_speed_mps: float = quantity(0.5, "fastest forward speed", "m/s", 0.01, 10.0)
    min_speed_mps: float = quantity(
        0.0,
        "fastest reverse speed, as a negative number; 0: no reverse",
        "m/s",
        -10.0,
        0.0,
    )
    max_turn_radps: float = quantity(1.9, "highest yaw rate", "rad/s", 0.01, 20.0)
    acceleration_mps2: float = quantity(
        3.0, "highest acceleration", "m/s2", 0.01, 1000.0
    )
    deceleration_mps2: float = quantity(
        3.0, "highest deceleration", "m/s2", 0.01, 1000.0
    )
    turn_acceleration_radps2: float = quantity(
        3.5, "highest yaw acceleration", "rad/s2", 0.01, 1000.0
    )
    speed_std_mps: float = quantity(
        0.2, "standard deviation of the sampled speeds", "m/s", 0.001, 10.0
    )
    turn_std_radps: float = quantity(
        0.4, "standard deviation of the sampled yaw rates", "rad/s", 0.001, 20.0
    )
    temperature: float = quantity(
        0.3,
        "cost difference over which a sample's weight falls to 1/e",
        "",
        0.001,
        1000.0,
    )
    gamma: float = quantity(
        0.015, "weight of the cost of the controls themselves", "", 0.0, 1000.0
    )
    path_ahead_m: float = quantity(
        1.7, "length of the plan ahead that is followed", "m", 0.1, 100.0
    )
    path_spacing_m: float = quantity(
        0.05, "distance between the points of the path", "m", 0.005, 1.0
    )
    xy_tolerance_m: float = quantity(
        0.25,
        "distance within which the goal's position counts as reached",
        "m",
        minimum=0.01,
    )
    yaw_tolerance_rad: float = quantity(
        0.25,
        "angle within which the goal's heading counts as reached",
        "rad",
        minimum=0.001,
    )
    progress_m: float = quantity(
        0.5, "the robot is stuck if it does not move this far", "m", 0.0, 100.0
    )
    progress_s: float = quantity(
        10.0, "time limit for moving progress_m", "s", 0.1, 10_000.0
    )
    shown: int = quantity(
        50, "number of sampled trajectories that are shown", "", 0, 1000
    )
    critics: CriticsConfig = CriticsConfig()

    def check_rules(self) -> None:
        """Raise ConfigError if samples, turn per step or reverse speed is too large."""
        limit = f"must be at most {_MAX_STATES} divided by steps = {self.steps}"
        self.require(self.samples * self.steps <= _MAX_STATES, "samples", limit)

        # The series in the rollout are exact for small turns only.
        top_turn = f"max_turn_radps = {self.max_turn_radps:g}"
        limit = f"must keep a step's turn to at most 0.5 rad at {top_turn}"
        self.require(self.max_turn_radps * self.step_s <= 0.5, "step_s", limit)

        lowest = -self.max_speed_mps
        limit = f"must be at least {lowest:g}: no faster than max_speed_mps"
        self.require(self.min_speed_mps >= lowest, "min_speed_mps", limit)


# The Jackal's outline with Nav2's padding, and an inflation large enough to act in
# time.
_FOOTPRINT: dict[str, Any] = {
    "footprint_half_length_m": 0.254,
    "footprint_half_width_m": 0.215,
    "footprint_padding_m": 0.01,
    "inflation_radius_m": 0.8,
    "cost_scaling_per_m": 3.0,
}
_LOCAL_COSTMAP = replace(CostmapConfig(resolution_m=0.06, size_m=5.0), **_FOOTPRINT)
_GLOBAL_COSTMAP = replace(GlobalCostmapConfig(), **_FOOTPRINT)


@dataclass(frozen=True)
class MppiPlannerConfig(NavigationConfig):
    """The navigation loop with MPPI in it.

    The global plan is made once a second, as by Nav2's behavior tree.
    """

    plan_period_s: float = quantity(
        1.0, "time between two global plans", "s", 0.0, 60.0
    )
    prune_m: float = quantity(
        0.0,
        "drop the plan's points before the first within this distance; 0: keep all",
        "m",
        minimum=0.0,
    )
    local_costmap: CostmapConfig = _LOCAL_COSTMAP
    global_costmap: GlobalCostmapConfig = _GLOBAL_COSTMAP
    mppi: MppiConfig = MppiConfig()
