"""Follow the gap: a simple baseline that uses the current scan and the goal.

After Sezer and Gokasan, "A novel obstacle avoidance algorithm: follow the gap method",
Robotics and Autonomous Systems 60(9), 2012. Unlike in that paper, the robot takes the gap
nearest to the goal's direction, not the widest, and stops before a collision.
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
from barn_planners.navigation.observation_check import (
    LidarMountConfig,
    ObservationCheckConfig,
)
from barn_planners.navigation.scan_planner import ScanPlanner, scan_points
from barn_planners.navigation.speeds import SpeedConfig
from barn_planners.registry import ANY_PROTOCOL, PlannerEntry
from barn_planners.robots import fit_to_robot
from barn_worlds.base.arrays import unit_vectors
from barn_worlds.base.compute import Compute
from barn_worlds.base.config import optional, quantity
from barn_worlds.base.types import ORIGIN, STOP, Pose2D, Velocity2D

# Free distances this much shorter than needed still count: they come from roundings.
_ROUNDING_M = 1e-9


@dataclass(frozen=True)
class GapConfig(SpeedConfig, LidarMountConfig):
    """Follow-the-gap; the defaults are for a Jackal."""

    k_prop_per_s: float = quantity(
        2.0, "yaw rate per radian of bearing", "1/s", 0.0, 100.0
    )
    turn_in_place_rad: float = quantity(
        0.8, "turn in place if the bearing exceeds this angle", "rad", 0.0, math.pi
    )
    look_ahead_m: float = quantity(
        1.5, "a gap is open if it is free for this distance", "m", 0.1, 30.0
    )
    least_free_m: float = quantity(
        0.3,
        "if no gap is open, take the longest gap of at least this length",
        "m",
        0.0,
        30.0,
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
        0.15,
        "drive forward only if the way ahead is free for this distance",
        "m",
        0.0,
        5.0,
    )
    gap_weight_m: float = quantity(
        0.5,
        "weight of the gap's center, divided by the distance to the nearest obstacle",
        "m",
        minimum=0.0,
    )
    max_bearing_rad: float = quantity(
        2.2, "largest bearing at which gaps are sought", "rad", 0.1, 3.14
    )
    directions: int = quantity(151, "evenly spaced directions", "", 3, 1001)
    goal_tolerance_m: float = quantity(
        0.25, "distance within which the goal counts as reached", "m", 0.01, 10.0
    )
    turning_radius_m: float = optional(
        0.0,
        "distance to the farthest corner; 0: computed from the half sizes",
        "m",
        0.0,
        10.0,
    )
    guard: ObservationCheckConfig = field(default_factory=ObservationCheckConfig)


class GapPlanner(ScanPlanner):
    """Steers for the gap nearest to the goal's direction, from each scan alone."""

    def __init__(self, config: GapConfig):
        """Store the settings and spread the directions evenly."""
        super().__init__(config.guard, config.goal_tolerance_m)
        self.config = config
        self._directions = np.linspace(
            -config.max_bearing_rad, config.max_bearing_rad, config.directions
        )

    def start(self, task: Task, seed: int) -> None:
        """Begin a new trial and forget the last one; map and seed are ignored.

        Args:
            task: Goal in the planning frame; its map is ignored.
            seed: Ignored.
        """
        super().start(task, seed)
        self._pose = ORIGIN
        self._free_m = np.empty(0)

    def step(self, observation: Observation) -> Decision:
        """Return a cycle's decision: steer for a gap, turn in place, or stop."""
        self._free_m = np.empty(0)
        return super().step(observation)

    def drive(self, observation: Observation, goal: Pose2D) -> Decision:
        """Return the decision that steers for the best gap; BLOCKED if none is open.

        Args:
            observation: Readings that passed all checks.
            goal: Goal in the planning frame.
        """
        config = self.config
        # Points beyond this change no free distance.
        reach_m = config.look_ahead_m + config.robot_radius_m
        points = scan_points(observation.scan, config.lidar, reach_m)
        self._pose = observation.odometry.pose
        self._free_m = self.free_distances(observation, points)

        goal_in_base = observation.pose.inverse() @ goal
        goal_bearing = math.atan2(goal_in_base.y, goal_in_base.x)
        goal_distance_m = math.hypot(*goal_in_base.position)
        bearing = self._choose_bearing(
            points, goal_bearing, min(goal_distance_m, config.look_ahead_m)
        )
        if bearing is None:
            return Decision(STOP, PlannerStatus.BLOCKED, "no gap is open")
        return self._steer(bearing, points)

    def view(self) -> PlannerView:
        """Return each direction up to its free distance as a candidate, in odom."""
        if self._task is None or not len(self._free_m):
            return PlannerView()
        ends = self._free_m[:, None] * unit_vectors(self._directions)
        # Shown in odom, where the robot stood when it took the scan.
        starts = np.broadcast_to(self._pose.position, ends.shape)
        lines = np.stack([starts, self._pose.transform(ends)], axis=1)
        costs = self.config.look_ahead_m - self._free_m
        return PlannerView(candidates=lines, candidate_costs=costs)

    def free_distances(
        self, observation: Observation, points: FloatArray
    ) -> FloatArray:
        """Return how far in m the robot can go in each direction, up to the look-ahead.

        Args:
            observation: Readings of this cycle.
            points: Returns of its scan, (n, 2) in m in base_link.

        Returns:
            Distances (directions,) in m, up to the look-ahead distance.
        """
        del observation
        config = self.config
        return free_distances(
            points, self._directions, config.robot_radius_m, config.look_ahead_m
        )

    def _choose_bearing(
        self, points: FloatArray, goal_bearing: float, needed_m: float
    ) -> float | None:
        """Return a bearing (rad) in the open or longest gap nearest the goal, or None.

        The nearer an obstacle is, the more the bearing is drawn to the gap's center.
        """
        free_m = self._free_m
        # Nobody needs more room than up to the goal.
        is_open = free_m >= needed_m - _ROUNDING_M
        if not is_open.any():
            longest_m = float(free_m.max()) - _ROUNDING_M
            is_open = free_m >= max(longest_m, self.config.least_free_m)
        if not is_open.any():
            return None

        # Gaps are runs of open directions: each begins and ends where `is_open`
        # changes.
        edges = np.flatnonzero(np.diff(np.concatenate([[False], is_open, [False]])))
        first = self._directions[edges[::2]]
        last = self._directions[edges[1::2] - 1]
        # The bearing within each gap that is nearest to the goal's; ties go to the
        # right.
        nearest = np.clip(goal_bearing, first, last)
        gap = int(np.argmin(np.abs(nearest - goal_bearing)))

        # The nearer an obstacle, the more the center of the gap counts.
        closest_m = float(np.hypot(*points.T).min(initial=math.inf))
        weight = self.config.gap_weight_m / max(closest_m, 1e-3)
        center = 0.5 * (first[gap] + last[gap])
        return float((weight * center + nearest[gap]) / (weight + 1.0))

    def _steer(self, bearing: float, points: FloatArray) -> Decision:
        """Return the decision to drive or turn to a bearing (rad); BLOCKED if no room.

        The robot turns in place toward a bearing far aside or if the way ahead is
        blocked.
        """
        config = self.config
        rate = config.k_prop_per_s * bearing
        rate = min(max(rate, -config.max_turn_radps), config.max_turn_radps)
        ahead_m = self._clear_ahead(points)
        free_m = float(np.interp(bearing, self._directions, self._free_m))
        figures = {"bearing_rad": bearing, "clear_ahead_m": ahead_m, "free_m": free_m}

        turns_in_place = abs(bearing) > config.turn_in_place_rad
        if turns_in_place or ahead_m < config.stop_distance_m:
            # A robot that turns in place sweeps the circle of its farthest corner.
            corner_m = config.turning_radius_m or math.hypot(
                config.half_length_m, config.half_width_m
            )
            if (np.hypot(*points.T) < corner_m + config.margin_m).any():
                return Decision(
                    STOP,
                    PlannerStatus.BLOCKED,
                    "an obstacle is too near to turn",
                    diagnostics=figures,
                )
            return Decision(Velocity2D(0.0, rate), diagnostics=figures)

        share = min(1.0, ahead_m / config.look_ahead_m, free_m / config.look_ahead_m)
        # Slower while it turns: at full speed it would leave the direction that is
        # free.
        share *= math.cos(bearing)
        lowest = min(config.min_speed_mps, config.max_speed_mps)
        speed = max(config.max_speed_mps * share, lowest)
        return Decision(Velocity2D(speed, rate), diagnostics=figures)

    def _clear_ahead(self, points: FloatArray) -> float:
        """Return the free distance in m before the robot's front, at most look-ahead.

        It is negative if a return lies beside or within the robot.
        """
        config = self.config
        half_corridor_m = config.half_width_m + config.margin_m
        is_in_corridor = np.abs(points[:, 1]) <= half_corridor_m
        ahead = points[is_in_corridor & (points[:, 0] > 0.0), 0]
        nearest_m = float(ahead.min(initial=math.inf))
        return min(nearest_m - config.half_length_m, config.look_ahead_m)


