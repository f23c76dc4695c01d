"""The compiled search over the velocity samples: the result of `dwa_kernels.search`, without scoring every sample.

A sample's cost is that of its end plus that of the highest obstacle along it. So its end is computed first, and its
footprints are checked only as long as it can still be the best. The order of the checks changes no result.
"""

import math

import numpy as np
from numba import njit, types
from numba.extending import overload

from barn_planners.dwa.kernels import (
    COST,
    END_X,
    END_Y,
    END_YAW,
    SPEED,
    TOUCHES,
    TURN,
    along_edge,
    approach,
    goal_ahead,
    outline_cost,
    rollout,
    step_count,
)
from barn_planners.dwa.waves import REACHED, UNREACHED, front, steps_to

_COARSE = 6  # poses between two of those that are checked first


@njit(cache=True)
def find_best(scene, start, motion, weights, table, drives, turns, lookahead, likely, slots):  # type: ignore[no-untyped-def]  # noqa: C901
    """Return the row that `dwa_kernels.search` returns, and fill that row only; the cost of the others is TOUCHES.

    scene: costs, clear, path, goal, grid, body; all arguments as for `search`.
    likely: a row to begin with, since the best so far rules out others; any row is right, that of the last cycle fast.
    slots: rows this far apart have the same turn, if any; their headings are computed once.
    """
    most = 1
    for k in range(len(table)):
        table[k, COST] = TOUCHES
        most = max(most, step_count(table[k, SPEED], table[k, TURN], motion))
    headings, heading_of = np.empty((slots, most + 1, 3)), np.zeros((slots, 2))
    places = np.empty((most, 2))
    best, best_cost = -1, math.inf
    at_start = _highest_at(scene, start)
    if at_start < 0:
        return -1
    least_of, least = math.inf, 0.0  # a speed, and what samples of it cost at least
    for n in range(-1, drives):
        k = likely if n < 0 else n
        if k >= drives or n == likely:
            continue
        if best >= 0 and table[k, SPEED] != least_of:
            least_of = table[k, SPEED]
            least = _least(scene, start, motion, weights, least_of) + weights[2] * at_start
        if least > best_cost:
            continue
        # of equal costs the first row wins
        cost = _cost(
            scene, start, motion, weights, table[k], best_cost, headings[k % slots], heading_of[k % slots], places
        )
        if cost >= 0.0 and (cost < best_cost or (cost == best_cost and k < best)):
            best, best_cost = k, cost
    ahead_best = UNREACHED
    least = _least(scene, start, motion, weights, 0.0) + weights[2] * at_start
    for k in range(drives, len(table)):
        row = table[k]
        if least > best_cost or not (turns[0] if row[TURN] > 0.0 else turns[1]):
            continue
        cost = _cost(scene, start, motion, weights, row, best_cost, headings[k % slots], heading_of[k % slots], places)
        if cost < 0.0 or cost > best_cost:
            continue
        steps = step_count(row[SPEED], row[TURN], motion)
        row[END_X], row[END_Y], row[END_YAW] = (
            places[steps - 1, 0],
            places[steps - 1, 1],
            headings[k % slots, steps - 1, 0],
        )
        ahead = goal_ahead(scene[3], scene[0].shape[1], scene[0].shape[0], scene[4], row, lookahead)
        if ahead < ahead_best:
            best, best_cost, ahead_best = k, cost, ahead
    if best >= 0:
        rollout(*scene, start, motion, weights, table[best])  # type: ignore[call-arg]
    return best


