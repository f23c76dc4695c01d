"""A simple baseline: follow the gap nearest to the goal, stop before a collision. No map, no plan, no memory.

After Sezer and Gokasan, "A novel obstacle avoidance algorithm: follow the gap method", Robotics and Autonomous
Systems 60(9), 2012; but it chooses the gap nearest to the goal's direction, not the widest.
"""

import math
from dataclasses import dataclass, field

import numpy as np

from barn_planners.interface import (
    Decision,
    FloatArray,
    Observation,
    PlannerStatus,
    PlannerView,
    Task,
)
from barn_planners.navigation.guard import GuardConfig, LidarPlace, ScanPlanner
from barn_planners.registry import ANY_PROTOCOL, PlannerEntry
from barn_planners.robots import fitted
from barn_worlds.base.compute import Compute
from barn_worlds.base.config import quantity
from barn_worlds.base.types import STOP, Pose2D, Scan, Velocity2D


@dataclass(frozen=True)
class GapConfig(LidarPlace):
    """Follow-the-gap for a Jackal."""

    max_speed_mps: float = quantity(0.5, "highest forward speed", "m/s", 0.0, 5.0)
    min_speed_mps: float = quantity(
        0.1, "lowest forward speed while driving", "m/s", 0.0, 5.0
    )
    max_turn_radps: float = quantity(1.57, "highest yaw rate", "rad/s", 0.0, 10.0)
    k_prop_per_s: float = quantity(
        2.0, "yaw rate per radian of bearing", "1/s", 0.0, 100.0
    )
    turn_in_place_rad: float = quantity(
        0.8, "turn in place if the bearing is beyond this", "rad", 0.0, math.pi
    )
    look_ahead_m: float = quantity(
        1.5, "a gap is open if it is free this far", "m", 0.1, 30.0
    )
    least_free_m: float = quantity(
        0.3, "if no gap is open, take the longest, if this long", "m", 0.0, 30.0
    )
    robot_radius_m: float = quantity(0.28, "inflation of obstacles", "m", 0.05, 5.0)
    half_length_m: float = quantity(0.254, "half the robot's length", "m", 0.01, 5.0)
    half_width_m: float = quantity(0.215, "half the robot's width", "m", 0.01, 5.0)
    margin_m: float = quantity(
        0.03,
        "margin beside the robot, and all around it when turning",
        "m",
        minimum=0.0,
    )
    stop_distance_m: float = quantity(
        0.15, "stop if anything ahead is nearer", "m", 0.0, 5.0
    )
    gap_weight_m: float = quantity(
        0.5, "weight of the gap's centre, by the nearest distance", "m", minimum=0.0
    )
    max_bearing_rad: float = quantity(
        2.2, "gaps are searched up to this bearing", "rad", 0.1, 3.14
    )
    directions: int = quantity(151, "evenly spaced directions", "", 3, 1001)
    goal_tolerance_m: float = quantity(
        0.25, "the goal is reached within this", "m", 0.01, 10.0
    )
    turning_radius_m: float = quantity(
        0.0, "furthest corner; 0: half sizes'", "m", 0.0, 10.0, optional=True
    )
    guard: GuardConfig = field(default_factory=GuardConfig)


