"""Model predictive path integral control (MPPI), a sampling planner.

After Williams, Aldrich and Theodorou, "Model predictive path integral control: from
theory to parallel computation", JGCD 40(2), 2017, and Williams, Drews, Goldfain, Rehg
and Theodorou, "Information-theoretic model predictive control: theory and applications
to autonomous driving", T-RO 34(6), 2018. Control sequences are sampled around the last
solution and rolled out. Their mean, weighted with exp(-cost / temperature), is the next
solution.

Critics, weights and thresholds are those of Nav2's MPPI controller for a differential
drive. Differences:

- Everything runs once per control cycle in one thread: new noise from the trial's seed
  (SFC64), and a costmap update with each scan. Nav2 samples in its own thread and
  updates its costmap at 5 Hz.
- One of the samples is the last solution itself, so a cycle never does worse than it.
- Points of the path are evenly spaced instead of one per cell of the plan.
- The pose of a step is where that step's control leads, and the first control is sent;
  Nav2 shifts both by one.
- By default the robot does not reverse, since the Jackal's lidar sees nothing behind;
  Nav2's default is 0.35 m/s.
- The plan comes from this package's navfn, not from NavFn or Smac; recovery is
  `barn_planners.navigation.recovery`.
"""

import math

import numpy as np

from barn_planners.costmap.config import CostmapConfig
from barn_planners.costmap.costmap import Costmap
from barn_planners.costmap.kernels import INSCRIBED
from barn_planners.interface import PlannerView
from barn_planners.mppi import kernels, sampling
from barn_planners.mppi.config import MppiConfig, MppiPlannerConfig
from barn_planners.navigation.loop import (
    Control,
    ControlInput,
    Controller,
    NavigationPlanner,
)
from barn_planners.navigation.progress import ProgressCheck
from barn_planners.registry import ANY_PROTOCOL, PlannerEntry
from barn_planners.robots import fit_to_robot
from barn_worlds.base.arrays import side_lengths, unit_vectors
from barn_worlds.base.compute import Compute
from barn_worlds.base.types import ORIGIN, STOP, Pose2D, Velocity2D, wrap_angle

# Savitzky and Golay's 9-point quadratic, which smooths the solution as Nav2 does.
_SMOOTHING = np.array([-21.0, 14.0, 39.0, 54.0, 59.0, 54.0, 39.0, 14.0, -21.0]) / 231.0
_PAST_CONTROLS = len(_SMOOTHING) // 2
# Once the goal's position is reached, it counts as reached up to this many tolerances.
_TOLERANCE_HYSTERESIS = 2.0


