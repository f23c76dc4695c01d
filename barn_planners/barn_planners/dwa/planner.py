"""The dynamic window approach (Fox, Burgard, Thrun 1997) as a controller.

It is base_local_planner's TrajectoryPlanner with `dwa` on, which the paper's trials
ran. Each cycle samples the velocities that the robot can reach within one control
period, rolls them out and takes the cheapest. The cost adds up the distance from the
plan, the distance from its end, and the highest cost under the footprint's edges.
"""

import math

import numpy as np

from barn_planners.costmap.kernels import Pose
from barn_planners.dwa import kernels
from barn_planners.dwa.config import DwaConfig, DwaPlannerConfig
from barn_planners.dwa.kernels import SPEED, TURN
from barn_planners.dwa.memory import DwaMemory, GoalTurn
from barn_planners.dwa.search import Choice, find_best
from barn_planners.interface import PlannerView
from barn_planners.navigation.loop import (
    Control,
    ControlInput,
    Controller,
    NavigationPlanner,
)
from barn_planners.registry import PlannerEntry
from barn_planners.robots import fit_to_robot
from barn_planners.runtime.messages import choose_candidates
from barn_worlds.base.arrays import Floats
from barn_worlds.base.compute import Compute
from barn_worlds.base.config import read_presets
from barn_worlds.base.types import Pose2D, Velocity2D

_Cycle = tuple[kernels.Scene, kernels.Rules]

_DISPLAY_POSES = 80
_NO_SAMPLES = np.empty((0, kernels.COLUMNS))
_DIAGNOSTICS = {
    "cost": kernels.COST,
    "path_distance_cells": kernels.PATH,
    "goal_distance_cells": kernels.GOAL,
    "obstacle_cost": kernels.OBSTACLE,
}


class DwaController(Controller):
    """Follows a plan by the dynamic window approach."""

    def __init__(self, config: DwaConfig):
        """Allocate memory for one robot; `reset` begins each trial."""
        self.config = config
        self._memory = DwaMemory(config)
        self._goal_turn = GoalTurn(config)
        self._motion = kernels.Motion(
            config.sim_time_s,
            config.granularity_m,
            config.turn_granularity_rad,
            config.acceleration_mps2,
            config.turn_acceleration_radps2,
        )
        self._fields = kernels.new_fields(0, 0)
        self.reset(0)

    def reset(self, seed: int) -> None:
        """Forget the last trial; `seed` is ignored, as nothing is random."""
        del seed
        self._memory.reset()
        self._goal_turn.reset()
        # Kept for `view`, which is asked for after the cycle, if at all.
        self._table = _NO_SAMPLES
        self._cycle: _Cycle | None = None
        self._command: Velocity2D | None = None
        self._best = 0

    def control(self, inputs: ControlInput) -> Control:
        """Return the best sample, an escape or none; brake and turn at plan's end."""
        end = Pose2D(*inputs.visible[-1].tolist())
        if inputs.pose.distance(end) > self.config.xy_tolerance_m:
            return self._drive(inputs, end)

        # The original drives on paper here, too, and remembers what it would have done.
        is_aligned = self._goal_turn.is_aligned(inputs.pose, end)
        if self.config.roll_out_goal_turn and not is_aligned:
            self._drive(inputs, end)
        self._command = None
        return self._goal_turn.control(
            inputs, end, lambda command: self._has_room(inputs, command)
        )

    def view(self) -> PlannerView:
        """Return the winning rollout and samples, spread over all, with their costs.

        The cost is inf if a sample is not allowed, NaN if the search ruled it out.
        """
        if self._cycle is None:
            return PlannerView()

        start = self._cycle[1].start
        costs = self._table[:, kernels.COST]
        costs = np.where(costs < 0.0, math.inf, costs)
        shown = choose_candidates(costs)
        lines = kernels.traces(start, self._table[shown], self._motion, _DISPLAY_POSES)
        local_plan = None
        if self._command is not None:
            velocity = np.array([self._command.numbers])
            local_plan = kernels.traces(start, velocity, self._motion, _DISPLAY_POSES)[
                0
            ]

        return PlannerView(
            local_plan=local_plan,
            candidates=lines[:, :, :2],
            candidate_costs=costs[shown],
        )

    def _drive(self, inputs: ControlInput, end: Pose2D) -> Control:
        """Return the best allowed sample, else an escape, else only a reason.

        Table, command and memory of the cycle are kept.
        """
        self._command = None
        self._cycle = self._new_cycle(inputs)
        if self._cycle is None:
            return Control(None, reason="the plan lies off the local costmap")

        config = self.config
        scene, rules = self._cycle
        start = rules.start
        pose = Pose2D(start.x, start.y, start.yaw)
        self._table, drives = sample_velocities(
            config,
            Velocity2D(start.speed, start.turn),
            pose.distance(end),
            is_escaping=self._memory.is_escaping,
        )
        choice = Choice(
            drives,
            *self._memory.allowed_turns(),
            config.heading_lookahead_m,
            config.turn_past_blocked,
            self._best,
        )
        best = find_best(*scene, rules, self._table, choice)
        if best < 0:
            return self._escape(start)

        # This row is likely to win again, so the next search looks at it first.
        self._best = best
        row = self._table[best].tolist()
        self._command = Velocity2D(row[SPEED], row[TURN])
        self._memory.record_sample(pose, row[SPEED], row[TURN])
        diagnostics = {name: row[column] for name, column in _DIAGNOSTICS.items()}
        return Control(self._command, diagnostics=diagnostics)

    def _new_cycle(self, inputs: ControlInput) -> _Cycle | None:
        """Prepare a cycle's scene and rules; None if the plan is off the costmap."""
        config = self.config
        costmap = inputs.costmap
        start = _start(inputs)
        # The original keeps pose and velocity in single precision.
        if config.single_precision:
            start = kernels.Start(*np.array(start, np.float32).tolist())
        if self._fields.costs.shape != costmap.costs.shape:
            self._fields = kernels.new_fields(*costmap.costs.shape)

        fields = self._fields
        is_on_costmap = kernels.prepare(
            fields,
            costmap.costs,
            costmap.grid,
            inputs.visible,
            Pose(start.x, start.y, start.yaw),
            costmap.outline,
            config.robot_blocks_goal,
        )
        if not is_on_costmap:
            return None

        raster = kernels.Raster(
            costmap.origin_x, costmap.origin_y, 1.0 / costmap.resolution
        )
        ground = kernels.Ground(fields.costs, raster, costmap.outline)
        scene = kernels.Scene(ground, fields.path, fields.goal)
        # Distances are steps on the grid. The option weighs them in meters.
        scale = costmap.resolution if config.distances_in_metres else 1.0
        weights = kernels.Weights(
            config.path_weight * scale,
            config.goal_weight * scale,
            config.obstacle_weight,
        )
        return scene, kernels.Rules(start, self._motion, weights)

    def _has_room(self, inputs: ControlInput, command: Velocity2D) -> bool:
        """Return whether no obstacle forbids a command at the goal.

        With `roll_out_goal_turn` the command is rolled out; otherwise only the present
        pose is checked.
        """
        if self.config.roll_out_goal_turn:
            return self._cost(command, _start(inputs)) >= 0.0

        return inputs.costmap.has_room(*inputs.pose.numbers)

    def _cost(self, command: Velocity2D, start: kernels.Start) -> float:
        """Return the cost of a command's rollout from `start`, TOUCHES or NO_WAY."""
        if self._cycle is None:
            return kernels.NO_WAY

        scene, rules = self._cycle
        table = np.zeros((1, kernels.COLUMNS))
        table[0, SPEED] = command.linear
        table[0, TURN] = command.angular
        kernels.score(*scene, rules._replace(start=start), table)
        return float(table[0, kernels.COST])

    def _escape(self, start: kernels.Start) -> Control:
        """Back up if free or `escape_through`, else give no command; record that."""
        config = self.config
        command = Velocity2D(max(config.escape_speed_mps, -config.max_speed_mps), 0.0)
        cost = self._cost(command, start)
        pose = Pose2D(start.x, start.y, start.yaw)
        self._memory.record_escape(pose, may_begin=cost > kernels.NO_WAY)
        # The original checks an escape for a way, but not for obstacles.
        if cost >= 0.0 or (cost == kernels.TOUCHES and config.escape_through):
            self._command = command
            return Control(command, reason="escaping backwards")
        return Control(None, reason="no sample is allowed")


