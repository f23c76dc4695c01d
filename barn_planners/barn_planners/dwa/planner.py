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
_FIGURES = ("cost", "path_distance_cells", "goal_distance_cells", "obstacle_cost")


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
        end = Pose2D(*(float(value) for value in inputs.visible[-1]))
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
        drives = forward_samples(self.config, inputs.velocity, pose.distance(end))
        turns = turn_samples(self.config, inputs.velocity)
        if self._memory.escaping:
            drives = drives[:0]
        self._table = np.zeros((len(drives) + len(turns), _COLUMNS))
        self._table[: len(drives), :2] = drives
        self._table[len(drives) :, kernels.TURN] = turns
        weights = self._weights(costmap.resolution)
        slots = max(1, len(drives) // self.config.speed_samples)
        ahead = (self.config.heading_lookahead_m, self.config.turn_past_blocked)
        choice = Choice(len(drives), *self._memory.allowed_turns(), *ahead, self._likely, slots)
        best = find_best(scene, start, self._motion, weights, self._table, choice)
        self._unscored = (scene, weights)
        if best < 0:
            return self._escape(scene, start, weights, pose)
        self._likely = best
        row = self._table[best]
        speed, turn = float(row[kernels.SPEED]), float(row[kernels.TURN])
        self._memory.chose(pose, speed, turn)
        self._chosen = (speed, turn)
        columns = (kernels.COST, kernels.PATH, kernels.GOAL, kernels.OBSTACLE)
        figures = dict(zip(_FIGURES, row[list(columns)].tolist(), strict=True))
        return Control(Velocity2D(speed, turn), diagnostics=figures)

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
        self._path = wavefront.new_wavefront(rows, cols)
        self._goal = wavefront.new_wavefront(rows, cols)
        self._costs = np.empty(shape, np.uint8)
        self._clear = np.empty(shape, np.int16)
        self._blocked = np.empty((rows + 2) * (cols + 2), np.uint8)
        self._seeds = np.empty(_MAX_PLAN_CELLS, np.int64)

    def scene(self, inputs: ControlInput, reach_m: float, robot_blocks_goal: bool) -> Scene | None:
        """Return the scene of a cycle, None if the plan lies off the costmap; reach_m: how far rollouts may lead."""
        costmap, pose, seeds = inputs.costmap, inputs.pose, self._seeds
        rows, cols = costmap.costs.shape
        count = wavefront.plan_cells(inputs.visible, *costmap.grid, rows, cols, seeds)
        if count == 0:
            return None
        self._costs[:] = costmap.costs
        low, high = costmap.cell(pose.x - reach_m, pose.y - reach_m), costmap.cell(pose.x + reach_m, pose.y + reach_m)
        window = (low[0] - 1, high[0] + 2, low[1] - 1, high[1] + 2)
        kernels.open_around(costmap.costs, window, self._clear)
        first, spans = costmap.footprint_spans(pose)
        wavefront.blocked(costmap.costs, first, spans, self._blocked)
        wavefront.begin(*self._path[:4], self._blocked, seeds[:count])
        if robot_blocks_goal:
            wavefront.blocked(costmap.costs, first, spans[:0], self._blocked)
        wavefront.begin(*self._goal[:4], self._blocked, seeds[count - 1 : count])
        grid = Grid(costmap.origin_x, costmap.origin_y, 1.0 / costmap.resolution)
        return Scene(Ground(self._costs, self._clear, grid, costmap.outline), self._path, self._goal)


def _single_precision(inputs: ControlInput) -> ControlInput:
    x, y, yaw, linear, angular = (
        float(np.float32(value))
        for value in (inputs.pose.x, inputs.pose.y, inputs.pose.yaw, inputs.velocity.linear, inputs.velocity.angular)
    )
    return replace(inputs, pose=Pose2D(x, y, yaw), velocity=Velocity2D(linear, angular))


def forward_samples(config: DwaConfig, velocity: Velocity2D, end_distance_m: float) -> FloatArray:
    """Return the samples (n, 2) of speed and turn that drive forward, no faster than to the end of the visible plan."""
    change = config.acceleration_mps2 * config.window_period_s
    fastest = min(config.max_speed_mps, end_distance_m / config.sim_time_s)
    high = max(min(fastest, velocity.linear + change), config.min_speed_mps)
    low = max(config.min_speed_mps, velocity.linear - change)
    shape = (config.speed_samples, config.turn_samples, config.sample_highest_turn, config.single_precision)
    samples: FloatArray = kernels.forward_samples(low, high, *_turn_window(config, velocity), *shape)
    return samples


def turn_samples(config: DwaConfig, velocity: Velocity2D) -> FloatArray:
    """Return the sampled turn rates in place (n,), none slower than the slowest allowed."""
    shape = (config.turn_samples, config.min_turn_in_place_radps, config.skip_slow_turns, config.single_precision)
    turns: FloatArray = kernels.turn_samples(*_turn_window(config, velocity), *shape)
    return turns


def _turn_window(config: DwaConfig, velocity: Velocity2D) -> tuple[float, float]:
    change = config.turn_acceleration_radps2 * config.window_period_s
    low = max(-config.max_turn_radps, velocity.angular - change)
    return low, min(config.max_turn_radps, velocity.angular + change)


ENTRY = PlannerEntry(
    lambda config: NavigationPlanner(config, DwaController(config.dwa)),
    dwa_presets(),
    "dynamic window approach of the paper's trials",
    fitted,
)
