"""The dynamic window approach (Fox, Burgard, Thrun 1997) as implemented in base_local_planner's TrajectoryPlanner.

Each cycle samples the velocities that can be reached within one control period, rolls them out and takes the cheapest.
The cost adds up distance from the plan, distance from its end, and the highest cost under the footprint's edges.
"""

import math

import numpy as np

from barn_planners.dwa import kernels, wavefront
from barn_planners.dwa.config import DwaConfig, DwaPlannerConfig
from barn_planners.dwa.kernels import Grid, Ground, Movement, Scene, Start, Weights
from barn_planners.dwa.memory import DwaMemory, GoalTurn
from barn_planners.dwa.search import Choice, find_best
from barn_planners.interface import FloatArray, PlannerView
from barn_planners.navigation.loop import (
    Control,
    ControlInput,
    Controller,
    NavigationPlanner,
)
from barn_planners.registry import PlannerEntry
from barn_planners.robots import fit_to_robot
from barn_worlds.base.compute import Compute
from barn_worlds.base.config import read_presets
from barn_worlds.base.types import Pose2D, Velocity2D

_COLUMNS = kernels.OBSTACLE + 1
_MAX_PLAN_CELLS = 4096
_SHOWN_POSES = 80
_FIGURES = {"cost": kernels.COST, "path_distance_cells": kernels.PATH}
_FIGURES |= {"goal_distance_cells": kernels.GOAL, "obstacle_cost": kernels.OBSTACLE}


