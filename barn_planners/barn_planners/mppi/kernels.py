"""Compiled loops of model predictive path integral control: its critics, which add to costs (samples,), and its path.

Arrays over samples are float32: controls (steps, 2, samples) m/s and rad/s; poses as three arrays (steps, samples). The
samples come last, so that the inner loops take several at once.
"""

import math

import numpy as np
from numba import njit

from barn_planners.costmap.kernels import edge_cost, place_corners

_FREE, _INSCRIBED, _LETHAL = 0, 253, 254
_LIKELY_POINTS = 2  # of the path that a trajectory passes between two poses that are compared with it


@njit(cache=True, error_model="numpy")
def length(x, y):  # type: ignore[no-untyped-def]
    """Return the length of a vector as glibc's hypot does since 2.35, to the last bit; loops over it are vectorised."""
    x, y = abs(x), abs(y)
    longer, shorter = max(x, y), min(x, y)
    rough = math.sqrt(longer * longer + shorter * shorter)
    over_shorter, over_longer = rough - shorter, rough - longer
    near = (
        longer * (2.0 * over_shorter - longer)
        + (over_shorter - 2.0 * (longer - shorter)) * over_shorter
    )
    far = 2.0 * over_longer * (longer - 2.0 * shorter) + (
        (4.0 * over_longer - shorter) * shorter + over_longer * over_longer
    )
    error = near if rough <= 2.0 * shorter else far
    return rough - error / (2.0 * rough) if rough > 0.0 else rough


@njit(cache=True, error_model="numpy")
def add_obstacle_costs(  # type: ignore[no-untyped-def]
    costs, xs, ys, yaws, grid, body, stride, weight, critical, collision, near_goal
):
    """Add the trajectories' costs on the costmap; return how many of them collide.

    body: corners (n, 2) of the footprint, and the cost from which its edges are checked. A trajectory that touches a
    lethal cell costs `collision`, others the mean cell of every `stride`-th pose; `critical` for inscribed cells.
    """
    (cells, _, _, _), (outline, possible) = grid, body
    steps, samples = xs.shape
    per_pose = weight / _LETHAL / len(range(0, steps, stride))
    prices = np.zeros(256)  # of cells by their costs
    for cost in range(_FREE + 1, 256):
        prices[cost] = critical if cost >= _INSCRIBED else 0.0 if near_goal else cost
    totals, collided = np.zeros(samples), np.zeros(samples, np.bool_)
    found, corners, lethal = (
        np.empty(samples, np.int32),
        np.empty(outline.shape),
        _lethal_within(cells),
    )
    for t in range(0, steps, stride):
        x, y = xs[t], ys[t]
        _find_cells(x, y, grid, found)
        for k in range(samples):
            if found[k] < 0 or collided[k]:
                continue
            cost = cells.flat[found[k]]
            totals[k] += prices[cost]
            if cost >= possible and cost != _FREE:
                place_corners(corners, x[k], y[k], yaws[t, k], outline)
                collided[k] = cost >= _LETHAL or _touches(grid, lethal, corners)
    for k in range(samples):
        costs[k] += collision if collided[k] else per_pose * totals[k]
    return collided.sum()


@njit(cache=True, error_model="numpy")
def _find_cells(x, y, grid, found):  # type: ignore[no-untyped-def]
    """Write the number of the cell at each point (n,), counted row by row, -1 off the grid."""
    cells, origin_x, origin_y, resolution = grid
    rows, cols = cells.shape
    for k in range(len(x)):
        row, col = (
            math.floor((y[k] - origin_y) / resolution),
            math.floor((x[k] - origin_x) / resolution),
        )
        on_grid = (row >= 0) & (row < rows) & (col >= 0) & (col < cols)
        found[k] = np.int32(row * cols + col) if on_grid else np.int32(-1)


