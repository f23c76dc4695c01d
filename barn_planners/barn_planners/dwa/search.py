"""The compiled search for the best velocity sample, without scoring every sample.

A sample's end is computed first, and its footprints are checked only as long as it can still be the best.
"""

import math
from typing import NamedTuple

import numpy as np
import numpy.typing as npt
from numba import njit

from barn_planners.dwa import kernels
from barn_planners.dwa.wavefront import (
    REACHED,
    UNREACHED,
    borders_reached,
    least_beyond,
    steps_to,
)

_COARSE = 6  # poses between two of those that are checked first
_ROUNDING_CELLS = 1.0e-4  # far more than places are off by roundings
_STRAIGHT_RAD = 1.0e-9


class Choice(NamedTuple):
    """How samples are chosen from; the first `drives` rows drive forward, the others turn in place.

    left, right: whether turning in place to that side is allowed. lookahead_m: how far ahead of its end a turn in place
    must see the goal nearer than those before; past_blocked: also where no way leads. likely: a row to begin with; that
    of the last cycle rules out most others. slots: rows so far apart have the same turn, whose headings are computed
    once.
    """

    drives: int
    left: bool
    right: bool
    lookahead_m: float
    past_blocked: bool
    likely: int
    slots: int


class _Work(NamedTuple):
    """What all samples share: yaw, cosine and sine (slots, poses, 3), their turn and steps; `edges_cost` at first."""

    headings: npt.NDArray[np.float64]
    heading_of: npt.NDArray[np.float64]
    places: npt.NDArray[np.float64]  # (poses, 2)
    corners: npt.NDArray[np.int64]
    first_corners: npt.NDArray[np.int64]
    highest: int
    reach: int  # of the outline in cells; where it is this open around the robot, its edges meet no cost


@njit(cache=True)
def find_best(scene, start, motion, weights, table, choice):  # type: ignore[no-untyped-def]
    """Return the row of the best sample of a table, -1 if none is allowed; its row is filled as by `score`.

    The first of the cheapest rows that drive forward wins. A turn in place wins over it if it costs no more, its
    direction is allowed, and the goal is nearer ahead of its end than for any turn accepted before.
    """
    table[:, kernels.COST] = kernels.TOUCHES
    costs, clear, grid, outline = scene.ground
    corners, cos_yaw, sin_yaw = (
        np.full(len(outline), -1),
        math.cos(start.yaw),
        math.sin(start.yaw),
    )
    highest = kernels.edges_cost(
        costs, clear, grid, outline, start.x, start.y, cos_yaw, sin_yaw, corners, 0
    )
    if highest < 0:
        return -1
    cell = kernels.row_col(grid, start.x, start.y)
    if (
        kernels.steps_at(scene.path, *cell) >= UNREACHED
        or kernels.steps_at(scene.goal, *cell) >= UNREACHED
    ):
        return -1
    most, reach = 1, 0.0
    for k in range(len(outline)):
        reach = max(reach, math.hypot(outline[k, 0], outline[k, 1]))
    for k in range(len(table)):
        most = max(
            most,
            kernels.step_count(table[k, kernels.SPEED], table[k, kernels.TURN], motion),
        )
    headings, heading_of = (
        np.empty((choice.slots, most + 1, 3)),
        np.zeros((choice.slots, 2)),
    )
    cells = math.ceil(reach * grid.per_m)
    work = _Work(
        headings,
        heading_of,
        np.empty((most, 2)),
        corners.copy(),
        corners,
        highest,
        cells,
    )
    best, best_cost = _best_drive(scene, start, motion, weights, table, choice, work)
    best, best_cost = _best_turn(
        scene, start, motion, weights, table, choice, work, best, best_cost
    )
    if best >= 0:
        table[best, kernels.COST] = best_cost
    return best


