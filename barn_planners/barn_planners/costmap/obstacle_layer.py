"""Kernels of the obstacle layer as costmap_2d has it, down to its rounding.

They follow costmap_2d's plugins/obstacle_layer.cpp and costmap_2d.cpp. Differences from
`kernels`: points are in single precision, a ray that leads off the grid is cut off at its
edge, and a footprint that is not wholly on the grid is not cleared.
"""

import math

import numpy as np

from barn_planners.costmap.kernels import (
    Cell,
    Grid,
    Marks,
    Pose,
    Readings,
    cell_at,
    clear_cell,
    clear_line,
    is_on_grid,
    mark_cell,
    outline_cells,
)
from barn_worlds.base.arrays import Points, Singles, kernel

_INSIDE_M = 0.001  # how far inside the upper edges a ray ends that leads beyond


@kernel
def observe(
    marks: Marks,
    grid: Grid,
    pose: Pose,
    sensor: Pose,
    readings: Readings,
    outline: Points,
) -> None:
    """Update marks by a scan, as `kernels.observe`, but exactly as costmap_2d does.

    Follows `ObstacleLayer::updateBounds`.

    Args:
        marks: Marks of the grid.
        grid: Place of the grid.
        pose: Pose of base_link.
        sensor: Pose of the lidar.
        readings: The scan, its directions in the lidar's frame.
        outline: Corners (n, 2) in base_link of the footprint to clear, or none.
    """
    # Points once for both passes, as the original projects the scan once into a cloud.
    points = project_scan(sensor, readings)
    _clear_rays(marks, grid, sensor, points, readings.raytrace_range)
    _mark_points(marks, grid, sensor, points, readings.obstacle_range)
    if len(outline) > 0:
        _clear_footprint(marks, grid, pose, outline)


@kernel
def project_scan(sensor: Pose, readings: Readings) -> Singles:
    """Return the valid hits (n, 2) in m, float32 in the grid's frame, beam by beam.

    Follows laser_geometry's `projectLaser` and tf2's rotation by a quaternion, which
    compute in single precision.

    Args:
        sensor: Pose of the lidar.
        readings: The scan, its directions in the lidar's frame.
    """
    # The quaternion of the heading, and the first column of its rotation matrix.
    half_sin = np.float32(math.sin(0.5 * sensor.yaw))
    half_cos = np.float32(math.cos(0.5 * sensor.yaw))
    twice = half_sin + half_sin
    c = np.float32(1.0) - twice * half_sin
    s = twice * half_cos
    x = np.float32(sensor.x)
    y = np.float32(sensor.y)

    range_min = np.float32(readings.range_min)
    range_max = np.float32(readings.range_max)
    points = np.empty((len(readings.ranges), 2), np.float32)
    count = 0
    for i in range(len(readings.ranges)):
        r = readings.ranges[i]
        if range_min <= r < range_max:
            # The product is in double precision, the point in single precision.
            ahead = np.float32(np.float64(r) * readings.directions[i, 0])
            left = np.float32(np.float64(r) * readings.directions[i, 1])
            points[count, 0] = (c * ahead - s * left) + x
            points[count, 1] = (s * ahead + c * left) + y
            count += 1

    return points[:count]


@kernel
def _end_on_grid(
    grid: Grid, shape: tuple[int, int], sensor: Pose, x: float, y: float
) -> tuple[float, float]:
    """Return a point (x, y) in m, or where the lidar's ray to it leaves the grid."""
    end_x = grid.x + shape[1] * grid.resolution
    end_y = grid.y + shape[0] * grid.resolution
    dx = x - sensor.x
    dy = y - sensor.y
    # In the original's order, as each cut starts from the one before.
    if x < grid.x:
        y = sensor.y + dy * ((grid.x - sensor.x) / dx)
        x = grid.x
    if y < grid.y:
        x = sensor.x + dx * ((grid.y - sensor.y) / dy)
        y = grid.y
    if x > end_x:
        y = sensor.y + dy * ((end_x - sensor.x) / dx)
        x = end_x - _INSIDE_M
    if y > end_y:
        x = sensor.x + dx * ((end_y - sensor.y) / dy)
        y = end_y - _INSIDE_M

    return x, y


