"""Compiled loops of the dynamic window approach: rollouts and the search over the velocity samples."""

import math

import numpy as np
from numba import njit, types
from numba.extending import overload

from barn_planners.costmap.kernels import line_between, next_cell
from barn_planners.dwa.waves import UNREACHED, steps_to

TOUCHES = -1.0
NO_WAY = -2.0

# Columns of the table of samples that `search` fills.
SPEED, TURN, COST, END_X, END_Y, END_YAW, PATH, GOAL, OBSTACLE = range(9)


@njit(cache=True)
def _evenly(low, high, count):  # type: ignore[no-untyped-def]
    """Return `count` values from low to high, to the last bit those of numpy.linspace."""
    values = np.empty(count)
    step = (high - low) / (count - 1)
    for k in range(count):
        values[k] = k * step + low
    values[-1] = high
    return values


@njit(cache=True)
def forward_samples(slowest, fastest, low, high, speeds, turns, highest):  # type: ignore[no-untyped-def]
    """Return samples (n, 2): for each of `speeds` straight ahead, then `turns` rates, the highest one only if asked."""
    rates = _evenly(low, high, turns)
    kept = turns + 1 if highest else turns
    samples = np.zeros((speeds * kept, 2))
    for i, speed in enumerate(_evenly(slowest, fastest, speeds)):
        for k in range(kept):
            samples[i * kept + k, 0] = speed
            if k > 0:
                samples[i * kept + k, 1] = rates[k - 1]
    return samples


@njit(cache=True)
def turn_samples(low, high, turns, slowest):  # type: ignore[no-untyped-def]
    """Return rates (n,) of turns in place, none slower than `slowest`."""
    rates = _evenly(low, high, turns)
    for k in range(turns):
        rates[k] = max(rates[k], slowest) if rates[k] > 0.0 else min(rates[k], -slowest)
    return rates


@njit(cache=True)
def open_around(costs, window, clear):  # type: ignore[no-untyped-def]
    """Write the distance in cells (the larger of rows and columns) to the next cell with a cost or to the window.

    window: first row, end row, first column, end column; `clear` is 0 outside it. Rollouts use it to skip edges
    that cannot meet a cost.
    """
    rows, cols = costs.shape
    row_lo, row_hi = max(0, window[0]), min(rows, window[1])
    col_lo, col_hi = max(0, window[2]), min(cols, window[3])
    clear[:] = 0
    for row in range(row_lo + 1, row_hi - 1):
        for col in range(col_lo + 1, col_hi - 1):
            r, c = np.uint64(row), np.uint64(col)
            if costs[r, c] == 0:
                above = r - np.uint64(1)
                low = min(clear[above, c - np.uint64(1)], clear[above, c], clear[above, c + np.uint64(1)])
                clear[r, c] = min(low, clear[r, c - np.uint64(1)]) + 1
    for row in range(row_hi - 2, row_lo, -1):
        for col in range(col_hi - 2, col_lo, -1):
            r, c = np.uint64(row), np.uint64(col)
            if clear[r, c] > 1:
                below = r + np.uint64(1)
                low = min(clear[below, c - np.uint64(1)], clear[below, c], clear[below, c + np.uint64(1)])
                clear[r, c] = min(clear[r, c], min(low, clear[r, c + np.uint64(1)]) + 1)