@njit(cache=True)
def _lethal_within(cells):  # type: ignore[no-untyped-def]
    """Return how many lethal cells there are below each row and left of each column, int32 (rows + 1, columns + 1)."""
    rows, cols = cells.shape
    counts = np.zeros((rows + 1, cols + 1), np.int32)
    for row in range(rows):
        along = np.int32(0)
        for col in range(cols):
            along += np.int32(cells[row, col] >= _LETHAL)
            counts[row + 1, col + 1] = counts[row, col + 1] + along
    return counts


@njit(cache=True, error_model="numpy")
def _touches(grid, lethal, corners):  # type: ignore[no-untyped-def]
    """Tell what `edge_cost` does; it need not look at the edges where the box around them holds no lethal cell."""
    cells, origin_x, origin_y, resolution = grid
    rows, cols = cells.shape
    low_row, end_row, low_col, end_col = rows, 0, cols, 0
    for k in range(len(corners)):
        row = math.floor((corners[k, 1] - origin_y) / resolution)
        col = math.floor((corners[k, 0] - origin_x) / resolution)
        low_row, end_row = min(low_row, row), max(end_row, row + 1)
        low_col, end_col = min(low_col, col), max(end_col, col + 1)
    if low_row < 0 or end_row > rows or low_col < 0 or end_col > cols:
        return True
    upper, lower = lethal[end_row], lethal[low_row]
    some = upper[end_col] - upper[low_col] != lower[end_col] - lower[low_col]
    return some and edge_cost(cells, corners, origin_x, origin_y, resolution) < 0


@njit(cache=True)
def furthest_reached(path, xs, ys):  # type: ignore[no-untyped-def]
    """Return the number of the furthest point of the path that is the nearest to the end of some trajectory."""
    x, y = xs[-1], ys[-1]
    squares, nearest = np.full(len(x), math.inf), np.zeros(len(x), np.int64)
    for i in range(len(path)):
        path_x, path_y = path[i]
        for k in range(len(x)):
            square = (path_x - x[k]) ** 2 + (path_y - y[k]) ** 2
            nearest[k] = i if square < squares[k] else nearest[k]
            squares[k] = min(square, squares[k])
    return nearest.max()


@njit(cache=True, error_model="numpy")
def add_follow_costs(costs, xs, ys, x, y, weight):  # type: ignore[no-untyped-def]
    """Add the weight times the distance from each trajectory's end to a point of the path."""
    end_x, end_y = xs[-1], ys[-1]
    for k in range(len(costs)):
        costs[k] += weight * length(end_x[k] - x, end_y[k] - y)


@njit(cache=True)
def add_angle_costs(costs, xs, ys, yaws, x, y, weight):  # type: ignore[no-untyped-def]
    """Add the weight times the angle, at each trajectory's end, between its heading and the direction of a point."""
    for k in range(len(costs)):
        direction = math.atan2(y - ys[-1, k], x - xs[-1, k])
        costs[k] += weight * abs(_wrapped(direction - yaws[-1, k]))


@njit(cache=True, error_model="numpy")
def add_align_costs(costs, xs, ys, start, path, arc, clear, stride, weight):  # type: ignore[no-untyped-def]
    """Add the weight times the mean distance of every `stride`-th pose from where the path is as long and clear."""
    (steps, samples), (start_x, start_y) = xs.shape, start
    travelled, totals, counted = np.zeros(samples), np.zeros(samples), np.zeros(samples)
    last_x, last_y = np.full(samples, start_x), np.full(samples, start_y)
    beside, ends = np.zeros(samples, np.int64), np.append(arc, math.inf)
    path_x, path_y, counts = np.empty(samples), np.empty(samples), np.empty(samples)
    for t in range(stride, steps, stride):
        x, y = xs[t], ys[t]
        for k in range(samples):
            travelled[k] += length(x[k] - last_x[k], y[k] - last_y[k])
            last_x[k], last_y[k] = x[k], y[k]
        for k in range(samples):
            i, way = beside[k], travelled[k]
            for _ in range(
                _LIKELY_POINTS
            ):  # without branches, which would be mispredicted
                i += np.int64(abs(ends[i + 1] - way) <= abs(ends[i] - way))
            while abs(ends[i + 1] - way) <= abs(ends[i] - way):
                i += 1
            beside[k] = i
            path_x[k], path_y[k], counts[k] = path[i, 0], path[i, 1], clear[i]
        for k in range(samples):
            totals[k] += counts[k] * length(path_x[k] - x[k], path_y[k] - y[k])
            counted[k] += counts[k]
    for k in range(samples):
        if counted[k] > 0.0:
            costs[k] += weight * totals[k] / counted[k]