@njit(cache=True)
def _best_drive(scene, start, motion, weights, table, choice, work):  # type: ignore[no-untyped-def]
    """Return the best row that drives forward and its cost."""
    best, best_cost = -1, math.inf
    for n in range(-1, choice.drives):
        k = choice.likely if n < 0 else n
        if k >= choice.drives or n == choice.likely:
            continue
        if (
            best >= 0
            and _least(scene, start, motion, weights, table[k], work.highest)
            > best_cost
        ):
            continue
        # of equal costs the first row wins
        cost = _cost(
            scene, start, motion, weights, table[k], best_cost, work, k % choice.slots
        )
        if cost >= 0.0 and (cost < best_cost or (cost == best_cost and k < best)):
            best, best_cost = k, cost
    return best, best_cost


@njit(cache=True)
def _best_turn(scene, start, motion, weights, table, choice, work, best, best_cost):  # type: ignore[no-untyped-def]
    ahead_best = math.inf
    for k in range(choice.drives, len(table)):
        row, slot = table[k], k % choice.slots
        if not (choice.left if row[kernels.TURN] > 0.0 else choice.right):
            continue
        if _least(scene, start, motion, weights, row, work.highest) > best_cost:
            continue
        cost = _cost(scene, start, motion, weights, row, best_cost, work, slot)
        if cost < 0.0 or cost > best_cost:
            continue
        ahead = _goal_ahead(scene, row, choice.lookahead_m, choice.past_blocked)
        if ahead < ahead_best:
            best, best_cost, ahead_best = k, cost, ahead
    return best, best_cost


@njit(cache=True)
def _goal_ahead(scene, row, lookahead, past_blocked):  # type: ignore[no-untyped-def]
    """Return the goal distance ahead of a sample's end, inf off the grid and where no way leads (but: past_blocked)."""
    x = row[kernels.END_X] + lookahead * math.cos(row[kernels.END_YAW])
    y = row[kernels.END_Y] + lookahead * math.sin(row[kernels.END_YAW])
    (rows, cols), (grid_row, grid_col) = (
        scene.ground.costs.shape,
        kernels.row_col(scene.ground.grid, x, y),
    )
    if grid_row < 0 or grid_row >= rows or grid_col < 0 or grid_col >= cols:
        return math.inf
    steps = kernels.steps_at(scene.goal, grid_row, grid_col)
    if steps < UNREACHED:
        return float(steps)
    if not past_blocked:
        return math.inf
    borders = borders_reached(
        scene.goal, (grid_row + 1) * scene.goal.columns + grid_col + 1
    )
    return float(UNREACHED) if borders else float(UNREACHED) + 1.0


@njit(cache=True)
def _cost(scene, start, motion, weights, row, limit, work, slot):  # type: ignore[no-untyped-def]
    """Fill a row as `score` does, but for the cost, and return that; -1 if not allowed or above the limit."""
    rows, cols = scene.ground.costs.shape
    steps = kernels.step_count(row[kernels.SPEED], row[kernels.TURN], motion)
    headings, heading_of, places = (
        work.headings[slot],
        work.heading_of[slot],
        work.places,
    )
    if heading_of[0] != row[kernels.TURN] or heading_of[1] != steps:
        heading_of[0], heading_of[1] = row[kernels.TURN], steps
        kernels.turn_along(start, row[kernels.TURN], steps, motion, headings)
    kernels.drive_along(start, row[kernels.SPEED], steps, motion, headings, places)
    end_row, end_col = kernels.row_col(
        scene.ground.grid, places[steps - 1, 0], places[steps - 1, 1]
    )
    if end_row < 0 or end_row >= rows or end_col < 0 or end_col >= cols:
        return -1.0
    to_path, to_goal = (
        kernels.steps_at(scene.path, end_row, end_col),
        kernels.steps_at(scene.goal, end_row, end_col),
    )
    if to_path >= UNREACHED or to_goal >= UNREACHED:
        return -1.0
    at_end = weights.path * to_path + weights.goal * to_goal
    if at_end + weights.obstacle * work.highest > limit:
        return -1.0
    highest = _highest(scene, weights.obstacle, limit - at_end, steps, headings, work)
    if highest < 0 or at_end + weights.obstacle * highest > limit:
        return -1.0
    row[kernels.END_X], row[kernels.END_Y], row[kernels.END_YAW] = (
        places[steps - 1, 0],
        places[steps - 1, 1],
        headings[steps - 1, 0],
    )
    row[kernels.PATH], row[kernels.GOAL], row[kernels.OBSTACLE] = (
        to_path,
        to_goal,
        highest,
    )
    return at_end + weights.obstacle * highest


