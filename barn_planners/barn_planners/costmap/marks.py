"""Kernels that mark what a lidar sees and clear marks where it sees nothing."""

import math
from typing import NamedTuple

import numpy as np

from barn_planners.costmap.kernels import (
    Cell,
    Grid,
    Pose,
    Window,
    cell_at,
    corners_at,
    footprint_cells,
    is_on_grid,
    line_between,
    next_cell,
)
from barn_worlds.base.arrays import Bytes, Integers, Points, Singles
from barn_worlds.base.kernel import kernel

MARK = np.uint8(1)
STATIC = np.uint8(2)
_WHOLE_LINE = 2**62


class Marks(NamedTuple):
    """Obstacles of a grid, and where they have changed since the last inflation."""

    # (rows, columns): 0 (free), MARK (seen by the lidar), STATIC (of the map) or both.
    cells: Bytes
    # First row, end row, first column and end column of what has changed, (4,); nothing
    # has while the end row is not beyond the first one.
    bounds: Integers


class Readings(NamedTuple):
    """The beams of one scan and which of them count."""

    directions: Points  # unit vectors (n, 2) of the beams
    ranges: Singles  # (n,) m
    # Valid ranges, the highest one excluded.
    range_min: float
    range_max: float
    # Beams clear up to the first of these, hits nearer than the second are marked.
    raytrace_range: float
    obstacle_range: float


@kernel
def touch(bounds: Integers, cell: Cell) -> None:
    """Extend the bounds of changed cells, in place, so that they include a cell.

    Args:
        bounds: Bounds of `Marks`.
        cell: Cell that has changed.
    """
    bounds[0] = min(bounds[0], cell.row)
    bounds[1] = max(bounds[1], cell.row + 1)
    bounds[2] = min(bounds[2], cell.col)
    bounds[3] = max(bounds[3], cell.col + 1)


@kernel
def mark_cell(marks: Marks, cell: Cell) -> None:
    """Set the lidar's mark of a cell on the grid; costs wait for `refresh`.

    Args:
        marks: Marks of the grid.
        cell: Cell on the grid.
    """
    if not marks.cells[cell.row, cell.col] & MARK:
        marks.cells[cell.row, cell.col] |= MARK
        touch(marks.bounds, cell)


@kernel
def clear_cell(marks: Marks, cell: Cell) -> None:
    """Clear the lidar's mark of a cell on the grid; a mark of the map stays.

    Args:
        marks: Marks of the grid.
        cell: Cell on the grid.
    """
    if marks.cells[cell.row, cell.col] & MARK:
        marks.cells[cell.row, cell.col] &= STATIC
        touch(marks.bounds, cell)


