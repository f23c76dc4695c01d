"""The dynamic window approach (Fox, Burgard, Thrun 1997) as implemented in base_local_planner's TrajectoryPlanner.

Each cycle samples the velocities that can be reached within one control period, rolls them out and takes the cheapest.
The cost adds up distance from the plan, distance from its end, and the highest cost under the footprint's edges.
"""

from __future__ import annotations

import math
from dataclasses import replace

import numpy as np

from barn_planners.dwa import kernels, wavefront
from barn_planners.dwa.config import DwaConfig, dwa_presets
from barn_planners.dwa.kernels import Grid, Ground, Movement, Scene, Start, Weights
from barn_planners.dwa.memory import DwaMemory, GoalTurn
from barn_planners.dwa.search import Choice, find_best
from barn_planners.interface import FloatArray, PlannerView
from barn_planners.navigation.loop import Control, ControlInput, Controller, NavigationPlanner
from barn_planners.registry import PlannerEntry
from barn_planners.robots import fitted
from barn_worlds.base.types import Pose2D, Velocity2D

_COLUMNS = kernels.OBSTACLE + 1
_MAX_PLAN_CELLS = 4096
_FIGURES = {
    "cost": kernels.COST,
    "path_distance_cells": kernels.PATH,
    "goal_distance_cells": kernels.GOAL,
    "obstacle_cost": kernels.OBSTACLE,
}