@njit(cache=True)
def _highest(scene, weight, most, steps, headings, work):  # type: ignore[no-untyped-def]
    """Return the highest cost along a rollout, or a lower one that is worth more than `most`; -1 if not allowed."""
    ground, path, goal = scene
    costs, clear, grid, outline = ground
    rows, cols = costs.shape
    path_state, goal_state = path.state, goal.state
    highest, reach, corners, places = (
        work.highest,
        work.reach,
        work.corners,
        work.places,
    )
    for stride in (_COARSE, 1):
        corners[:] = work.first_corners
        for k in range(stride, steps, stride):
            if stride == 1 and k % _COARSE == 0:
                continue  # has been looked at
            x, y = places[k, 0], places[k, 1]
            row, col = kernels.row_col(grid, x, y)
            if not (0 <= row < rows and 0 <= col < cols) or clear[row, col] <= reach:
                c, s = headings[k, 1], headings[k, 2]
                highest = kernels.edges_cost(
                    costs, clear, grid, outline, x, y, c, s, corners, highest
                )
                if highest < 0 or weight * highest > most + 1e-6:
                    return highest
            cell = np.uint64((row + 1) * (cols + 2) + col + 1)
            if path_state[cell] != REACHED and steps_to(path, cell) >= UNREACHED:
                return -1
            if goal_state[cell] != REACHED and steps_to(goal, cell) >= UNREACHED:
                return -1
    return highest


@njit(inline="always")
def _least(scene, start, motion, weights, row, at_start):  # type: ignore[no-untyped-def]
    """Return what a sample costs at least: its distances where it ends, in closed form.

    From where speed and turn have reached the sample's, steps add up to a geometric series; all cells count that are as
    near as roundings.
    """
    path, goal, grid = scene.path, scene.goal, scene.ground.grid
    x, y, yaw, speed, turn = start
    steps = kernels.step_count(row[kernels.SPEED], row[kernels.TURN], motion)
    left, dt = steps - 1, motion.time_s / steps
    while left > 0 and (speed != row[kernels.SPEED] or turn != row[kernels.TURN]):
        speed = kernels.approach(row[kernels.SPEED], speed, motion.acceleration * dt)
        x += speed * math.cos(yaw) * dt
        y += speed * math.sin(yaw) * dt
        turn = kernels.approach(row[kernels.TURN], turn, motion.turn_acceleration * dt)
        yaw += turn * dt
        left -= 1
    half = 0.5 * turn * dt
    chord = (
        speed
        * dt
        * (
            math.sin(left * half) / math.sin(half)
            if abs(half) > _STRAIGHT_RAD
            else left
        )
    )
    middle = yaw + (left - 1) * half
    at_row = (y + chord * math.sin(middle) - grid.y) * grid.per_m
    at_col = (x + chord * math.cos(middle) - grid.x) * grid.per_m
    rows = (
        math.floor(at_row - _ROUNDING_CELLS),
        math.floor(at_row + _ROUNDING_CELLS) + 1,
    )
    cols = (
        math.floor(at_col - _ROUNDING_CELLS),
        math.floor(at_col + _ROUNDING_CELLS) + 1,
    )
    to_path = _least_steps(
        path.distances, path.state, path.columns, least_beyond(path), rows, cols
    )
    to_goal = _least_steps(
        goal.distances, goal.state, goal.columns, least_beyond(goal), rows, cols
    )
    return weights.path * to_path + weights.goal * to_goal + weights.obstacle * at_start


@njit(inline="always")
def _least_steps(distances, state, columns, beyond, rows, cols):  # type: ignore[no-untyped-def]
    """Return the least steps to cells of rows and columns, half open; `beyond` for those that are not reached yet."""
    least = UNREACHED
    for row in range(max(0, rows[0]), min(len(state) // columns - 2, rows[1])):
        for col in range(max(0, cols[0]), min(columns - 2, cols[1])):
            cell = np.uint64((row + 1) * columns + col + 1)
            least = min(least, distances[cell] if state[cell] == REACHED else beyond)
    return least