@kernel
def clear_line(
    cells: Bytes, cols: int, bounds: Integers, start: Cell, end: Cell, limit: int
) -> None:
    """Clear lidar marks along a line between two cells on the grid, ends included.

    Args:
        cells: Marks of the grid, flat.
        cols: Number of columns of the grid.
        bounds: Bounds of `Marks`.
        start: First cell of the line, on the grid.
        end: Last cell of the line, on the grid.
        limit: Highest number of cells to clear after the first one.
    """
    line, rest = line_between(start, end)

    # On a flat grid one remainder is enough: the longer axis takes a step each time.
    along = line.row_step * cols
    across = line.col_step
    shorter = line.cols
    if line.rows < line.cols:
        along = line.col_step
        across = line.row_step * cols
        shorter = line.rows

    place = start.row * cols + start.col
    remainder = rest.row
    for _ in range(min(line.steps, limit) + 1):
        # Unsigned indices spare numba's check for negative ones.
        if cells[np.uint64(place)] & MARK:
            cells[np.uint64(place)] &= STATIC
            touch(bounds, Cell(place // cols, place % cols))
        remainder += shorter
        place += along
        if remainder >= line.steps:
            remainder -= line.steps
            place += across


@kernel
def _clear_line_to_edge(marks: Marks, start: Cell, end: Cell) -> None:
    """Clear lidar marks from `start` to `end`, or until the line leaves the grid."""
    shape = marks.cells.shape
    cell = start
    line, rest = line_between(start, end)
    for _ in range(line.steps + 1):
        if not is_on_grid(cell, shape):
            return
        clear_cell(marks, cell)
        cell, rest = next_cell(cell, rest, line)


@kernel
def clear_outside(marks: Marks, window: Window) -> None:
    """Clear the lidar's marks outside a half-open window of cells.

    Args:
        marks: Marks of the grid.
        window: Cells that keep their marks; it may reach beyond the grid.
    """
    rows, cols = marks.cells.shape
    for row in range(rows):
        for col in range(cols):
            inside_rows = window.row <= row < window.end_row
            if not (inside_rows and window.col <= col < window.end_col):
                clear_cell(marks, Cell(row, col))


@kernel
def point_beams(
    directions: Points, yaw: float, angle_min: float, angle_increment: float
) -> None:
    """Write the unit vectors of a scan's beams into `directions`.

    Args:
        directions: Array (n, 2) that receives the unit vectors.
        yaw: Heading of the lidar in the frame of the unit vectors, in rad.
        angle_min: Angle of the first beam in the lidar's frame, in rad.
        angle_increment: Angle between two beams, in rad.
    """
    for i in range(len(directions)):
        angle = yaw + angle_min + i * angle_increment
        directions[i, 0] = math.cos(angle)
        directions[i, 1] = math.sin(angle)


@kernel
def observe(
    marks: Marks,
    grid: Grid,
    pose: Pose,
    sensor: Pose,
    readings: Readings,
    outline: Points,
) -> None:
    """Clear marks along a scan's beams, mark its hits, clear the footprint; no costs.

    Args:
        marks: Marks of the grid.
        grid: Place of the grid.
        pose: Pose of base_link.
        sensor: Pose of the lidar; its heading is in the directions already.
        readings: The scan, its directions in the frame of the grid.
        outline: Corners (n, 2) in base_link of the footprint to clear, or none.
    """
    # Marks come after clearing: a beam must not clear what its neighbor hits.
    _clear_beams(marks, grid, sensor, readings)
    _mark_hits(marks, grid, sensor, readings)
    if len(outline) > 0:
        corners = corners_at(outline, pose)
        for row, col in footprint_cells(corners, grid, marks.cells.shape):
            clear_cell(marks, Cell(row, col))


@kernel
def _end_of_beam(
    grid: Grid, sensor: Pose, directions: Points, beam: int, length: float
) -> Cell:
    """Return the cell `length` m along a beam from the lidar, also off the grid."""
    x = sensor.x + length * directions[beam, 0]
    y = sensor.y + length * directions[beam, 1]
    return cell_at(grid, x, y)


@kernel
def _clear_beams(marks: Marks, grid: Grid, sensor: Pose, readings: Readings) -> None:
    """Clear marks along beams with a return, hit included, to the raytrace range."""
    # Beams of a lidar off the grid clear nothing, even where they cross it.
    shape = marks.cells.shape
    start = cell_at(grid, sensor.x, sensor.y)
    if not is_on_grid(start, shape):
        return

    # Outside the loop, as numba counts references to arrays that leave a tuple.
    cells = marks.cells.reshape(marks.cells.size)
    bounds = marks.bounds
    last = Cell(start.row - 1, start.col - 1)
    for i in range(len(readings.ranges)):
        # Written so that NaN counts as no return.
        r = float(readings.ranges[i])
        if not (readings.range_min <= r < readings.range_max):
            continue

        length = min(r, readings.raytrace_range)
        end = _end_of_beam(grid, sensor, readings.directions, i, length)
        # Neighboring beams often end in one cell, and then have one line.
        if end == last:
            continue
        last = end

        if is_on_grid(end, shape):
            clear_line(cells, shape[1], bounds, start, end, _WHOLE_LINE)
        else:
            _clear_line_to_edge(marks, start, end)


@kernel
def _mark_hits(marks: Marks, grid: Grid, sensor: Pose, readings: Readings) -> None:
    """Mark the cells on the grid of valid returns nearer than the obstacle range."""
    shape = marks.cells.shape
    range_end = min(readings.range_max, readings.obstacle_range)
    for i in range(len(readings.ranges)):
        r = float(readings.ranges[i])
        if readings.range_min <= r < range_end:
            cell = _end_of_beam(grid, sensor, readings.directions, i, r)
            if is_on_grid(cell, shape):
                mark_cell(marks, cell)
