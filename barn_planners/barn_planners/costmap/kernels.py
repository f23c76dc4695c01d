"""Kernels on the cells of a costmap: points, lines, footprints, marks of a lidar.

Lines are Bresenham's, cell for cell as in costmap_2d's `raytraceLine` (costmap_2d.h)
and base_local_planner's `LineIterator` (line_iterator.h).
"""

import math
from typing import NamedTuple

import numpy as np

from barn_worlds.base.arrays import Bytes, Cells, Integers, Points, Singles, kernel

INSCRIBED = 253  # base_link in this cell: the footprint certainly touches
LETHAL = 254  # an obstacle

# What marks a cell.
MARK = np.uint8(1)
STATIC = np.uint8(2)
_WHOLE_LINE = 2**62


class Pose(NamedTuple):
    """A pose in the frame of the grid: m, m, rad."""

    x: float
    y: float
    yaw: float


class Grid(NamedTuple):
    """Place of a costmap: outer corner of cell (0, 0) and side of a cell, in m."""

    x: float
    y: float
    resolution: float


class Cell(NamedTuple):
    """Row (along y) and column (along x) of a cell, which may lie off the grid."""

    row: int
    col: int


class Window(NamedTuple):
    """A block of cells, half open."""

    row: int
    end_row: int
    col: int
    end_col: int


class Line(NamedTuple):
    """A line of cells, one per step along its longer axis."""

    steps: int
    # Distance between the ends in cells.
    rows: int
    cols: int
    # Direction, +1 or -1.
    row_step: int
    col_step: int


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
def cell_at(grid: Grid, x: float, y: float) -> Cell:
    """Return the cell (row along y, column along x) of a point, also off the grid.

    Args:
        grid: Place of the costmap.
        x: Coordinate in m in the frame of the grid, as `y`.
        y: Coordinate in m.
    """
    # Floor, not the cast to int of C: points off the lower edges must not fall onto the
    # grid.
    row = math.floor((y - grid.y) / grid.resolution)
    col = math.floor((x - grid.x) / grid.resolution)
    return Cell(row, col)


@kernel
def is_on_grid(cell: Cell, shape: tuple[int, int]) -> bool:
    """Return whether a cell (row, column) lies on a grid of shape (rows, columns).

    Args:
        cell: Cell to look at.
        shape: Numbers of rows and columns of the grid.
    """
    return 0 <= cell.row < shape[0] and 0 <= cell.col < shape[1]


@kernel
def grow_window(window: Window, margin: int, shape: tuple[int, int]) -> Window:
    """Return a window enlarged by `margin` cells on each side, cut off at the grid.

    Args:
        window: Window to enlarge; it may reach beyond the grid.
        margin: Number of cells to add on each side; 0 only cuts off.
        shape: Numbers of rows and columns of the grid.
    """
    row = max(0, window.row - margin)
    end_row = min(shape[0], window.end_row + margin)
    col = max(0, window.col - margin)
    end_col = min(shape[1], window.end_col + margin)
    return Window(row, end_row, col, end_col)