@njit(cache=True)
def _cost(scene, start, motion, weights, row, limit, headings, heading_of, places):  # type: ignore[no-untyped-def]
    """Return the cost of a sample as `rollout` does; -1 if it is not allowed or, perhaps, if it is above the limit."""
    costs, clear, path, goal, grid, body = scene
    rows, cols = costs.shape
    steps = step_count(row[SPEED], row[TURN], motion)
    if heading_of[0] != row[TURN] or heading_of[1] != steps:
        heading_of[0], heading_of[1] = row[TURN], steps
        _turn(start, row[TURN], steps, motion, headings)
    _drive(start, row[SPEED], steps, motion, headings, places)
    end_row = math.floor((places[steps - 1, 1] - grid[1]) * grid[2])
    end_col = math.floor((places[steps - 1, 0] - grid[0]) * grid[2])
    if end_row < 0 or end_row >= rows or end_col < 0 or end_col >= cols:
        return -1.0
    end = np.uint64((end_row + 1) * (cols + 2) + end_col + 1)
    to_path, to_goal = steps_to(path, end), steps_to(goal, end)
    if to_path >= UNREACHED or to_goal >= UNREACHED:
        return -1.0
    at_end = weights[0] * to_path + weights[1] * to_goal
    highest, path_state, goal_state = 0, path[1], goal[1]
    for stride in (_COARSE, 1):
        before = (-1, -1, -1, -1, -1, -1, -1, -1)
        for k in range(0, steps, stride):
            x, y = places[k, 0], places[k, 1]
            highest, before = _footprint(  # type: ignore[no-untyped-call]
                costs, clear, grid, body, x, y, headings[k, 1], headings[k, 2], before, highest
            )
            if highest < 0 or at_end + weights[2] * highest > limit:
                return -1.0
            cell = np.uint64(
                (math.floor((y - grid[1]) * grid[2]) + 1) * (cols + 2) + math.floor((x - grid[0]) * grid[2]) + 1
            )
            if path_state[cell] != REACHED and steps_to(path, cell) >= UNREACHED:
                return -1.0
            if goal_state[cell] != REACHED and steps_to(goal, cell) >= UNREACHED:
                return -1.0
    return at_end + weights[2] * highest


def _footprint(costs, clear, grid, body, x, y, cos_yaw, sin_yaw, before, highest):  # type: ignore[no-untyped-def]
    """Return `_edges` for half sizes, `_outline` for corners; compiled code has one of them alone."""
    edges = _outline if isinstance(body, np.ndarray) else _edges
    return edges(costs, clear, grid, body, x, y, cos_yaw, sin_yaw, before, highest)


@overload(_footprint)
def _footprint_compiled(costs, clear, grid, body, x, y, cos_yaw, sin_yaw, before, highest):  # type: ignore[no-untyped-def]  # noqa: ARG001
    return (_outline if isinstance(body, types.Array) else _edges).py_func


@njit(cache=True)
def _outline(costs, clear, grid, body, x, y, cos_yaw, sin_yaw, before, highest):  # type: ignore[no-untyped-def]
    """Return the larger of `highest` and `outline_cost` (-1 if that is), and `before` as it is."""
    cost = outline_cost(costs, clear, grid, body, x, y, cos_yaw, sin_yaw)
    return (cost if cost < 0 else max(highest, cost)), before


@njit(cache=True)
def _highest_at(scene, start):  # type: ignore[no-untyped-def]
    """Return the highest cost under the footprint's edges where all samples start, -1 if it is not allowed there."""
    costs, clear, _, _, grid, body = scene
    nowhere = (-1, -1, -1, -1, -1, -1, -1, -1)
    cos_yaw, sin_yaw = math.cos(start[2]), math.sin(start[2])
    at = (start[0], start[1], cos_yaw, sin_yaw)
    return _footprint(costs, clear, grid, body, *at, nowhere, 0)[0]  # type: ignore[no-untyped-call]