def free_distances(
    points: FloatArray, directions: FloatArray, radius_m: float, longest_m: float
) -> FloatArray:
    """Return how far in m a disc at the origin can go in each direction, or the limit.

    Args:
        points: Obstacle points (n, 2) in m.
        directions: Directions (k,) in rad.
        radius_m: Radius of the disc in m.
        longest_m: Distance in m beyond which nothing is checked.

    Returns:
        Distances (k,) in m until a point touches the disc, up to `longest_m`.
    """
    # Each point has a distance along a direction (k, n) and one aside of it.
    along = np.outer(np.cos(directions), points[:, 0])
    along = along + np.outer(np.sin(directions), points[:, 1])
    aside_squared = np.maximum((points**2).sum(axis=1) - along**2, 0.0)
    contact = along - np.sqrt(np.maximum(radius_m**2 - aside_squared, 0.0))
    # Points behind the robot do not stop it.
    touches = (aside_squared < radius_m**2) & (along > 0.0)
    free = np.where(touches, np.clip(contact, 0.0, longest_m), longest_m)
    distances: FloatArray = free.min(axis=1, initial=longest_m)
    return distances


ENTRY = PlannerEntry(
    build=GapPlanner,
    presets={ANY_PROTOCOL: GapConfig()},
    summary="follow-the-gap baseline: only scan and goal, with a stop before collisions",
    fit=fit_to_robot,
    compute=Compute(delay_s=0.0005),
)
