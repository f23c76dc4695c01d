"""Model predictive path integral control (MPPI), a sampling planner.

After Williams, Aldrich and Theodorou, "Model predictive path integral control: from theory to parallel computation",
JGCD 40(2), 2017, and Williams, Drews, Goldfain, Rehg and Theodorou, "Information-theoretic model predictive control:
theory and applications to autonomous driving", T-RO 34(6), 2018. Control sequences are sampled around the last
solution and rolled out; their mean, weighted with exp(-cost / temperature), is the next solution.

Critics, weights and thresholds are those of Nav2's MPPI controller for a differential drive. Differences:

- Everything runs once per control cycle in one thread: new noise from the trial's seed (SFC64), and a costmap update
  with each scan. Nav2 samples in its own thread and updates its costmap at 5 Hz.
- One of the samples is the last solution itself, so a cycle never does worse than keeping it.
- Points of the path are evenly spaced instead of one per cell of the plan.
- The pose of a step is where that step's control leads, and the first control is sent; Nav2 shifts both by one.
- By default it does not reverse, since the Jackal's lidar sees nothing behind; Nav2's default is 0.35 m/s.
- The plan comes from this package's navfn, not from NavFn or Smac; recovery is `barn_planners.navigation.recovery`.
"""

import math

import numpy as np

from barn_planners.costmap.config import CostmapConfig
from barn_planners.costmap.costmap import Costmap
from barn_planners.costmap.kernels import INSCRIBED
from barn_planners.interface import FloatArray, PlannerView
from barn_planners.mppi import kernels, sampling
from barn_planners.mppi.config import MppiConfig, MppiPlannerConfig
from barn_planners.navigation.guard import ProgressCheck
from barn_planners.navigation.loop import (
    Control,
    ControlInput,
    Controller,
    NavigationPlanner,
)
from barn_planners.registry import ANY_PROTOCOL, PlannerEntry
from barn_planners.robots import fitted
from barn_worlds.base.compute import Compute
from barn_worlds.base.types import STOP, Pose2D, Velocity2D, wrap_angle

# Savitzky and Golay's 9-point quadratic, which smooths the solution as Nav2 does.
_SMOOTHING = np.array([-21.0, 14.0, 39.0, 54.0, 59.0, 54.0, 39.0, 14.0, -21.0]) / 231.0
_HALF = len(_SMOOTHING) // 2


