"""The global plan, as in navfn: a potential grown from the robot over the costmap and followed down from the goal."""

import math
from dataclasses import dataclass
from typing import Any

import numpy as np
import numpy.typing as npt

from barn_planners.costmap.costmap import Costmap
from barn_planners.costmap.kernels import INSCRIBED
from barn_planners.global_plan import descent, kernels
from barn_planners.interface import FloatArray
from barn_worlds.base.config import Checked, quantity
from barn_worlds.base.types import Pose2D

_HIGHEST_PRICE = 253.0
_BLOCKED_PRICE = _HIGHEST_PRICE + 1.0
# A potential grows per cell by at least this share of the neutral price; the update formula may fall short of the
# distance by the rest.
_LEAST_GROWTH = 0.97
_SLACK_CELLS = 16.0
_ALL_ROUNDS = 2**62
_NO_WAY = "no way to the goal"


@dataclass(frozen=True)
class GlobalPlanConfig(Checked):
    """How a plan is made from the costs of a costmap."""

    neutral_cost: float = quantity(50.0, "price of a free cell", "", 1.0, 252.0)
    cost_factor: float = quantity(
        0.8, "added to the price of a cell per unit of its cost", "", 0.0, 10.0
    )
    step_cells: float = quantity(
        0.5, "length of a step down the gradient, in cells", "", 0.05, 1.0
    )
    bounded: bool = quantity(True, "skip cells too far from the way to matter; faster")
    as_navfn: bool = quantity(
        False,
        "true: search and descent are navfn's, which may orbit (a quirk)",
        optional=True,
    )
    unfinished_plans: bool = quantity(
        False, "with as_navfn: a path that orbits is a plan (a quirk)", optional=True
    )
    half_cell_offset: bool = quantity(
        True, "true: plans lead through cell centres; false: corners (a quirk)"
    )
    zero_intermediate_yaw: bool = quantity(
        False, "true: all poses but the goal have yaw 0 (a quirk)"
    )


@dataclass(frozen=True, slots=True)
class GlobalPlan:
    """A plan: poses (n, 3) x, y m, yaw rad from robot to goal, or None with the reason."""

    poses: FloatArray | None
    reason: str = ""