@njit(cache=True)
def along_edge(costs, clear, row, col, end_row, end_col, highest):  # type: ignore[no-untyped-def]
    """Return the larger of `highest` and the highest cost between two cells, -1 if it is lethal.

    clear: as `open_around` fills it.
    """
    line, rest = line_between(row, col, end_row, end_col)
    steps = line[0]
    if clear[np.uint64((row + end_row) // 2), np.uint64((col + end_col) // 2)] <= steps // 2 + 1:
        for _ in range(steps + 1):
            highest = max(highest, costs[np.uint64(row), np.uint64(col)])
            row, col, rest = next_cell(row, col, rest, line)
        if highest >= 254:
            return -1
    return highest


@njit(cache=True)
def rectangle_cost(costs, clear, grid, body, x, y, cos_yaw, sin_yaw):  # type: ignore[no-untyped-def]
    """Return the highest cost along the edges of the footprint at a pose, -1 if lethal or off the grid.

    clear: as `open_around` fills it; grid: (origin x, origin y, cells per metre); body: half length and half width of
    the padded footprint. The same as `costmap_kernels.edge_cost` of its corners, without an array for each pose.
    """
    rows, cols = costs.shape
    along_x, along_y = cos_yaw * body[0], sin_yaw * body[0]
    across_x, across_y = -sin_yaw * body[1], cos_yaw * body[1]
    highest = 0
    row = math.floor((y + along_y + across_y - grid[1]) * grid[2])
    col = math.floor((x + along_x + across_x - grid[0]) * grid[2])
    if row < 0 or row >= rows or col < 0 or col >= cols:
        return -1
    for k in range(4):
        a = -1.0 if k < 2 else 1.0
        b = 1.0 if k in (0, 3) else -1.0
        end_row = math.floor((y + a * along_y + b * across_y - grid[1]) * grid[2])
        end_col = math.floor((x + a * along_x + b * across_x - grid[0]) * grid[2])
        if end_row < 0 or end_row >= rows or end_col < 0 or end_col >= cols:
            return -1
        highest = along_edge(costs, clear, row, col, end_row, end_col, highest)
        if highest < 0:
            return -1
        row, col = end_row, end_col
    return highest


@njit(cache=True)
def outline_cost(costs, clear, grid, body, x, y, cos_yaw, sin_yaw):  # type: ignore[no-untyped-def]
    """Return the same as `rectangle_cost` for a convex footprint; body: its corners (n, 2) in base_link, padded."""
    rows, cols = costs.shape
    highest, last = 0, len(body) - 1
    row = math.floor((y + sin_yaw * body[last, 0] + cos_yaw * body[last, 1] - grid[1]) * grid[2])
    col = math.floor((x + cos_yaw * body[last, 0] - sin_yaw * body[last, 1] - grid[0]) * grid[2])
    if row < 0 or row >= rows or col < 0 or col >= cols:
        return -1
    for k in range(len(body)):
        end_row = math.floor((y + sin_yaw * body[k, 0] + cos_yaw * body[k, 1] - grid[1]) * grid[2])
        end_col = math.floor((x + cos_yaw * body[k, 0] - sin_yaw * body[k, 1] - grid[0]) * grid[2])
        if end_row < 0 or end_row >= rows or end_col < 0 or end_col >= cols:
            return -1
        highest = along_edge(costs, clear, row, col, end_row, end_col, highest)
        if highest < 0:
            return -1
        row, col = end_row, end_col
    return highest


def footprint_cost(costs, clear, grid, body, x, y, cos_yaw, sin_yaw):  # type: ignore[no-untyped-def]
    """Return `rectangle_cost` for half sizes, `outline_cost` for corners; compiled code has one of them alone."""
    cost = outline_cost if isinstance(body, np.ndarray) else rectangle_cost
    return cost(costs, clear, grid, body, x, y, cos_yaw, sin_yaw)


@overload(footprint_cost)
def _footprint_cost(costs, clear, grid, body, x, y, cos_yaw, sin_yaw):  # type: ignore[no-untyped-def]  # noqa: ARG001
    return (outline_cost if isinstance(body, types.Array) else rectangle_cost).py_func


@njit(cache=True)
def approach(wanted, now, change):  # type: ignore[no-untyped-def]
    """Return a velocity moved towards the wanted one by at most `change`."""
    if wanted >= now:
        return min(wanted, now + change)
    return max(wanted, now - change)


@njit(cache=True)
def step_count(speed, turn, motion):  # type: ignore[no-untyped-def]
    """Return the number of poses of a rollout; the turn counts per second, not over the whole time."""
    return max(1, int(max(abs(speed) * motion[0] / motion[1], abs(turn) / motion[2]) + 0.5))


@njit(cache=True)
def rollout(costs, clear, path, goal, grid, body, start, motion, weights, row):  # type: ignore[no-untyped-def]
    """Score one sample; `row` of the table has its speed and turn and gets the results.

    path, goal: waves of `dwa_waves`; start: x, y, yaw, speed, turn; motion: time, granularity (m, rad), acceleration,
    turn acceleration; weights: path, goal, obstacle. The cost is TOUCHES or NO_WAY where a pose is not allowed.
    """
    cols = costs.shape[1]
    x, y, yaw, speed, turn = start
    steps = step_count(row[SPEED], row[TURN], motion)
    dt = motion[0] / steps
    obstacle = 0
    row[COST] = TOUCHES
    for k in range(steps):
        cos_yaw, sin_yaw = math.cos(yaw), math.sin(yaw)
        edge = footprint_cost(costs, clear, grid, body, x, y, cos_yaw, sin_yaw)  # type: ignore[no-untyped-call]
        if edge < 0:
            return
        obstacle = max(obstacle, edge)
        cell = (math.floor((y - grid[1]) * grid[2]) + 1) * (cols + 2) + math.floor((x - grid[0]) * grid[2]) + 1
        to_path, to_goal = steps_to(path, cell), steps_to(goal, cell)
        if to_path >= UNREACHED or to_goal >= UNREACHED:
            row[COST] = NO_WAY
            return
        row[END_X], row[END_Y], row[END_YAW] = x, y, yaw
        row[PATH], row[GOAL] = to_path, to_goal
        if k + 1 < steps:
            speed = approach(row[SPEED], speed, motion[3] * dt)
            turn = approach(row[TURN], turn, motion[4] * dt)
            x += speed * cos_yaw * dt
            y += speed * sin_yaw * dt
            yaw += turn * dt
    row[OBSTACLE] = obstacle
    row[COST] = weights[0] * row[PATH] + weights[1] * row[GOAL] + weights[2] * obstacle


@njit(cache=True)
def goal_ahead(goal, cols, rows, grid, row, lookahead):  # type: ignore[no-untyped-def]
    """Return the goal distance a bit ahead of the end of a sample, UNREACHED off the grid."""
    x = row[END_X] + lookahead * math.cos(row[END_YAW])
    y = row[END_Y] + lookahead * math.sin(row[END_YAW])
    grid_row, grid_col = math.floor((y - grid[1]) * grid[2]), math.floor((x - grid[0]) * grid[2])
    if grid_row < 0 or grid_row >= rows or grid_col < 0 or grid_col >= cols:
        return UNREACHED
    return steps_to(goal, (grid_row + 1) * (cols + 2) + grid_col + 1)


@njit(cache=True)
def search(costs, clear, path, goal, grid, body, start, motion, weights, table, drives, turns, lookahead):  # type: ignore[no-untyped-def]
    """Score all samples of the table and return the row of the best one, -1 if none is allowed.

    drives: number of rows, at the top, that drive forward; the first of the cheapest wins. The others turn in place.
    One of them wins if it costs no more than the best so far, `turns` (left, right) allows its direction, and the goal
    distance `lookahead` metres ahead of its end is lower than that of any turn accepted before.
    """
    rows, cols = costs.shape
    best = -1
    ahead_best = UNREACHED
    for k in range(len(table)):
        row = table[k]
        rollout(costs, clear, path, goal, grid, body, start, motion, weights, row)
        if row[COST] < 0.0:
            continue
        if k < drives:
            if best < 0 or row[COST] < table[best, COST]:
                best = k
            continue
        allowed = turns[0] if row[TURN] > 0.0 else turns[1]
        if not allowed or (best >= 0 and row[COST] > table[best, COST]):
            continue
        ahead = goal_ahead(goal, cols, rows, grid, row, lookahead)
        if ahead < ahead_best:
            best, ahead_best = k, ahead
    return best


@njit(cache=True)
def trace(start, speed, turn, motion, points):  # type: ignore[no-untyped-def]
    """Write the poses (n, 3) of a rollout to `points`, padded with the last one; return their number."""
    x, y, yaw, v, w = start
    steps = min(step_count(speed, turn, motion), len(points))
    dt = motion[0] / steps
    for k in range(steps):
        points[k, 0], points[k, 1], points[k, 2] = x, y, yaw
        v = approach(speed, v, motion[3] * dt)
        w = approach(turn, w, motion[4] * dt)
        x += v * math.cos(yaw) * dt
        y += v * math.sin(yaw) * dt
        yaw += w * dt
    points[steps:] = points[steps - 1]
    return steps