class DwaController(Controller):
    """Follows a plan by the dynamic window approach."""

    def __init__(self, config: DwaConfig):
        self.config = config
        self._memory = DwaMemory(config)
        self._goal_turn = GoalTurn(config)
        self._motion = Movement(
            config.sim_time_s,
            config.granularity_m,
            config.turn_granularity_rad,
            config.acceleration_mps2,
            config.turn_acceleration_radps2,
        )
        self._fields: _Fields | None = None
        self.reset(0)

    def reset(self, seed: int) -> None:
        """Forget the last trial; nothing is random here."""
        del seed
        self._memory.reset()
        self._goal_turn.reset()
        self._table = np.empty((0, _COLUMNS))
        self._start: Start | None = None
        self._chosen: tuple[float, float] | None = None
        self._likely = 0
        self._unscored: tuple[Scene, Weights] | None = None  # what `view` needs to score the whole table

    def control(self, inputs: ControlInput) -> Control:
        """Choose a velocity; once the goal's position is reached, turn to its heading."""
        end = Pose2D(*inputs.visible[-1].tolist())
        if inputs.pose.distance(end) <= self.config.xy_tolerance_m:
            if self.config.roll_out_goal_turn and not self._goal_turn.reached(inputs, end):
                self._drive(inputs, end)
            self._chosen = None
            return self._goal_turn.control(inputs, end, lambda command: self._has_room(inputs, command))
        return self._drive(inputs, end)

    def view(self) -> PlannerView:
        """Return the chosen trajectory and all samples with their costs."""
        if self._start is None or not len(self._table):
            return PlannerView()
        if self._unscored is not None:
            scene, weights = self._unscored
            kernels.score(scene, self._start, self._motion, weights, self._table)
            self._unscored = None
        candidates = np.empty((len(self._table), 80, 3))
        for row, points in zip(self._table, candidates, strict=True):
            kernels.trace(self._start, row[kernels.SPEED], row[kernels.TURN], self._motion, points)
        costs = self._table[:, kernels.COST].copy()
        costs[costs < 0.0] = math.inf
        local_plan = None
        if self._chosen is not None:
            local_plan = np.empty((80, 3))
            kernels.trace(self._start, *self._chosen, self._motion, local_plan)
        return PlannerView(local_plan=local_plan, candidates=candidates[:, :, :2], candidate_costs=costs)

    def _drive(self, inputs: ControlInput, end: Pose2D) -> Control:
        if self.config.single_precision:
            inputs = _single_precision(inputs)
        costmap, pose = inputs.costmap, inputs.pose
        start = self._start = Start(pose.x, pose.y, pose.yaw, inputs.velocity.linear, inputs.velocity.angular)
        self._chosen = self._unscored = None
        if self._fields is None or self._fields.shape != costmap.costs.shape:
            self._fields = _Fields(costmap.costs.shape)
        scene = self._fields.scene(inputs, self._reach(inputs.velocity), self.config.robot_blocks_goal)
        if scene is None:
            self._table = np.empty((0, _COLUMNS))
            return Control(None, reason="the plan lies off the local costmap")
        self._table, drives = samples(self.config, inputs.velocity, pose.distance(end), escaping=self._memory.escaping)
        weights = self._weights(costmap.resolution)
        slots = max(1, drives // self.config.speed_samples)
        ahead = (self.config.heading_lookahead_m, self.config.turn_past_blocked)
        choice = Choice(drives, *self._memory.allowed_turns(), *ahead, self._likely, slots)
        best = find_best(scene, start, self._motion, weights, self._table, choice)
        self._unscored = (scene, weights)
        if best < 0:
            return self._escape(scene, start, weights, pose)
        self._likely = best
        row = self._table[best].tolist()
        speed, turn = row[kernels.SPEED], row[kernels.TURN]
        self._memory.chose(pose, speed, turn)
        self._chosen = (speed, turn)
        return Control(Velocity2D(speed, turn), diagnostics={name: row[column] for name, column in _FIGURES.items()})

    def _has_room(self, inputs: ControlInput, command: Velocity2D) -> bool:
        pose, velocity = inputs.pose, inputs.velocity
        if not self.config.roll_out_goal_turn:
            return inputs.costmap.has_room(pose.x, pose.y, pose.yaw)
        if self._unscored is None:
            return False
        (scene, weights), row = self._unscored, np.zeros(_COLUMNS)
        row[kernels.SPEED], row[kernels.TURN] = command.linear, command.angular
        start = Start(pose.x, pose.y, pose.yaw, velocity.linear, velocity.angular)
        kernels.rollout(scene, start, self._motion, weights, row)
        return bool(row[kernels.COST] >= 0.0)

    def _escape(self, scene: Scene, start: Start, weights: Weights, pose: Pose2D) -> Control:
        """Drive backwards because no sample is allowed, unless the goal cannot be reached at all."""
        row = np.zeros(_COLUMNS)
        row[kernels.SPEED] = self.config.escape_speed_mps
        kernels.rollout(scene, start, self._motion, weights, row)
        cost = row[kernels.COST]
        self._memory.escapes(pose, begin=bool(cost > kernels.NO_WAY))
        if cost >= 0.0 or (cost == kernels.TOUCHES and self.config.escape_through):
            self._chosen = (self.config.escape_speed_mps, 0.0)
            return Control(Velocity2D(self.config.escape_speed_mps, 0.0), reason="escaping backwards")
        return Control(None, reason="no sample is allowed")

    def _reach(self, velocity: Velocity2D) -> float:
        fastest = max(abs(velocity.linear), self.config.max_speed_mps, -self.config.escape_speed_mps)
        return fastest * self.config.sim_time_s + self.config.heading_lookahead_m

    def _weights(self, resolution: float) -> Weights:
        scale = resolution if self.config.distances_in_metres else 1.0
        return Weights(self.config.path_weight * scale, self.config.goal_weight * scale, self.config.obstacle_weight)


class _Fields:
    """The costs of a cycle, which the costmap changes later, and the distances to the plan and to its end."""

    def __init__(self, shape: tuple[int, ...]):
        rows, cols = shape
        self.shape = shape
        self._path, self._goal = wavefront.new_wavefront(rows, cols), wavefront.new_wavefront(rows, cols)
        self._costs, self._clear = np.empty(shape, np.uint8), np.empty(shape, np.int16)
        work = np.empty((rows + 2) * (cols + 2), np.uint8), np.empty(_MAX_PLAN_CELLS, np.int64)
        self._all = (self._costs, self._clear, *work, self._path, self._goal)

    def scene(self, inputs: ControlInput, reach_m: float, robot_blocks_goal: bool) -> Scene | None:
        """Return the scene of a cycle, None if the plan lies off the costmap; reach_m: how far rollouts may lead."""
        costmap, pose = inputs.costmap, inputs.pose
        at = (inputs.visible, costmap.grid, (pose.x, pose.y, pose.yaw), costmap.outline)
        if not kernels.prepare(costmap.costs, self._all, *at, reach_m, robot_blocks_goal):
            return None
        grid = Grid(costmap.origin_x, costmap.origin_y, 1.0 / costmap.resolution)
        return Scene(Ground(self._costs, self._clear, grid, costmap.outline), self._path, self._goal)


def _single_precision(inputs: ControlInput) -> ControlInput:
    x, y, yaw, linear, angular = (
        float(np.float32(value))
        for value in (inputs.pose.x, inputs.pose.y, inputs.pose.yaw, inputs.velocity.linear, inputs.velocity.angular)
    )
    return replace(inputs, pose=Pose2D(x, y, yaw), velocity=Velocity2D(linear, angular))


def samples(
    config: DwaConfig, velocity: Velocity2D, end_distance_m: float, *, escaping: bool = False
) -> tuple[FloatArray, int]:
    """Return the table of samples, unscored, and how many drive forward; the others turn in place.

    None drives faster than to the end of the visible plan, and none forward while the robot escapes.
    """
    change, turn_change = (
        rate * config.window_period_s for rate in (config.acceleration_mps2, config.turn_acceleration_radps2)
    )
    fastest = min(config.max_speed_mps, end_distance_m / config.sim_time_s)
    high = max(min(fastest, velocity.linear + change), config.min_speed_mps)
    low = max(config.min_speed_mps, velocity.linear - change)
    lowest = max(-config.max_turn_radps, velocity.angular - turn_change)
    highest = min(config.max_turn_radps, velocity.angular + turn_change)
    counts = (0 if escaping else config.speed_samples, config.turn_samples)
    shape = (config.sample_highest_turn, config.min_turn_in_place_radps, config.skip_slow_turns)
    table, drives = kernels.sample_table((low, high), (lowest, highest), counts, *shape, config.single_precision)
    return table, drives


ENTRY = PlannerEntry(
    lambda config: NavigationPlanner(config, DwaController(config.dwa)),
    dwa_presets(),
    "dynamic window approach of the paper's trials",
    fitted,
)