@kernel
def line_between(start: Cell, end: Cell) -> tuple[Line, Cell]:
    """Return Bresenham's line between two cells, and the remainders for `next_cell`.

    Args:
        start: First cell.
        end: Last cell.
    """
    rows = abs(end.row - start.row)
    cols = abs(end.col - start.col)
    steps = max(rows, cols)
    row_step = 1 if end.row > start.row else -1
    col_step = 1 if end.col > start.col else -1
    line = Line(steps, rows, cols, row_step, col_step)

    # Half a step at the start rounds to the nearest cell.
    return line, Cell(steps // 2, steps // 2)


@kernel
def next_cell(cell: Cell, rest: Cell, line: Line) -> tuple[Cell, Cell]:
    """Return the cell one step further on a line, also beyond its end, and remainders.

    Args:
        cell: Present cell of the line.
        rest: Remainders of rows and columns at the present cell.
        line: Line to follow, from `line_between`.
    """
    row, col = cell
    # Remainders in whole cells: Bresenham's line needs no division.
    row_rest = rest.row + line.rows
    col_rest = rest.col + line.cols
    if row_rest >= line.steps:
        row_rest -= line.steps
        row += line.row_step
    if col_rest >= line.steps:
        col_rest -= line.steps
        col += line.col_step

    return Cell(row, col), Cell(row_rest, col_rest)


@kernel
def corners_at(outline: Points, pose: Pose) -> Points:
    """Return the corners (n, 2) in m of an outline at a pose, in the frame of the grid.

    Args:
        outline: Corners (n, 2) in base_link, in m.
        pose: Pose of base_link.

    Returns:
        Corners (n, 2) in the frame of the grid.
    """
    corners = np.empty_like(outline)
    place_corners(corners, pose.x, pose.y, pose.yaw, outline)
    return corners


@kernel
def place_corners(
    corners: Points, x: float, y: float, yaw: float, outline: Points
) -> None:
    """Write into `corners` those of an outline at a pose, in the frame of the grid.

    Args:
        corners: Array (n, 2) that receives the corners in the frame of the grid.
        x: Position of base_link in m in the frame of the grid, as `y`.
        y: Position of base_link in m.
        yaw: Heading in rad.
        outline: Corners (n, 2) in base_link, in m.
    """
    c = math.cos(yaw)
    s = math.sin(yaw)
    for k in range(len(outline)):
        # Without brackets: the position is added first, unlike in `obstacle_layer`.
        corners[k, 0] = x + c * outline[k, 0] - s * outline[k, 1]
        corners[k, 1] = y + s * outline[k, 0] + c * outline[k, 1]


@kernel
def footprint_cells(corners: Points, grid: Grid, shape: tuple[int, int]) -> Cells:
    """Return the cells (row, column) on the grid inside and under a convex outline.

    Args:
        corners: Corners (n, 2) in the frame of the grid, in m.
        grid: Place of the costmap.
        shape: Numbers of rows and columns of the costmap.

    Returns:
        Those of its cells (n, 2) that lie on the grid, column by column.
    """
    corner_cells = np.empty(corners.shape, np.int64)
    for k in range(len(corners)):
        corner_cells[k] = cell_at(grid, corners[k, 0], corners[k, 1])

    # A convex footprint fills each column between its outline's ends.
    # Lowest and highest row of the outline in each column.
    first = corner_cells[:, 1].min()
    width = corner_cells[:, 1].max() - first + 1
    low = np.full(width, corner_cells[:, 0].max())
    high = np.full(width, corner_cells[:, 0].min())
    for row, col in outline_cells(corner_cells):
        low[col - first] = min(low[col - first], row)
        high[col - first] = max(high[col - first], row)

    rows, cols = shape
    cells = np.empty(((high - low + 1).sum(), 2), np.int64)
    count = 0
    # Columns and rows off the grid are cut off, since the robot may stand at its edge.
    for k in range(max(0, -first), min(width, cols - first)):
        for row in range(max(0, low[k]), min(rows, high[k] + 1)):
            cells[count] = row, first + k
            count += 1

    return cells[:count]


@kernel
def outline_cells(corners: Cells) -> Cells:
    """Return the cells (n, 2), row and column, of the closed line through corner cells.

    Both ends of each line are included, so that corners appear twice.
    """
    lengths = 0
    for k in range(len(corners)):
        lengths += np.abs(corners[k] - corners[k - 1]).max() + 1

    cells = np.empty((lengths, 2), np.int64)
    count = 0
    for k in range(len(corners)):
        after = (k + 1) % len(corners)
        cell = Cell(corners[k, 0], corners[k, 1])
        line, rest = line_between(cell, Cell(corners[after, 0], corners[after, 1]))
        for _ in range(line.steps + 1):
            cells[count] = cell
            count += 1
            cell, rest = next_cell(cell, rest, line)

    return cells


@kernel
def line_cost(costs: Bytes, start: Cell, end: Cell, highest: int) -> int:
    """Return the highest cost on a line of cells, at least `highest`; -1 if lethal.

    Args:
        costs: Costs of the cells (rows, columns).
        start: First cell, on the grid.
        end: Last cell, on the grid.
        highest: Cost to begin with.

    Returns:
        The cost, -1 if a cell of the line is lethal.
    """
    line, rest = line_between(start, end)
    cell = start
    for _ in range(line.steps + 1):
        # Unsigned indices spare numba's check for negative ones.
        cost = costs[np.uint64(cell.row), np.uint64(cell.col)]
        highest = max(highest, cost)
        cell, rest = next_cell(cell, rest, line)

    return -1 if highest >= LETHAL else highest


@kernel
def edge_cost(costs: Bytes, corners: Points, grid: Grid) -> int:
    """Return the highest cost under a footprint's edges, -1 if lethal or off the grid.

    Follows base_local_planner's `CostmapModel::footprintCost` (costmap_model.cpp).

    Args:
        costs: Costs of the cells (rows, columns).
        corners: Corners (n, 2) of the footprint in the frame of the grid, in m.
        grid: Place of the costmap.

    Returns:
        The cost, -1 if the edges touch a lethal cell or leave the grid.
    """
    highest = 0
    for k in range(len(corners)):
        start = cell_at(grid, corners[k - 1, 0], corners[k - 1, 1])
        end = cell_at(grid, corners[k, 0], corners[k, 1])
        if not (is_on_grid(start, costs.shape) and is_on_grid(end, costs.shape)):
            return -1

        # Both corners on the grid are enough: the line between them cannot leave it.
        highest = line_cost(costs, start, end, highest)
        if highest < 0:
            return -1

    return highest


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
    """Set the lidar's mark of a cell and extend bounds; costs wait for `refresh`.

    Args:
        marks: Marks of the grid.
        cell: Cell on the grid.
    """
    if not marks.cells[cell.row, cell.col] & MARK:
        marks.cells[cell.row, cell.col] |= MARK
        touch(marks.bounds, cell)


@kernel
def clear_cell(marks: Marks, cell: Cell) -> None:
    """Clear the lidar's mark of a cell and extend bounds; a mark of the map stays.

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
    """Clear lidar marks on a line, at most `limit` cells beyond start; extend `bounds`.

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