@njit(cache=True, error_model="numpy")
def add_goal_costs(costs, xs, ys, yaws, goal, position_weight, yaw_weight):  # type: ignore[no-untyped-def]
    """Add the weights times the mean distance from the goal (x, y, yaw) and the mean angle to its heading."""
    (steps, samples), (goal_x, goal_y, goal_yaw) = xs.shape, goal
    distances, angles = np.zeros(samples), np.zeros(samples)
    for t in range(steps):
        x, y, yaw = xs[t], ys[t], yaws[t]
        if position_weight > 0.0:
            for k in range(samples):
                distances[k] += length(x[k] - goal_x, y[k] - goal_y)
        if yaw_weight > 0.0:
            for k in range(samples):
                angles[k] += abs(_wrapped(yaw[k] - goal_yaw))
    for k in range(samples):
        costs[k] += (position_weight * distances[k] + yaw_weight * angles[k]) / steps


@njit(cache=True, error_model="numpy")
def add_control_costs(  # type: ignore[no-untyped-def]
    costs, controls, nominal, spread, limits, dt, gamma, limit_weight, forward_weight
):
    """Add gamma times control times deviation over variance, what is beyond the limits, and reverse speed, by dt."""
    steps, _, samples = controls.shape
    deviation, beyond, reverse = np.zeros(samples), np.zeros(samples), np.zeros(samples)
    slowest, fastest, turn = limits[0], limits[1], limits[2]
    speed_variance, rate_variance = spread[0] * spread[0], spread[1] * spread[1]
    for t in range(steps):
        speed, rate = controls[t, 0], controls[t, 1]
        wanted_speed, wanted_rate = nominal[t, 0], nominal[t, 1]
        for k in range(samples):
            along = wanted_speed * (speed[k] - wanted_speed) / speed_variance
            turned = wanted_rate * (rate[k] - wanted_rate) / rate_variance
            deviation[k] = deviation[k] + along + turned
        for k in range(samples):
            beyond[k] += (
                max(0.0, speed[k] - fastest)
                + max(0.0, slowest - speed[k])
                + max(0.0, abs(rate[k]) - turn)
            )
            reverse[k] += max(0.0, -speed[k])
    for k in range(samples):
        costs[k] += (
            gamma * deviation[k]
            + (limit_weight * beyond[k] + forward_weight * reverse[k]) * dt
        )


@njit(cache=True)
def resample(points, spacing, most):  # type: ignore[no-untyped-def]
    """Return (m, 2) points at even spacing along a line, at most `most`, the first included, and the last with room."""
    out = np.empty((most, 2))
    out[0] = points[0]
    count, carried = 1, 0.0
    for i in range(len(points) - 1):
        dx, dy = points[i + 1, 0] - points[i, 0], points[i + 1, 1] - points[i, 1]
        length = math.hypot(dx, dy)
        along = spacing - carried
        while along <= length and count < most:
            out[count, 0] = points[i, 0] + dx * along / length
            out[count, 1] = points[i, 1] + dy * along / length
            count += 1
            along += spacing
        carried = length - (along - spacing)
    if count < most and carried > 1e-9:
        out[count] = points[-1]
        count += 1
    return out[:count]


@njit(cache=True)
def _wrapped(angle):  # type: ignore[no-untyped-def]
    return angle - 2.0 * math.pi * math.floor((angle + math.pi) / (2.0 * math.pi))