@kernel
def _clear_rays(
    marks: Marks, grid: Grid, sensor: Pose, points: Singles, raytrace_range: float
) -> None:
    """Clear lidar marks from the sensor toward each point, up to range and grid edge.

    The range in m, rounded up to cells, limits how far; it counts along the ray.
    """
    shape = marks.cells.shape
    start = cell_at(grid, sensor.x, sensor.y)
    if not is_on_grid(start, shape):
        return

    cells = marks.cells.reshape(marks.cells.size)
    bounds = marks.bounds
    # `cellDistance` of the original rounds up.
    limit = math.ceil(raytrace_range / grid.resolution)
    last = Cell(-1, -1)
    for k in range(len(points)):
        point_x = np.float64(points[k, 0])
        point_y = np.float64(points[k, 1])
        x, y = _end_on_grid(grid, shape, sensor, point_x, point_y)
        end = cell_at(grid, x, y)
        if end == last or not is_on_grid(end, shape):
            continue
        last = end

        # The range counts in cells along the line, the share of it in its steps.
        d_row = end.row - start.row
        d_col = end.col - start.col
        length = math.hypot(d_col, d_row)
        share = min(1.0, limit / length) if length > 0.0 else 1.0
        steps = int(share * max(abs(d_row), abs(d_col)))
        clear_line(cells, shape[1], bounds, start, end, steps)


@kernel
def _mark_points(
    marks: Marks, grid: Grid, sensor: Pose, points: Singles, obstacle_range: float
) -> None:
    """Mark the cells on the grid of points nearer to the lidar than the range in m."""
    shape = marks.cells.shape
    for k in range(len(points)):
        x = np.float64(points[k, 0])
        y = np.float64(points[k, 1])
        dx = x - sensor.x
        dy = y - sensor.y
        if dx * dx + dy * dy >= obstacle_range * obstacle_range:
            continue

        cell = cell_at(grid, x, y)
        if is_on_grid(cell, shape):
            mark_cell(marks, cell)


@kernel
def _clear_footprint(marks: Marks, grid: Grid, pose: Pose, outline: Points) -> None:
    """Clear lidar marks under a footprint; none if a corner lies off the grid.

    Follows `Costmap2D::setConvexPolygonCost` and `convexFillCells` with their flaw: a
    column that has only one cell of the outline takes the next column's first one for
    its second, and leaves that column without it.
    """
    c = math.cos(pose.yaw)
    s = math.sin(pose.yaw)
    corners = np.empty((len(outline), 2), np.int64)
    for k in range(len(outline)):
        # In brackets, as `transformFootprint` adds the position last.
        x = pose.x + (outline[k, 0] * c - outline[k, 1] * s)
        y = pose.y + (outline[k, 0] * s + outline[k, 1] * c)
        cell = cell_at(grid, x, y)
        if not is_on_grid(cell, marks.cells.shape):
            return
        corners[k] = cell

    edge = outline_cells(corners)
    for row, col in edge:
        clear_cell(marks, Cell(row, col))

    # convexFillCells sorts by bubble sort, which keeps the order of equal columns.
    edge = edge[np.argsort(edge[:, 1], kind="mergesort")]
    k = 0
    for col in range(edge[0, 1], edge[-1, 1] + 1):
        if k >= len(edge) - 1:
            break

        low = min(edge[k, 0], edge[k + 1, 0])
        high = max(edge[k, 0], edge[k + 1, 0])
        k += 2
        while k < len(edge) and edge[k, 1] == col:
            low = min(low, edge[k, 0])
            high = max(high, edge[k, 0])
            k += 1

        # The highest row is of the outline, which is clear already.
        for row in range(low, high):
            clear_cell(marks, Cell(row, col))
