"""Compiled loops of the obstacle layer as costmap_2d has it, down to its rounding; layers and `dirty` as in `kernels`.

Points are in single precision; rays end in the cell of their point and clear as many cells as the range has; what lies
beyond the grid is pulled in to its edge. A footprint that is not wholly on the grid is not cleared.
"""

import math

import numpy as np
from numba import njit

from barn_planners.costmap.inflation import refresh
from barn_planners.costmap.kernels import (
    MARK,
    clear_cell,
    clear_line,
    outline_cells,
    touch,
)

_INSIDE_M = 0.001  # how far inside the upper edges rays end that lead beyond


@njit(cache=True)
def observe(  # type: ignore[no-untyped-def]
    lethal,
    dirty,
    costs,
    by_square,
    squares,
    grid,
    pose,
    sensor,
    directions,
    ranges,
    limits,
    outline,
    by_front,
):
    """Do what `kernels.observe` does; sensor: x, y, yaw of the lidar; directions: of its beams in its own frame."""
    (range_min, range_max, raytrace_range, obstacle_range), (sensor_x, sensor_y, _) = (
        limits,
        sensor,
    )
    points = project(
        sensor, directions, ranges, np.float32(range_min), np.float32(range_max)
    )
    clear_rays(lethal, dirty, grid, (sensor_x, sensor_y), points, raytrace_range)
    mark(lethal, dirty, grid, (sensor_x, sensor_y), points, obstacle_range)
    if len(outline) > 0:
        clear_footprint(lethal, dirty, grid, pose, outline)
    refresh(lethal, costs, by_square, squares, dirty, by_front)


@njit(cache=True)
def project(sensor, directions, ranges, range_min, range_max):  # type: ignore[no-untyped-def]
    """Return the points (n, 2) of all valid ranges, in the order of the beams."""
    x, y, yaw = sensor
    half_sin, half_cos = (
        np.float32(math.sin(0.5 * yaw)),
        np.float32(math.cos(0.5 * yaw)),
    )
    twice = half_sin + half_sin
    c, s = np.float32(1.0) - twice * half_sin, twice * half_cos
    x, y = np.float32(x), np.float32(y)
    points, count = np.empty((len(ranges), 2), np.float32), 0
    for i in range(len(ranges)):
        if range_min <= ranges[i] < range_max:
            ahead = np.float32(np.float64(ranges[i]) * directions[i, 0])
            left = np.float32(np.float64(ranges[i]) * directions[i, 1])
            points[count, 0] = (c * ahead - s * left) + x
            points[count, 1] = (s * ahead + c * left) + y
            count += 1
    return points[:count]


@njit(cache=True)
def _cell_on(grid, rows, cols, x, y):  # type: ignore[no-untyped-def]
    """Return row and column of the cell of a point, -1 and -1 off the grid."""
    origin_x, origin_y, resolution = grid
    if not (x >= origin_x and y >= origin_y):
        return -1, -1
    row, col = int((y - origin_y) / resolution), int((x - origin_x) / resolution)
    return (row, col) if row < rows and col < cols else (-1, -1)


@njit(cache=True)
def _pulled_in(grid, rows, cols, sensor, x, y):  # type: ignore[no-untyped-def]
    """Return a point on the grid, or where the ray to it leaves the grid."""
    origin_x, origin_y, resolution = grid
    sensor_x, sensor_y = sensor
    end_x, end_y = origin_x + cols * resolution, origin_y + rows * resolution
    dx, dy = x - sensor_x, y - sensor_y
    if x < origin_x:
        x, y = origin_x, sensor_y + dy * ((origin_x - sensor_x) / dx)
    if y < origin_y:
        x, y = sensor_x + dx * ((origin_y - sensor_y) / dy), origin_y
    if x > end_x:
        x, y = end_x - _INSIDE_M, sensor_y + dy * ((end_x - sensor_x) / dx)
    if y > end_y:
        x, y = sensor_x + dx * ((end_y - sensor_y) / dy), end_y - _INSIDE_M
    return x, y


@njit(cache=True)
def clear_rays(lethal, dirty, grid, sensor, points, raytrace_range):  # type: ignore[no-untyped-def]
    """Clear the cells from the sensor to each point, but no more of them than the range has; none off the grid."""
    (rows, cols), (sensor_x, sensor_y), (_, _, resolution) = lethal.shape, sensor, grid
    row, col = _cell_on(grid, rows, cols, sensor_x, sensor_y)
    if row < 0:
        return
    cells, furthest = (
        lethal.reshape(rows * cols),
        math.ceil(raytrace_range / resolution),
    )
    last_row, last_col = -1, -1
    for k in range(len(points)):
        x, y = _pulled_in(
            grid, rows, cols, sensor, np.float64(points[k, 0]), np.float64(points[k, 1])
        )
        end_row, end_col = _cell_on(grid, rows, cols, x, y)
        if end_row < 0 or (end_row == last_row and end_col == last_col):
            continue
        last_row, last_col = end_row, end_col
        steps, length = (
            max(abs(end_row - row), abs(end_col - col)),
            math.hypot(end_col - col, end_row - row),
        )
        share = min(1.0, furthest / length) if length > 0.0 else 1.0
        clear_line(cells, cols, dirty, row, col, end_row, end_col, int(share * steps))


@njit(cache=True)
def mark(lethal, dirty, grid, sensor, points, obstacle_range):  # type: ignore[no-untyped-def]
    """Mark the cells of points nearer to the sensor than the range."""
    (rows, cols), (sensor_x, sensor_y) = lethal.shape, sensor
    for k in range(len(points)):
        x, y = np.float64(points[k, 0]), np.float64(points[k, 1])
        dx, dy = x - sensor_x, y - sensor_y
        if dx * dx + dy * dy >= obstacle_range * obstacle_range:
            continue
        row, col = _cell_on(grid, rows, cols, x, y)
        if row >= 0 and not lethal[row, col] & MARK:
            lethal[row, col] |= MARK
            touch(dirty, row, col)


@njit(cache=True)
def clear_footprint(lethal, dirty, grid, pose, outline):  # type: ignore[no-untyped-def]
    """Clear the marks in a footprint, if all its corners are on the grid, column by column.

    A column with one cell alone takes the next column's first for its second one, and leaves that column without it.
    """
    (rows, cols), (x, y, yaw) = lethal.shape, pose
    cos_yaw, sin_yaw, n = math.cos(yaw), math.sin(yaw), len(outline)
    corners = np.empty((n, 2), np.int64)
    for k in range(n):
        corner_x = x + (outline[k, 0] * cos_yaw - outline[k, 1] * sin_yaw)
        corner_y = y + (outline[k, 0] * sin_yaw + outline[k, 1] * cos_yaw)
        corners[k, 0], corners[k, 1] = _cell_on(grid, rows, cols, corner_x, corner_y)
        if corners[k, 0] < 0:
            return
    edge = outline_cells(corners)
    order = np.argsort(edge[:, 1], kind="mergesort")
    for k in range(len(edge)):
        clear_cell(lethal, dirty, edge[k, 0], edge[k, 1])
    k = 0
    for col in range(edge[order[0], 1], edge[order[-1], 1] + 1):
        if k >= len(edge) - 1:
            break
        one, other = edge[order[k], 0], edge[order[k + 1], 0]
        low, high = min(one, other), max(one, other)
        k += 2
        while k < len(edge) and edge[order[k], 1] == col:
            low, high = min(low, edge[order[k], 0]), max(high, edge[order[k], 0])
            k += 1
        for row in range(low, high):
            clear_cell(lethal, dirty, row, col)