class MppiController(Controller):
    """Follows the plan by sampling; each cycle starts from the last solution."""

    def __init__(self, config: MppiConfig):
        self.config = config
        shape = (config.steps, config.samples)
        self._noise = np.empty((config.steps, 2, config.samples), np.float32)
        self._controls = np.empty_like(self._noise)
        self._xs, self._ys, self._yaws = (np.empty(shape, np.float32) for _ in range(3))
        self._costs = np.empty(config.samples)
        self._mean = np.empty((config.steps, 2))
        self._spread = np.array([config.speed_std_mps, config.turn_std_radps])
        turn = config.turn_acceleration_radps2
        self._change = config.step_s * np.array(
            [[config.deceleration_mps2, config.acceleration_mps2], [turn, turn]]
        )
        self._limits = np.array(
            [config.min_speed_mps, config.max_speed_mps, config.max_turn_radps]
        )
        self._progress = ProgressCheck(config.progress_m, config.progress_s)
        self.reset(0)

    def reset(self, seed: int) -> None:
        """Begin a new trial and forget the last one."""
        self._random = sampling.noise_state(seed)
        self._progress.reset()
        self._forget()
        self._near_goal = False
        self._pose = Pose2D(0.0, 0.0, 0.0)
        self._sampled = False

    def control(self, inputs: ControlInput) -> Control:
        """Improve the solution and return its first control."""
        config, goal, pose = self.config, inputs.goal, inputs.pose
        to_goal = pose.distance(goal)
        self._near_goal = (
            to_goal <= (2.0 if self._near_goal else 1.0) * config.xy_tolerance_m
        )
        if (
            self._near_goal
            and abs(wrap_angle(goal.yaw - pose.yaw)) <= config.yaw_tolerance_rad
        ):
            return Control(STOP, goal_reached=True)
        if self._progress.stuck(inputs.stamp_ns, pose):
            self._forget()
            return Control(
                None,
                reason=f"moved less than {config.progress_m:g} m in {config.progress_s:g} s",
            )
        self._pose = pose
        path = _Path.ahead(inputs, config)
        collisions = config.samples
        for _ in range(2):
            for _ in range(config.iterations):
                collisions = self._improve(inputs, path, to_goal)
            if collisions < config.samples:
                break
            self._forget()
        figures = {
            "lowest_cost": float(self._costs.min()),
            "collision_share": collisions / config.samples,
        }
        if collisions == config.samples:
            return Control(
                None, reason="all sampled trajectories collide", diagnostics=figures
            )
        return Control(self._advance(), diagnostics=figures)

    def view(self) -> PlannerView:
        """Return a subset of the sampled trajectories with their costs, and the solution's trajectory."""
        if not self._sampled or self.config.shown == 0:
            return PlannerView()
        every = max(1, self.config.samples // self.config.shown)
        candidates = np.stack(
            [self._xs[:, ::every].T, self._ys[:, ::every].T], axis=2
        ).astype(np.float64)
        costs = self._costs[::every].copy()
        costs[costs >= self.config.critics.collision_cost] = np.inf
        yaws = self._pose.yaw + self.config.step_s * np.cumsum(self._solution[:, 1])
        headings = np.concatenate(([self._pose.yaw], yaws[:-1]))
        steps = (
            self.config.step_s
            * self._solution[:, :1]
            * np.stack([np.cos(headings), np.sin(headings)], axis=1)
        )
        places = np.array([self._pose.x, self._pose.y]) + np.cumsum(steps, axis=0)
        local_plan = np.column_stack([places, yaws])
        return PlannerView(
            local_plan=local_plan, candidates=candidates, candidate_costs=costs
        )

    def _forget(self) -> None:
        self._solution = np.zeros((self.config.steps, 2))
        self._sent = np.zeros((_HALF, 2))

    def _improve(self, inputs: ControlInput, path: "_Path", to_goal: float) -> int:
        """Sample once around the solution and replace it; return the number of collisions."""
        config, pose, velocity = self.config, inputs.pose, inputs.velocity
        sampling.fill_normal(self._random, self._noise.reshape(-1, config.samples))
        self._noise[:, :, 0] = 0.0
        start = (pose.x, pose.y, pose.yaw, velocity.linear, velocity.angular)
        drawn = (
            self._solution,
            self._noise,
            self._spread,
            self._change,
            start,
            config.step_s,
        )
        sampling.rollout(*drawn, self._controls, self._xs, self._ys, self._yaws)
        self._sampled = True
        self._costs[:] = 0.0
        collisions = self._add_obstacle_costs(inputs.costmap, to_goal)
        self._add_path_costs(inputs, path, to_goal)
        sampling.weighted_mean(
            self._costs, self._controls, config.temperature, self._mean
        )
        self._solution = sampling.smoothed(self._mean, self._sent, _SMOOTHING)
        sampling.hold_within(self._solution, self._limits, self._change, start[3:])
        return collisions

    def _add_obstacle_costs(self, costmap: Costmap, to_goal: float) -> int:
        critics, body = self.config.critics, costmap.config
        poses, grid = (self._xs, self._ys, self._yaws), (costmap.costs, *costmap.grid)
        outline = (costmap.outline, lowest_cost_in_reach(body, costmap.resolution))
        weights = (
            critics.obstacle_weight,
            critics.critical_cost,
            critics.collision_cost,
        )
        stride, near_goal = critics.obstacle_stride, to_goal < critics.near_goal_m
        collisions: int = kernels.add_obstacle_costs(
            self._costs, *poses, grid, outline, stride, *weights, near_goal
        )
        return collisions

    def _add_path_costs(
        self, inputs: ControlInput, path: "_Path", to_goal: float
    ) -> None:
        config, critics, costs = self.config, self.config.critics, self._costs
        xs, ys, yaws, goal = self._xs, self._ys, self._yaws, inputs.goal
        position_weight = (
            critics.goal_weight if to_goal < critics.goal_within_m else 0.0
        )
        yaw_weight = (
            critics.goal_angle_weight if to_goal < critics.goal_angle_within_m else 0.0
        )
        if position_weight > 0.0 or yaw_weight > 0.0:
            kernels.add_goal_costs(
                costs,
                xs,
                ys,
                yaws,
                (goal.x, goal.y, goal.yaw),
                position_weight,
                yaw_weight,
            )
        heads_for_path = to_goal >= critics.goal_angle_within_m
        drawn = (
            self._controls,
            self._solution,
            self._spread,
            self._limits,
            config.step_s,
        )
        forward_weight = critics.forward_weight if heads_for_path else 0.0
        kernels.add_control_costs(
            costs, *drawn, config.gamma, critics.limit_weight, forward_weight
        )
        furthest = kernels.furthest_reached(path.points, xs, ys)
        if to_goal >= critics.goal_within_m:
            x, y = path.point(furthest + critics.follow_points)
            kernels.add_follow_costs(costs, xs, ys, x, y, critics.follow_weight)
        if not heads_for_path:
            return
        pose = inputs.pose
        x, y = path.point(furthest + critics.angle_points)
        if (
            abs(wrap_angle(math.atan2(y - pose.y, x - pose.x) - pose.yaw))
            > critics.angle_beyond_rad
        ):
            kernels.add_angle_costs(costs, xs, ys, yaws, x, y, critics.angle_weight)
        if (
            furthest >= critics.align_points
            and path.blocked_share(furthest) <= critics.align_most_blocked
        ):
            start = (pose.x, pose.y)
            stride, weight = critics.align_stride, critics.align_weight
            kernels.add_align_costs(
                costs, xs, ys, start, path.points, path.arc, path.clear, stride, weight
            )

    def _advance(self) -> Velocity2D:
        first = self._solution[0]
        self._sent = np.concatenate([self._sent[1:], first[None]])
        self._solution = np.concatenate([self._solution[1:], self._solution[-1:]])
        return Velocity2D(float(first[0]), float(first[1]))


class _Path:
    """The part of the plan ahead of the robot: points (n, 2), distance along it (n,), whether they are free (n,)."""

    def __init__(self, points: FloatArray, costmap: Costmap):
        self.points = points
        self.arc = np.concatenate(
            ([0.0], np.cumsum(np.hypot(*np.diff(points, axis=0).T)))
        )
        self.clear = np.array(
            [(costmap.cost_at(x, y) or 0) < INSCRIBED for x, y in points.tolist()]
        )

    @classmethod
    def ahead(cls, inputs: ControlInput, config: MppiConfig) -> "_Path":
        """Return the path from the plan's point nearest to the robot."""
        nearest = (
            ((inputs.visible[:, :2] - (inputs.pose.x, inputs.pose.y)) ** 2)
            .sum(axis=1)
            .argmin()
        )
        most = 2 + int(config.path_ahead_m / config.path_spacing_m)
        return cls(
            kernels.resample(inputs.visible[nearest:, :2], config.path_spacing_m, most),
            inputs.costmap,
        )

    def point(self, index: int) -> tuple[float, float]:
        """Return a point by its number; the last one for larger numbers."""
        x, y = self.points[min(index, len(self.points) - 1)]
        return float(x), float(y)

    def blocked_share(self, index: int) -> float:
        """Return the share of the points up to this number that is not free."""
        return 1.0 - float(self.clear[: index + 1].mean())


def lowest_cost_in_reach(config: CostmapConfig, resolution: float) -> int:
    """Return the lowest cost of a cell from which the outline, and a cell's diagonal, may reach a lethal one."""
    reach_m = config.circumscribed_m + math.sqrt(2.0) * resolution
    if not config.soft_costs or reach_m > config.inflation_radius_m:
        return 0
    return int(
        252.0 * math.exp(-config.cost_scaling_per_m * (reach_m - config.inscribed_m))
    )


ENTRY = PlannerEntry(
    lambda config: NavigationPlanner(config, MppiController(config.mppi)),
    {ANY_PROTOCOL: MppiPlannerConfig()},
    "model predictive path integral, after Nav2's",
    fitted,
    compute=Compute(delay_s=0.002),
)
