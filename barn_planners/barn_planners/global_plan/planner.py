"""The global plan, as in navfn.

A potential grows from the robot over the costmap; the plan follows it down from the
goal.
"""

import math
from dataclasses import dataclass

import numpy as np

from barn_planners.costmap.costmap import Costmap
from barn_planners.costmap.kernels import INSCRIBED, Grid
from barn_planners.global_plan import descent, kernels
from barn_worlds.base.arrays import Floats
from barn_worlds.base.config import Checked, optional, quantity
from barn_worlds.base.types import Pose2D, wrap_angle

_HIGHEST_PRICE = 253.0
_UNKNOWN = 255
# A potential grows per cell by at least this share of the neutral price; the update
# formula may fall short of the distance by the slack.
_LEAST_GROWTH = 0.97
_SLACK_CELLS = 16.0
_ALL_ROUNDS = 2**62


@dataclass(frozen=True)
class GlobalPlanConfig(Checked):
    """How a plan is made from the costs of a costmap."""

    neutral_cost: float = quantity(50.0, "price of a free cell", "", 1.0, 252.0)
    cost_factor: float = quantity(
        0.8, "increase of a cell's price per unit of its cost", "", 0.0, 10.0
    )
    step_cells: float = quantity(
        0.5, "length of a step down the gradient, in cells", "", 0.05, 1.0
    )
    bounded: bool = quantity(
        True, "skip cells that are too far from the path to matter, to save time"
    )
    as_navfn: bool = optional(
        False, "true: search and descent are navfn's, which may orbit (a quirk)"
    )
    unfinished_plans: bool = optional(
        False, "with as_navfn: accept a path that circles as a plan (a quirk)"
    )
    half_cell_offset: bool = quantity(
        True, "true: plans lead through cell centers; false: corners (a quirk)"
    )
    zero_intermediate_yaw: bool = quantity(
        False, "true: all poses but the goal have yaw 0 (a quirk)"
    )


@dataclass(frozen=True, slots=True)
class GlobalPlan:
    """A plan from the robot to the goal, or why there is none."""

    # (n, 3): x and y in m, yaw in rad.
    poses: Floats | None
    reason: str = ""