class MppiController(Controller):
    """Follows the plan by sampling; each cycle starts from the last solution."""

    def __init__(self, config: MppiConfig):
        """Allocate the arrays of samples; `reset` begins each trial."""
        self.config = config
        # Allocated once: these arrays have megabytes, and a cycle fills all of them
        # anew.
        self._noise = np.empty((config.steps, 2, config.samples), np.float32)
        self._controls = np.empty_like(self._noise)
        self._poses = np.empty((config.steps, 3, config.samples), np.float32)
        self._costs = np.empty(config.samples)
        # In double precision, as sums over thousands of samples lose digits in single.
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
        """Forget the last trial and let the noise begin anew from `seed`."""
        self._random = sampling.noise_state(seed)
        self._progress.reset()
        self._forget_solution()
        self._is_at_goal = False
        self._pose = ORIGIN
        self._has_samples = False

    def control(self, inputs: ControlInput) -> Control:
        """Return the first control, STOP at the goal, none if stuck or all collide.

        If all samples collide or the robot is stuck, there is a reason instead.
        """
        config = self.config
        pose = inputs.pose
        goal_distance_m = pose.distance(inputs.goal)
        tolerance_m = config.xy_tolerance_m
        if self._is_at_goal:
            # Otherwise a robot that drifts while it turns would drive back again and
            # again.
            tolerance_m = _TOLERANCE_HYSTERESIS * tolerance_m
        self._is_at_goal = goal_distance_m <= tolerance_m
        goal_angle = abs(wrap_angle(inputs.goal.yaw - pose.yaw))
        if self._is_at_goal and goal_angle <= config.yaw_tolerance_rad:
            return Control(STOP, goal_reached=True)

        if self._progress.is_stuck(inputs.stamp_ns, pose):
            self._forget_solution()
            limits = f"{config.progress_m:g} m in {config.progress_s:g} s"
            return Control(None, reason=f"moved less than {limits}")

        self._pose = pose
        path = _Path(inputs, config)
        collisions = self._improve(inputs, path, goal_distance_m)
        if collisions == config.samples:
            # Samples around a solution that collides may all collide: sample around
            # rest.
            self._forget_solution()
            collisions = self._improve(inputs, path, goal_distance_m)
        figures = {
            "lowest_cost": float(self._costs.min()),
            "collision_share": collisions / config.samples,
        }
        if collisions == config.samples:
            self._forget_solution()
            return Control(
                None, reason="all sampled trajectories collide", diagnostics=figures
            )
        return Control(self._pop_command(), diagnostics=figures)

    def view(self) -> PlannerView:
        """Return some samples with costs, inf if they collide, and the solution."""
        config = self.config
        if not self._has_samples or config.shown == 0:
            return PlannerView()

        # Evenly spread, and so the same samples whether or not somebody looks.
        stride = max(1, config.samples // config.shown)
        costs = self._costs[::stride].copy()
        costs[costs >= config.critics.collision_cost] = np.inf

        pose = self._pose
        yaws = pose.yaw + config.step_s * np.cumsum(self._solution[:, 1])
        headings = np.concatenate(([pose.yaw], yaws[:-1]))
        steps = config.step_s * self._solution[:, :1] * unit_vectors(headings)
        positions = np.array(pose.position) + np.cumsum(steps, axis=0)
        return PlannerView(
            local_plan=np.column_stack([positions, yaws]),
            candidates=self._poses[:, :2, ::stride].transpose(2, 0, 1).astype(float),
            candidate_costs=costs,
        )

    def _forget_solution(self) -> None:
        """Set the solution, and the controls sent before it, to zero."""
        self._solution = np.zeros((self.config.steps, 2))
        self._past = np.zeros((_PAST_CONTROLS, 2))

    def _pop_command(self) -> Velocity2D:
        """Return the first control and shift the solution by a step."""
        first = self._solution[0]
        self._past = np.concatenate([self._past[1:], first[None]])
        # The last control is repeated at the end: nothing is known of that step yet.
        self._solution = np.concatenate([self._solution[1:], self._solution[-1:]])
        return Velocity2D(float(first[0]), float(first[1]))

    def _improve(
        self, inputs: ControlInput, path: "_Path", goal_distance_m: float
    ) -> int:
        """Sample around the solution and improve it; return how many samples collide.

        With several rounds, those of the last one count.
        """
        collisions = self.config.samples
        for _ in range(self.config.iterations):
            self._sample(inputs)
            self._costs[:] = 0.0
            collisions = self.add_obstacle_costs(inputs.costmap, goal_distance_m)
            self._add_goal_and_control_costs(inputs.goal, goal_distance_m)
            self._add_path_costs(inputs.pose, path, goal_distance_m)
            sampling.weighted_mean(
                self._costs, self._controls, self.config.temperature, self._mean
            )
            self._solution = sampling.smooth(self._mean, self._past, _SMOOTHING)
            sampling.limit_controls(
                self._solution, self._limits, self._change, inputs.velocity.numbers
            )
        return collisions

    def _sample(self, inputs: ControlInput) -> None:
        """Fill controls and poses with samples around the solution, itself first."""
        sampling.fill_normal(self._random, self._noise.reshape(-1, self.config.samples))
        self._noise[:, :, 0] = 0.0
        sampling.rollout(
            self._solution,
            self._noise,
            self._spread,
            self._change,
            (*inputs.pose.numbers, *inputs.velocity.numbers),
            self.config.step_s,
            self._controls,
            self._poses,
        )
        self._has_samples = True

    def add_obstacle_costs(self, costmap: Costmap, goal_distance_m: float) -> int:
        """Add costmap costs of the sampled trajectories; return how many collide.

        Derived controllers add costs of other obstacles here.

        Args:
            costmap: Costs around the robot.
            goal_distance_m: Distance of the robot from the goal.

        Returns:
            Number of trajectories that collide.
        """
        critics = self.config.critics
        return kernels.add_obstacle_costs(
            self._costs,
            self._poses,
            costmap.costs,
            costmap.grid,
            costmap.outline,
            lowest_cost_in_reach(costmap.config, costmap.resolution),
            critics.obstacle_stride,
            critics.obstacle_weight,
            critics.critical_cost,
            critics.collision_cost,
            goal_distance_m < critics.near_goal_m,
        )

    def _add_goal_and_control_costs(self, goal: Pose2D, goal_distance_m: float) -> None:
        """Add the costs of goal and controls to those of the samples."""
        config = self.config
        critics = config.critics
        counts_position = goal_distance_m < critics.goal_within_m
        counts_yaw = goal_distance_m < critics.goal_angle_within_m
        position_weight = critics.goal_weight if counts_position else 0.0
        yaw_weight = critics.goal_angle_weight if counts_yaw else 0.0
        kernels.add_goal_costs(
            self._costs,
            self._poses,
            goal.numbers,
            position_weight,
            yaw_weight,
        )
        kernels.add_control_costs(
            self._costs,
            self._controls,
            self._solution,
            self._spread,
            self._limits,
            config.step_s,
            config.gamma,
            critics.limit_weight,
            0.0 if counts_yaw else critics.forward_weight,
        )

    def _add_path_costs(
        self, pose: Pose2D, path: "_Path", goal_distance_m: float
    ) -> None:
        """Add the costs of the path, as far as they apply, to those of the samples."""
        critics = self.config.critics
        furthest = kernels.find_furthest_point(path.points, self._poses)
        if goal_distance_m >= critics.goal_within_m:
            x, y = path.point(furthest + critics.follow_points)
            kernels.add_follow_costs(
                self._costs, self._poses, x, y, critics.follow_weight
            )
        # Near the goal its own heading counts, not the direction of the path.
        if goal_distance_m < critics.goal_angle_within_m:
            return

        x, y = path.point(furthest + critics.angle_points)
        bearing = wrap_angle(math.atan2(y - pose.y, x - pose.x) - pose.yaw)
        if abs(bearing) > critics.angle_beyond_rad:
            kernels.add_angle_costs(
                self._costs, self._poses, x, y, critics.angle_weight
            )

        # A path that is blocked has to be left, so keeping to it must not count.
        if (
            furthest >= critics.align_points
            and path.blocked_share(furthest) <= critics.align_most_blocked
        ):
            kernels.add_align_costs(
                self._costs,
                self._poses,
                pose.position,
                path.points,
                path.arc,
                path.is_clear,
                critics.align_stride,
                critics.align_weight,
            )


class _Path:
    """The part of the plan ahead of the robot, with evenly spaced points."""

    def __init__(self, inputs: ControlInput, config: MppiConfig):
        """Resample the visible plan ahead evenly; note arc lengths and free points."""
        plan = inputs.visible[:, :2]
        offsets = plan - inputs.pose.position
        nearest = (offsets**2).sum(axis=1).argmin()
        max_points = 2 + int(config.path_ahead_m / config.path_spacing_m)
        # Points (n, 2) in m, distance along the path (n,) in m, whether a point is
        # free.
        self.points = kernels.resample(
            plan[nearest:], config.path_spacing_m, max_points
        )
        self.arc = np.concatenate(([0.0], np.cumsum(side_lengths(self.points))))
        costs = [inputs.costmap.cost_at(x, y) for x, y in self.points.tolist()]
        self.is_clear = np.array([(cost or 0) < INSCRIBED for cost in costs])

    def point(self, index: int) -> tuple[float, float]:
        """Return the point (x, y) in m at an index, the last one if it is larger."""
        x, y = self.points[min(index, len(self.points) - 1)]
        return float(x), float(y)

    def blocked_share(self, index: int) -> float:
        """Return the share (0 to 1) of blocked points up to and including an index."""
        return 1.0 - float(self.is_clear[: index + 1].mean())


def lowest_cost_in_reach(config: CostmapConfig, resolution: float) -> int:
    """Return the lowest cost from which an outline may touch a lethal cell; 0 if any.

    Args:
        config: Inflation and footprint of the costmap.
        resolution: Side of a cell in m.

    Returns:
        Cost at the circumscribed radius and a cell's diagonal; 0 if inflation ends
        before.
    """
    reach_m = config.circumscribed_m + math.sqrt(2.0) * resolution
    if not config.soft_costs or reach_m > config.inflation_radius_m:
        return 0
    decay = -config.cost_scaling_per_m * (reach_m - config.inscribed_m)
    return int(252.0 * math.exp(decay))


ENTRY = PlannerEntry(
    build=lambda config: NavigationPlanner(config, MppiController(config.mppi)),
    presets={ANY_PROTOCOL: MppiPlannerConfig()},
    summary="model predictive path integral control, after Nav2's controller",
    fit=fit_to_robot,
    compute=Compute(delay_s=0.002),
)