def _start(inputs: ControlInput) -> kernels.Start:
    """Return the robot's pose and measured velocity, with which rollouts begin."""
    return kernels.Start(*inputs.pose.numbers, *inputs.velocity.numbers)


def sample_velocities(
    config: DwaConfig,
    velocity: Velocity2D,
    end_distance_m: float,
    *,
    is_escaping: bool = False,
) -> tuple[Floats, int]:
    """Return unscored samples (n, COLUMNS), forward ones first, and how many those are.

    Args:
        config: Limits and numbers of samples.
        velocity: Velocity of the robot now.
        end_distance_m: Distance from the end of the visible plan. No sample is faster
            than to reach it within the time of a rollout.
        is_escaping: Whether driving forward is forbidden.
    """
    change = config.acceleration_mps2 * config.window_period_s
    # So that the robot does not shoot past the goal within one rollout.
    fastest = min(config.max_speed_mps, end_distance_m / config.sim_time_s)
    low = max(config.min_speed_mps, velocity.linear - change)
    high = max(min(fastest, velocity.linear + change), config.min_speed_mps)
    accumulate = config.single_precision
    speeds = kernels.even_values(low, high, config.speed_samples, accumulate)
    if is_escaping:
        speeds = speeds[:0]

    turn_change = config.turn_acceleration_radps2 * config.window_period_s
    low = max(-config.max_turn_radps, velocity.angular - turn_change)
    high = min(config.max_turn_radps, velocity.angular + turn_change)
    turns = kernels.even_values(low, high, config.turn_samples, accumulate)

    # In the original, straight ahead takes the place of the highest yaw rate.
    turns_ahead = turns if config.sample_highest_turn else turns[:-1]
    # The original tries no turn in place that is closer to zero than one step.
    fast = -1.0
    if config.skip_slow_turns:
        fast = (high - low) / (config.turn_samples - 1)
    slowest = config.min_turn_in_place_radps
    return kernels.sample_table(speeds, turns_ahead, turns, slowest, fast)


ENTRY = PlannerEntry(
    build=lambda config: NavigationPlanner(config, DwaController(config.dwa)),
    presets=read_presets("barn_planners", "presets/dwa.yaml", DwaPlannerConfig()),
    summary="dynamic window approach of the paper's trials",
    fit=fit_to_robot,
    compute=Compute(delay_s=0.0005),
)