class GlobalPlanner:
    """Plans on a costmap.

    It returns its last plan again while nothing that the plan depends on has changed.
    """

    def __init__(self, config: GlobalPlanConfig):
        """Compute the prices of costs; the first plan allocates memory."""
        self.config = config
        self._dtype: type[np.floating] = np.float32 if config.as_navfn else np.float64
        # Digits of navfn's INVSQRT2.
        diagonal = 0.707106781 if config.as_navfn else math.sqrt(0.5)
        prices = cell_prices(config)
        self._prices = prices.astype(self._dtype)
        self._gains = (diagonal * prices).astype(self._dtype)
        self._task: tuple[Grid, tuple[int, int], Pose2D] | None = None
        self._shape = (0, 0)

    def plan(self, costmap: Costmap, start: Pose2D, goal: Pose2D) -> GlobalPlan:
        """Return a plan to the goal, or none and why; the last plan if nothing changed.

        Args:
            costmap: Global costmap.
            start: Pose of the robot in the frame of the costmap.
            goal: Goal in the same frame; the last pose of the plan is the goal exactly.
        """
        start_cell = costmap.world_to_cell(*start.position)
        if start_cell is None:
            return GlobalPlan(None, "the robot is off the global costmap")

        rows, cols = costmap.costs.shape
        row, col = costmap.world_to_cell(*goal.position) or (0, 0)
        # Plans do not lead into the outermost cells, which navfn blocks.
        if not (1 <= row < rows - 1 and 1 <= col < cols - 1):
            return GlobalPlan(None, "the goal is off the global costmap")

        # navfn plans within one cell, too; the result may orbit.
        is_there = start_cell == (row, col)
        if is_there and not self.config.as_navfn:
            return GlobalPlan(np.array([goal.numbers]))
        if not is_there and self._prices[costmap.costs[row, col]] == math.inf:
            return GlobalPlan(None, "the goal is inside an obstacle")

        if (rows, cols) != self._shape:
            self._allocate(rows, cols)
        terrain = kernels.Terrain(
            costmap.costs.ravel(), cols, self._prices, self._gains
        )
        # A robot that moves within its cell has the same plan.
        task = (costmap.grid, start_cell, goal)
        if task != self._task or not kernels.is_same(terrain, self._memory):
            ends = kernels.Ends(start_cell[0] * cols + start_cell[1], row * cols + col)
            self._plan = self._new_plan(terrain, ends, costmap.grid, goal)
            self._task = task
        return self._plan

    def _new_plan(
        self, terrain: kernels.Terrain, ends: kernels.Ends, grid: Grid, goal: Pose2D
    ) -> GlobalPlan:
        """Search and follow the potential anew; return the plan, or none and why."""
        config = self.config
        count = 0
        is_complete = False
        if kernels.search(terrain, ends, self._growth, config.bounded, self._memory):
            potential = self._memory.potentials[1]
            cols = terrain.columns
            if config.as_navfn:
                # navfn gives up after four points per column.
                points = self._points[: 4 * cols]
                count, is_complete = descent.descend_as_navfn(
                    potential, cols, ends, config.neutral_cost, points
                )
            else:
                count = descent.descend(
                    potential,
                    cols,
                    ends,
                    config.step_cells,
                    config.neutral_cost,
                    self._points,
                )
                is_complete = True

        if count == 0 or not (is_complete or config.unfinished_plans):
            return GlobalPlan(None, "no way to the goal")

        poses, steps = kernels.poses_along(
            self._points[:count].astype(np.float64, copy=False),
            grid,
            *goal.position,
            0.5 if config.half_cell_offset else 0.0,
        )
        if not config.zero_intermediate_yaw:
            poses[:-1, 2] = np.arctan2(steps[:, 1], steps[:, 0])
        poses[-1, 2] = goal.yaw
        return GlobalPlan(poses)

    def _allocate(self, rows: int, cols: int) -> None:
        """Allocate memory for a grid of rows x cols; the last plan no longer counts."""
        self._shape = (rows, cols)
        self._task = None
        self._memory = kernels.new_memory(rows, cols, self._dtype)
        steps = int(4 * (rows + cols) / self.config.step_cells)
        self._points = np.empty((steps, 2), self._dtype)
        # navfn stops after so many rounds, even if the goal is not reached.
        rounds = _ALL_ROUNDS
        if self.config.as_navfn:
            rounds = max(rows * cols // 20, rows + cols)
        neutral = self.config.neutral_cost
        self._growth = kernels.Growth(
            kernels.BLOCKED_PRICE,
            2.0 * neutral,
            rounds,
            neutral,
            _LEAST_GROWTH * neutral,
            _SLACK_CELLS * neutral,
        )


def cell_prices(config: GlobalPlanConfig) -> Floats:
    """Return the prices (256,) of entering a cell, indexed by its cost.

    Lethal and inscribed cells (254 and 253) have the price inf.
    """
    costs = np.arange(256, dtype=np.float64)
    prices = np.floor(config.neutral_cost + config.cost_factor * costs)
    prices = np.minimum(prices, _HIGHEST_PRICE)
    prices[INSCRIBED:] = math.inf
    # navfn may plan through unknown cells at the highest price.
    prices[_UNKNOWN] = _HIGHEST_PRICE
    return prices


def transform_plan(plan: Floats, target_from_source: Pose2D) -> Floats:
    """Return a copy of a plan (n, 3) in the target frame, yaws in [-pi, pi).

    Args:
        plan: Poses (n, 3) in the source frame, x and y in m, yaw in rad.
        target_from_source: Pose of the source frame in the target frame.
    """
    poses = np.empty_like(plan)
    poses[:, :2] = target_from_source.transform(plan[:, :2])
    poses[:, 2] = wrap_angle(plan[:, 2] + target_from_source.yaw)
    return poses