@njit(cache=True)
def _least(scene, start, motion, weights, speed):  # type: ignore[no-untyped-def]
    """Return what samples of a speed cost at least for their distances: the least of all cells that they can reach.

    A cell that a wave has not reached yet is further than any that it has.
    """
    costs, _, path, goal, grid, _ = scene
    rows, cols = costs.shape
    change = abs(start[3] - speed)
    reach = (abs(speed) * motion[0] + change * change / (2.0 * motion[3])) * grid[2] + 1.0
    row, col = (start[1] - grid[1]) * grid[2], (start[0] - grid[0]) * grid[2]
    path_steps, path_state, path_next = path[0], path[1], front(path)
    goal_steps, goal_state, goal_next = goal[0], goal[1], front(goal)
    least = math.inf
    for i in range(max(0, math.floor(row - reach)), min(rows, math.floor(row + reach) + 1)):
        for j in range(max(0, math.floor(col - reach)), min(cols, math.floor(col + reach) + 1)):
            cell = np.uint64((i + 1) * (cols + 2) + j + 1)
            to_path = path_steps[cell] if path_state[cell] == REACHED else path_next
            to_goal = goal_steps[cell] if goal_state[cell] == REACHED else goal_next
            least = min(least, weights[0] * to_path + weights[1] * to_goal)
    return least


@njit(cache=True)
def _turn(start, turn, steps, motion, headings):  # type: ignore[no-untyped-def]
    """Fill `headings` (steps or more, 3) with yaw, its cosine and its sine at each pose of a rollout."""
    yaw, rate = start[2], start[4]
    dt = motion[0] / steps
    for k in range(steps):
        headings[k, 0], headings[k, 1], headings[k, 2] = yaw, math.cos(yaw), math.sin(yaw)
        rate = approach(turn, rate, motion[4] * dt)
        yaw += rate * dt


@njit(cache=True)
def _drive(start, speed, steps, motion, headings, places):  # type: ignore[no-untyped-def]
    """Fill `places` (steps or more, 2) with x and y at each pose of a rollout."""
    x, y, now = start[0], start[1], start[3]
    dt = motion[0] / steps
    for k in range(steps):
        places[k, 0], places[k, 1] = x, y
        now = approach(speed, now, motion[3] * dt)
        x += now * headings[k, 1] * dt
        y += now * headings[k, 2] * dt


@njit(cache=True)
def _edges(costs, clear, grid, body, x, y, cos_yaw, sin_yaw, before, highest):  # type: ignore[no-untyped-def]
    """Return the larger of `highest` and `rectangle_cost` (-1 if that is), and the cells of the corners.

    before: the cells of the corners at a pose whose edges are part of `highest`; edges that are the same are skipped.
    """
    rows, cols = costs.shape
    along_x, along_y = cos_yaw * body[0], sin_yaw * body[0]
    across_x, across_y = -sin_yaw * body[1], cos_yaw * body[1]
    corners = (
        math.floor((y + along_y + across_y - grid[1]) * grid[2]),
        math.floor((x + along_x + across_x - grid[0]) * grid[2]),
        math.floor((y - along_y + across_y - grid[1]) * grid[2]),
        math.floor((x - along_x + across_x - grid[0]) * grid[2]),
        math.floor((y - along_y - across_y - grid[1]) * grid[2]),
        math.floor((x - along_x - across_x - grid[0]) * grid[2]),
        math.floor((y + along_y - across_y - grid[1]) * grid[2]),
        math.floor((x + along_x - across_x - grid[0]) * grid[2]),
    )
    low_row, high_row = (
        min(corners[0], corners[2], corners[4], corners[6]),
        max(corners[0], corners[2], corners[4], corners[6]),
    )
    low_col, high_col = (
        min(corners[1], corners[3], corners[5], corners[7]),
        max(corners[1], corners[3], corners[5], corners[7]),
    )
    if low_row < 0 or high_row >= rows or low_col < 0 or high_col >= cols:
        return -1, corners
    for k in range(4):
        a, b = 2 * k, 2 * (k + 1) % 8
        row, col, end_row, end_col = corners[a], corners[a + 1], corners[b], corners[b + 1]
        if row == before[a] and col == before[a + 1] and end_row == before[b] and end_col == before[b + 1]:
            continue
        highest = along_edge(costs, clear, row, col, end_row, end_col, highest)
        if highest < 0:
            return -1, corners
    return highest, corners