class GlobalPlanner:
    """Plans on a costmap; keeps its last plan, and uses it again while nothing that it came from has changed."""

    def __init__(self, config: GlobalPlanConfig):
        self.config = config
        self._kind: type[np.floating] = np.float32 if config.as_navfn else np.float64
        self._price = cell_prices(config).astype(self._kind)
        self._gain = (
            (0.707106781 if config.as_navfn else math.sqrt(0.5)) * cell_prices(config)
        ).astype(self._kind)
        self._task: tuple[Any, ...] | None = None
        self._fit((1, 1))

    def plan(self, costmap: Costmap, start: Pose2D, goal: Pose2D) -> GlobalPlan:
        """Plan from start to goal, both in the frame of the costmap; the last pose is the goal exactly."""
        start_cell, goal_cell = (
            costmap.world_to_cell(start.x, start.y),
            _inner_cell(goal, costmap),
        )
        if start_cell is None:
            return GlobalPlan(None, "the robot is off the global costmap")
        if goal_cell is None:
            return GlobalPlan(None, "the goal is off the global costmap")
        if start_cell == goal_cell and not self.config.as_navfn:
            return GlobalPlan(np.array([[goal.x, goal.y, goal.yaw]]))
        if (
            self._price[costmap.costs[goal_cell]] == math.inf
            and start_cell != goal_cell
        ):
            return GlobalPlan(None, "the goal is inside an obstacle")
        if costmap.costs.shape != self._shape:
            self._fit(costmap.costs.shape)
        task = (costmap.grid, start_cell, goal)
        grid = (costmap.costs.ravel(), costmap.costs.shape[1], self._price)
        if task != self._task or not kernels.is_same(
            *grid, self._potentials, self._seen, self._windows
        ):
            self._last = self._new(costmap, grid, start_cell, goal_cell, goal)
            self._task = task
        return self._last

    def _new(
        self,
        costmap: Costmap,
        grid: tuple[Any, ...],
        start: tuple[int, int],
        goal: tuple[int, int],
        goal_pose: Pose2D,
    ) -> GlobalPlan:
        costs, cols, price = grid
        ends = (start[0] * cols + start[1], goal[0] * cols + goal[1])
        config, whole = self.config, self._potentials[1]
        work = (
            self._potentials,
            self._pending,
            self._queues,
            self._seen,
            self._windows,
        )
        n, arrived = 0, False
        if kernels.search(
            costs,
            cols,
            (price, self._gain),
            ends,
            config.bounded,
            config.neutral_cost,
            self._limits,
            work,
        ):
            neutral, points = config.neutral_cost, self._points
            if config.as_navfn:
                n, arrived = descent.descend_as_navfn(
                    whole, cols, *ends, neutral, _BLOCKED_PRICE, points[: 4 * cols]
                )
            else:
                n = descent.descend(
                    whole,
                    cols,
                    *ends,
                    config.step_cells,
                    neutral,
                    _BLOCKED_PRICE,
                    points,
                )
                arrived = n > 0
        if n == 0 or not (arrived or config.unfinished_plans):
            return GlobalPlan(None, _NO_WAY)
        return GlobalPlan(self._poses(costmap, self._points[:n], goal_pose))

    def _fit(self, shape: tuple[int, ...]) -> None:
        rows, cols = self._shape = shape
        self._task = None
        neutral = self.config.neutral_cost
        rounds = (
            max(rows * cols // 20, rows + cols) if self.config.as_navfn else _ALL_ROUNDS
        )
        growth = (_BLOCKED_PRICE, 2.0 * neutral, rounds)
        self._limits = (*growth, _LEAST_GROWTH * neutral, _SLACK_CELLS * neutral)
        self._potentials = np.full((2, rows * cols), kernels.UNREACHED, self._kind)
        border = np.ones((rows, cols), np.uint8)
        border[1:-1, 1:-1] = 0
        self._pending = border.ravel()
        self._queues = np.empty((3, rows * cols), np.int32)
        self._seen = np.empty(rows * cols, np.uint8)
        self._windows = np.array([kernels.NOWHERE] * 2, np.int64)
        self._points = np.empty(
            (int(4 * (rows + cols) / self.config.step_cells), 2), self._kind
        )

    def _poses(
        self, costmap: Costmap, cells: npt.NDArray[np.floating], goal: Pose2D
    ) -> FloatArray:
        frame = (*costmap.grid, goal.x, goal.y)
        poses: FloatArray
        poses, steps = kernels.poses_along(
            cells.astype(np.float64, copy=False),
            frame,
            0.5 if self.config.half_cell_offset else 0.0,
        )
        if not self.config.zero_intermediate_yaw:
            poses[:-1, 2] = np.arctan2(steps[1], steps[0])
        poses[-1, 2] = goal.yaw
        return poses


def cell_prices(config: GlobalPlanConfig) -> npt.NDArray[np.float64]:
    """Return the price of entering a cell by its costmap value, (256,); inf where blocked."""
    costs = np.arange(256, dtype=np.float64)
    prices = np.minimum(
        np.floor(config.neutral_cost + config.cost_factor * costs), _HIGHEST_PRICE
    )
    prices[INSCRIBED:] = math.inf
    prices[255] = _HIGHEST_PRICE
    return prices


def _inner_cell(pose: Pose2D, costmap: Costmap) -> tuple[int, int] | None:
    cell, (rows, cols) = costmap.world_to_cell(pose.x, pose.y), costmap.costs.shape
    return (
        cell if cell and 1 <= cell[0] < rows - 1 and 1 <= cell[1] < cols - 1 else None
    )


def transform_plan(plan: FloatArray, frame: Pose2D) -> FloatArray:
    """Return a plan (n, 3), which is relative to `frame`, in the frame that `frame` is given in."""
    moved = np.empty_like(plan)
    moved[:, :2] = frame.transform(plan[:, :2])
    moved[:, 2] = (plan[:, 2] + frame.yaw + np.pi) % (2.0 * np.pi) - np.pi
    return moved


def visible_slice(plan: FloatArray, pose: Pose2D, radius_m: float) -> slice:
    """Return the part of a plan (n, 2 or more) that is within the radius of the pose, up to where it leaves it."""
    first, end = kernels.visible_points(plan, pose.x, pose.y, radius_m)
    return slice(first, end)


def count_passed_points(plan: FloatArray, pose: Pose2D, keep_m: float) -> int:
    """Return the number of points before the first one nearer than `keep_m` to the pose; all if there is none."""
    passed: int = kernels.count_passed_points(plan, pose.x, pose.y, keep_m)
    return passed