class DwaController(Controller):
    """Follows a plan by the dynamic window approach."""

    def __init__(self, config: DwaConfig):
        self.config = config
        self._memory, self._goal_turn = DwaMemory(config), GoalTurn(config)
        steps = (config.sim_time_s, config.granularity_m, config.turn_granularity_rad)
        self._motion = Movement(
            *steps, config.acceleration_mps2, config.turn_acceleration_radps2
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
        self._unscored: tuple[Scene, Weights] | None = (
            None  # what `view` needs to score the whole table
        )

    def control(self, inputs: ControlInput) -> Control:
        """Choose a velocity; once the goal's position is reached, turn to its heading."""
        end = Pose2D(*inputs.visible[-1].tolist())
        if inputs.pose.distance(end) > self.config.xy_tolerance_m:
            return self._drive(inputs, end)
        if self.config.roll_out_goal_turn and not self._goal_turn.reached(inputs, end):
            self._drive(inputs, end)
        self._chosen = None
        return self._goal_turn.control(
            inputs, end, lambda command: self._has_room(inputs, command)
        )

    def view(self) -> PlannerView:
        """Return the chosen trajectory and all samples with their costs."""
        if self._start is None or not len(self._table):
            return PlannerView()
        if self._unscored is not None:
            scene, weights = self._unscored
            kernels.score(scene, self._start, self._motion, weights, self._table)
            self._unscored = None
        shown = kernels.traces(self._start, self._table, self._motion, _SHOWN_POSES)
        costs = np.where(
            self._table[:, kernels.COST] < 0.0, math.inf, self._table[:, kernels.COST]
        )
        if self._chosen is None:
            return PlannerView(candidates=shown[:, :, :2], candidate_costs=costs)
        chosen = kernels.traces(
            self._start, np.array([self._chosen]), self._motion, _SHOWN_POSES
        )[0]
        return PlannerView(
            local_plan=chosen, candidates=shown[:, :, :2], candidate_costs=costs
        )

    def _drive(self, inputs: ControlInput, end: Pose2D) -> Control:
        config, costmap, pose = self.config, inputs.costmap, inputs.pose
        start, self._chosen, self._unscored = _start(inputs), None, None
        if config.single_precision:
            start = Start(*np.array(start, np.float32).tolist())
            pose = Pose2D(start.x, start.y, start.yaw)
        self._start = start
        if self._fields is None or self._fields.shape != costmap.costs.shape:
            self._fields = _Fields(costmap.costs.shape)
        fastest = max(abs(start.speed), config.max_speed_mps, -config.escape_speed_mps)
        reach_m = fastest * config.sim_time_s + config.heading_lookahead_m
        scene = self._fields.scene(inputs, pose, reach_m, config.robot_blocks_goal)
        if scene is None:
            self._table = np.empty((0, _COLUMNS))
            return Control(None, reason="the plan lies off the local costmap")
        now = Velocity2D(start.speed, start.turn)
        self._table, drives = samples(
            config, now, pose.distance(end), escaping=self._memory.escaping
        )
        scale = costmap.resolution if config.distances_in_metres else 1.0
        weights = Weights(
            config.path_weight * scale,
            config.goal_weight * scale,
            config.obstacle_weight,
        )
        ahead, slots = (
            (config.heading_lookahead_m, config.turn_past_blocked),
            max(1, drives // config.speed_samples),
        )
        choice = Choice(
            drives, *self._memory.allowed_turns(), *ahead, self._likely, slots
        )
        best = find_best(scene, start, self._motion, weights, self._table, choice)
        self._unscored = (scene, weights)
        if best < 0:
            return self._escape(pose)
        self._likely, row = best, self._table[best].tolist()
        self._chosen = speed, turn = row[kernels.SPEED], row[kernels.TURN]
        self._memory.chose(pose, speed, turn)
        return Control(
            Velocity2D(speed, turn),
            diagnostics={name: row[column] for name, column in _FIGURES.items()},
        )

    def _cost(self, start: Start, command: Velocity2D) -> float:
        """Return the cost of a sample in this cycle's scene."""
        assert self._unscored is not None
        (scene, weights), table = self._unscored, np.zeros((1, _COLUMNS))
        table[0, [kernels.SPEED, kernels.TURN]] = command.linear, command.angular
        kernels.score(scene, start, self._motion, weights, table)
        return float(table[0, kernels.COST])

    def _has_room(self, inputs: ControlInput, command: Velocity2D) -> bool:
        if self.config.roll_out_goal_turn:
            return (
                self._unscored is not None
                and self._cost(_start(inputs), command) >= 0.0
            )
        return inputs.costmap.has_room(inputs.pose.x, inputs.pose.y, inputs.pose.yaw)

    def _escape(self, pose: Pose2D) -> Control:
        """Drive backwards because no sample is allowed, unless the goal cannot be reached at all."""
        assert self._start is not None
        back = Velocity2D(
            max(self.config.escape_speed_mps, -self.config.max_speed_mps), 0.0
        )
        cost = self._cost(self._start, back)
        self._memory.escapes(pose, begin=cost > kernels.NO_WAY)
        if cost >= 0.0 or (cost == kernels.TOUCHES and self.config.escape_through):
            self._chosen = (back.linear, back.angular)
            return Control(back, reason="escaping backwards")
        return Control(None, reason="no sample is allowed")


class _Fields:
    """The costs of a cycle, which the costmap changes later, and the distances to the plan and to its end."""

    def __init__(self, shape: tuple[int, ...]):
        rows, cols = self.shape = shape
        self._path, self._goal = (
            wavefront.new_wavefront(rows, cols),
            wavefront.new_wavefront(rows, cols),
        )
        self._costs, self._clear = np.empty(shape, np.uint8), np.empty(shape, np.int16)
        # cells that block, and those of the plan
        work = (
            np.empty((rows + 2) * (cols + 2), np.uint8),
            np.empty(_MAX_PLAN_CELLS, np.int64),
        )
        self._all = (self._costs, self._clear, *work, self._path, self._goal)

    def scene(
        self,
        inputs: ControlInput,
        pose: Pose2D,
        reach_m: float,
        robot_blocks_goal: bool,
    ) -> Scene | None:
        """Return the scene of a cycle, None if the plan lies off the costmap; reach_m: how far rollouts may lead."""
        costmap = inputs.costmap
        at = (inputs.visible, costmap.grid, (pose.x, pose.y, pose.yaw), costmap.outline)
        if not kernels.prepare(
            costmap.costs, self._all, *at, reach_m, robot_blocks_goal
        ):
            return None
        grid = Grid(costmap.origin_x, costmap.origin_y, 1.0 / costmap.resolution)
        return Scene(
            Ground(self._costs, self._clear, grid, costmap.outline),
            self._path,
            self._goal,
        )


def _start(inputs: ControlInput) -> Start:
    pose, velocity = inputs.pose, inputs.velocity
    return Start(pose.x, pose.y, pose.yaw, velocity.linear, velocity.angular)


def samples(
    config: DwaConfig,
    velocity: Velocity2D,
    end_distance_m: float,
    *,
    escaping: bool = False,
) -> tuple[FloatArray, int]:
    """Return the table of samples, unscored, and how many drive forward; the others turn in place.

    None drives faster than to the end of the visible plan, and none forward while the robot escapes.
    """
    change = config.acceleration_mps2 * config.window_period_s
    turn_change = config.turn_acceleration_radps2 * config.window_period_s
    fastest = min(config.max_speed_mps, end_distance_m / config.sim_time_s)
    high = max(min(fastest, velocity.linear + change), config.min_speed_mps)
    low = max(config.min_speed_mps, velocity.linear - change)
    lowest = max(-config.max_turn_radps, velocity.angular - turn_change)
    highest = min(config.max_turn_radps, velocity.angular + turn_change)
    counts = (0 if escaping else config.speed_samples, config.turn_samples)
    shape = (
        config.sample_highest_turn,
        config.min_turn_in_place_radps,
        config.skip_slow_turns,
    )
    table, drives = kernels.sample_table(
        (low, high), (lowest, highest), counts, *shape, config.single_precision
    )
    return table, drives


ENTRY = PlannerEntry(
    lambda config: NavigationPlanner(config, DwaController(config.dwa)),
    read_presets("barn_planners", "presets/dwa.yaml", DwaPlannerConfig()),
    "dynamic window approach of the paper's trials",
    fit_to_robot,
    compute=Compute(delay_s=0.0005),
)