class GapPlanner(ScanPlanner):
    """Decides from each scan alone."""

    def __init__(self, config: GapConfig):
        super().__init__(config.guard, config.goal_tolerance_m)
        self.config = config
        self._directions = np.linspace(
            -config.max_bearing_rad, config.max_bearing_rad, config.directions
        )

    def start(self, task: Task, seed: int) -> None:
        """Begin a new trial."""
        super().start(task, seed)
        self._pose, self._free = Pose2D(0.0, 0.0, 0.0), np.empty(0)

    def step(self, observation: Observation) -> Decision:
        """Steer for the gap nearest to the goal's direction."""
        self._free = np.empty(0)
        return super().step(observation)

    def drive(self, observation: Observation, goal: Pose2D) -> Decision:
        """Return the command to the chosen gap."""
        config, pose, to_goal = (
            self.config,
            observation.odometry.pose,
            observation.pose.inverse() @ goal,
        )
        distance = math.hypot(to_goal.x, to_goal.y)
        points = returns(
            observation.scan, config.lidar, config.look_ahead_m + config.robot_radius_m
        )
        free = self._free_distances(observation, points)
        self._pose, self._free = pose, free
        chosen = self._bearing(
            free,
            points,
            math.atan2(to_goal.y, to_goal.x),
            min(distance, config.look_ahead_m),
        )
        if chosen is None:
            return Decision(STOP, PlannerStatus.BLOCKED, "no gap is open")
        return self._steer(chosen, free, points)

    def view(self) -> PlannerView:
        """Return the directions as candidates, as far as they are free, in the odom frame."""
        if self._task is None or not len(self._free):
            return PlannerView()
        ends = self._free[:, None] * np.stack(
            [np.cos(self._directions), np.sin(self._directions)], axis=1
        )
        starts = np.broadcast_to([self._pose.x, self._pose.y], ends.shape)
        lines = np.stack([starts, self._pose.transform(ends)], axis=1)
        return PlannerView(
            candidates=lines, candidate_costs=self.config.look_ahead_m - self._free
        )

    def _free_distances(
        self, observation: Observation, points: FloatArray
    ) -> FloatArray:
        """Return how far the robot can go in each direction among points (n, 2) of the scan in base_link."""
        del observation
        return free_distances(
            points,
            self._directions,
            self.config.robot_radius_m,
            self.config.look_ahead_m,
        )

    def _bearing(
        self, free: FloatArray, points: FloatArray, goal_bearing: float, needed_m: float
    ) -> float | None:
        is_open = free >= needed_m - 1e-9
        if not is_open.any():
            is_open = free >= max(float(free.max()) - 1e-9, self.config.least_free_m)
        if not is_open.any():
            return None
        edges = np.flatnonzero(np.diff(np.concatenate([[False], is_open, [False]])))
        first, last = self._directions[edges[::2]], self._directions[edges[1::2] - 1]
        nearest = np.clip(goal_bearing, first, last)
        gap = int(np.argmin(np.abs(nearest - goal_bearing)))
        closest_m = (
            float(np.hypot(points[:, 0], points[:, 1]).min())
            if len(points)
            else math.inf
        )
        weight = self.config.gap_weight_m / max(closest_m, 1e-3)
        centre = 0.5 * (first[gap] + last[gap])
        return float((weight * centre + nearest[gap]) / (weight + 1.0))

    def _steer(self, bearing: float, free: FloatArray, points: FloatArray) -> Decision:
        config = self.config
        rate = min(
            max(config.k_prop_per_s * bearing, -config.max_turn_radps),
            config.max_turn_radps,
        )
        ahead_m = self._clear_ahead(points)
        free_m = float(np.interp(bearing, self._directions, free))
        figures = {"bearing_rad": bearing, "clear_ahead_m": ahead_m, "free_m": free_m}
        if abs(bearing) > config.turn_in_place_rad or ahead_m < config.stop_distance_m:
            corner_m = config.turning_radius_m or math.hypot(
                config.half_length_m, config.half_width_m
            )
            reach = corner_m + config.margin_m
            if len(points) and bool(
                (np.hypot(points[:, 0], points[:, 1]) < reach).any()
            ):
                return Decision(
                    STOP,
                    PlannerStatus.BLOCKED,
                    "an obstacle is too near to turn",
                    diagnostics=figures,
                )
            return Decision(Velocity2D(0.0, rate), diagnostics=figures)
        share = min(
            1.0, ahead_m / config.look_ahead_m, free_m / config.look_ahead_m
        ) * math.cos(bearing)
        speed = max(
            config.max_speed_mps * share,
            min(config.min_speed_mps, config.max_speed_mps),
        )
        return Decision(Velocity2D(speed, rate), diagnostics=figures)

    def _clear_ahead(self, points: FloatArray) -> float:
        config = self.config
        in_the_way = points[
            (np.abs(points[:, 1]) <= config.half_width_m + config.margin_m)
            & (points[:, 0] > 0.0),
            0,
        ]
        nearest_m = float(in_the_way.min()) if len(in_the_way) else math.inf
        return min(nearest_m - config.half_length_m, config.look_ahead_m)


def returns(scan: Scan, lidar: Pose2D, within_m: float) -> FloatArray:
    """Return the points (n, 2) in base_link of a scan that are nearer to its lidar than `within_m`; lidar: its pose."""
    ranges = scan.ranges.astype(np.float64)
    seen = (ranges >= scan.range_min) & (ranges < min(scan.range_max, within_m))
    angles = scan.angles()[seen] + lidar.yaw
    return np.stack(
        [
            lidar.x + ranges[seen] * np.cos(angles),
            lidar.y + ranges[seen] * np.sin(angles),
        ],
        axis=1,
    )


def free_distances(
    points: FloatArray, directions: FloatArray, radius_m: float, longest_m: float
) -> FloatArray:
    """Return how far, up to `longest_m`, a disc at the origin can go in each direction (k,) before a point (n, 2)."""
    if len(points) == 0:
        return np.full(len(directions), longest_m)
    along = np.outer(np.cos(directions), points[:, 0]) + np.outer(
        np.sin(directions), points[:, 1]
    )
    aside_squared = np.maximum((points**2).sum(axis=1) - along**2, 0.0)
    contact = along - np.sqrt(np.maximum(radius_m**2 - aside_squared, 0.0))
    touched = (aside_squared < radius_m**2) & (along > 0.0)
    distances: FloatArray = np.where(
        touched, np.clip(contact, 0.0, longest_m), longest_m
    ).min(axis=1)
    return distances


ENTRY = PlannerEntry(
    GapPlanner,
    {ANY_PROTOCOL: GapConfig()},
    "follow-the-gap baseline with collision stop: the scan and the goal, nothing else",
    fitted,
    compute=Compute(delay_s=0.0005),
)
