"""Compiled loops of the costmap: ray clearing, marking, footprints and inflation.

Layers are uint8 arrays [row, column], row along y. A cell of the lethal layer is 0 (free), MARK (seen by the lidar),
STATIC (from a map) or both. `dirty` is the changed window (first row, end row, first column, end column), half open;
it is empty if the end is not beyond the first.
"""

import math
from typing import NamedTuple

import numpy as np
from numba import njit

from barn_planners.costmap.inflation import refresh

MARK = np.uint8(1)
STATIC = np.uint8(2)
_KEEP_STATIC = np.uint8(2)
_WHOLE = 2**62


@njit(cache=True)
def touch(dirty, row, col):  # type: ignore[no-untyped-def]
    """Grow the dirty window by one cell."""
    dirty[0] = min(dirty[0], row)
    dirty[1] = max(dirty[1], row + 1)
    dirty[2] = min(dirty[2], col)
    dirty[3] = max(dirty[3], col + 1)


class Bresenham(NamedTuple):
    """A line of cells: its number of steps, rows and columns between its ends, and their signs."""

    steps: int
    rows: int
    cols: int
    row_step: int
    col_step: int


@njit(cache=True)
def line_between(row, col, end_row, end_col):  # type: ignore[no-untyped-def]
    """Return the line between two cells for `next_cell`, and what that starts with."""
    rows, cols = abs(end_row - row), abs(end_col - col)
    steps = max(rows, cols)
    line = Bresenham(
        steps, rows, cols, 1 if end_row > row else -1, 1 if end_col > col else -1
    )
    return line, (steps // 2, steps // 2)


@njit(cache=True)
def next_cell(row, col, rest, line):  # type: ignore[no-untyped-def]
    """Return row and column of the next cell of a line, and what to go on with."""
    rest_row, rest_col = rest
    rest_row, rest_col = rest_row + line.rows, rest_col + line.cols
    if rest_row >= line.steps:
        rest_row -= line.steps
        row += line.row_step
    if rest_col >= line.steps:
        rest_col -= line.steps
        col += line.col_step
    return row, col, (rest_row, rest_col)


@njit(cache=True)
def clear_cell(lethal, dirty, row, col):  # type: ignore[no-untyped-def]
    """Clear the mark of a cell on the grid."""
    # With unsigned indices numba skips its check for negative ones.
    if lethal[np.uint64(row), np.uint64(col)] & MARK:
        lethal[row, col] &= _KEEP_STATIC
        touch(dirty, row, col)


@njit(cache=True)
def _clear_line_to_edge(lethal, dirty, row, col, end_row, end_col):  # type: ignore[no-untyped-def]
    """Clear the marks along the line between two cells, both included, until it leaves the grid."""
    rows, cols = lethal.shape
    line, rest = line_between(row, col, end_row, end_col)
    for _ in range(line.steps + 1):
        if row < 0 or row >= rows or col < 0 or col >= cols:
            return
        clear_cell(lethal, dirty, row, col)
        row, col, rest = next_cell(row, col, rest, line)


@njit(cache=True)
def clear_line(cells, cols, dirty, row, col, end_row, end_col, most):  # type: ignore[no-untyped-def]
    """Clear the marks along the line between two cells, the first and at most as many more; cells: the layer, flat."""
    (steps, d_row, d_col, s_row, s_col), (rest, _) = line_between(
        row, col, end_row, end_col
    )
    along, across, d_across = s_row * cols, s_col, d_col
    if d_row < d_col:
        along, across, d_across = s_col, s_row * cols, d_row
    cell = row * cols + col
    for _ in range(min(steps, most) + 1):
        if cells[np.uint64(cell)] & MARK:
            cells[np.uint64(cell)] &= _KEEP_STATIC
            touch(dirty, cell // cols, cell % cols)
        rest += d_across
        cell += along
        if rest >= steps:
            rest -= steps
            cell += across


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
    ends,
    ranges,
    limits,
    outline,
):
    """Add a scan, clear the footprint (corners (n, 2), or none) at a pose (x, y, yaw), and inflate what changed."""
    add_scan(lethal, dirty, grid, sensor, directions, ends, ranges, limits)
    if len(outline) > 0:
        (x, y, yaw), (origin_x, origin_y, resolution) = pose, grid
        first, spans = footprint_spans(
            placed(outline, x, y, yaw), origin_x, origin_y, resolution
        )
        clear_spans(lethal, dirty, first, spans)
    refresh(lethal, costs, by_square, squares, dirty)


@njit(cache=True)
def point_beams(directions, yaw, angle_min, angle_increment):  # type: ignore[no-untyped-def]
    """Write cosine and sine of every beam of a lidar at this yaw, float64 (n, 2)."""
    for i in range(len(directions)):
        angle = yaw + angle_min + i * angle_increment
        directions[i, 0], directions[i, 1] = math.cos(angle), math.sin(angle)


@njit(cache=True)
def add_scan(lethal, dirty, grid, sensor, directions, ends, ranges, limits):  # type: ignore[no-untyped-def]
    """Clear along every beam with a return, the last cell included, then mark the hits nearer than the obstacle range.

    directions: as of `point_beams`; ends: work space, int64 (n, 2); limits: range_min and range_max of the scan,
    raytrace and obstacle range.
    """
    rows, cols = lethal.shape
    cells = lethal.reshape(rows * cols)
    range_min, range_max, raytrace_range, obstacle_range = limits
    sensor_x, sensor_y = sensor
    row, col = _cell(grid, sensor_x, sensor_y)
    inside = 0 <= row < rows and 0 <= col < cols
    last_row, last_col = row - 1, col - 1
    for i in range(len(ranges)):
        r = float(ranges[i])
        if not (range_min <= r < range_max):
            continue
        r = min(r, raytrace_range)
        end_row, end_col = _cell(
            grid, sensor_x + r * directions[i, 0], sensor_y + r * directions[i, 1]
        )
        ends[i, 0], ends[i, 1] = end_row, end_col
        if end_row == last_row and end_col == last_col:
            continue
        last_row, last_col = end_row, end_col
        if inside and 0 <= end_row < rows and 0 <= end_col < cols:
            clear_line(cells, cols, dirty, row, col, end_row, end_col, _WHOLE)
        else:
            _clear_line_to_edge(lethal, dirty, row, col, end_row, end_col)
    for i in range(len(ranges)):
        r = float(ranges[i])
        if not (range_min <= r < range_max) or r >= obstacle_range:
            continue
        row, col = ends[i, 0], ends[i, 1]
        if r > raytrace_range:
            row, col = _cell(
                grid, sensor_x + r * directions[i, 0], sensor_y + r * directions[i, 1]
            )
        if 0 <= row < rows and 0 <= col < cols and not lethal[row, col] & MARK:
            lethal[row, col] |= MARK
            touch(dirty, row, col)


@njit(cache=True)
def _cell(grid, x, y):  # type: ignore[no-untyped-def]
    origin_x, origin_y, resolution = grid
    return math.floor((y - origin_y) / resolution), math.floor(
        (x - origin_x) / resolution
    )


@njit(cache=True)
def placed(outline, x, y, yaw):  # type: ignore[no-untyped-def]
    """Return the corners (n, 2) of an outline (n, 2) in base_link at a pose."""
    corners = np.empty_like(outline)
    place_corners(corners, x, y, yaw, outline)
    return corners


@njit(cache=True)
def place_corners(corners, x, y, yaw, outline):  # type: ignore[no-untyped-def]
    """Write what `placed` returns to an array that is there already."""
    c, s = math.cos(yaw), math.sin(yaw)
    for k in range(len(outline)):
        corners[k, 0] = x + c * outline[k, 0] - s * outline[k, 1]
        corners[k, 1] = y + s * outline[k, 0] + c * outline[k, 1]


@njit(cache=True)
def footprint_spans(corners, origin_x, origin_y, resolution):  # type: ignore[no-untyped-def]
    """Return the first column of a convex footprint, and first and last row of each column (n, 2), not clipped."""
    cells = np.empty(corners.shape, np.int64)
    for k in range(len(corners)):
        cells[k, 0], cells[k, 1] = _cell(
            (origin_x, origin_y, resolution), corners[k, 0], corners[k, 1]
        )
    first = cells[:, 1].min()
    spans = np.empty((cells[:, 1].max() - first + 1, 2), np.int64)
    spans[:, 0], spans[:, 1] = np.iinfo(np.int64).max, np.iinfo(np.int64).min
    for row, col in outline_cells(cells):
        spans[col - first, 0], spans[col - first, 1] = (
            min(spans[col - first, 0], row),
            max(spans[col - first, 1], row),
        )
    return first, spans


@njit(cache=True)
def outline_cells(corners):  # type: ignore[no-untyped-def]
    """Return the cells (n, 2) along the lines from each corner to the next, both ends included."""
    count = len(corners)
    for k in range(len(corners)):
        count += max(
            abs(corners[k, 0] - corners[k - 1, 0]),
            abs(corners[k, 1] - corners[k - 1, 1]),
        )
    cells, at = np.empty((count, 2), np.int64), 0
    for k in range(len(corners)):
        row, col = corners[k]
        end_row, end_col = corners[(k + 1) % len(corners)]
        line, rest = line_between(row, col, end_row, end_col)
        for _ in range(line.steps + 1):
            cells[at, 0], cells[at, 1] = row, col
            at += 1
            row, col, rest = next_cell(row, col, rest, line)
    return cells


@njit(cache=True)
def edge_cost(costs, corners, origin_x, origin_y, resolution):  # type: ignore[no-untyped-def]
    """Return the highest cost along a footprint's edges, -1 if they touch a lethal cell or leave the grid."""
    (rows, cols), grid, highest = costs.shape, (origin_x, origin_y, resolution), 0
    for k in range(len(corners)):
        row, col = _cell(grid, corners[k - 1, 0], corners[k - 1, 1])
        end_row, end_col = _cell(grid, corners[k, 0], corners[k, 1])
        if (
            min(row, col, end_row, end_col) < 0
            or max(row, end_row) >= rows
            or max(col, end_col) >= cols
        ):
            return -1
        line, rest = line_between(row, col, end_row, end_col)
        for _ in range(line.steps + 1):
            cost = costs[np.uint64(row), np.uint64(col)]
            if cost >= 254:
                return -1
            highest = max(highest, cost)
            row, col, rest = next_cell(row, col, rest, line)
    return highest


@njit(cache=True)
def clear_spans(lethal, dirty, first, spans):  # type: ignore[no-untyped-def]
    """Clear the marks inside a footprint given by `footprint_spans`."""
    rows, cols = lethal.shape
    for k in range(len(spans)):
        col = first + k
        if col < 0 or col >= cols:
            continue
        for row in range(max(0, spans[k, 0]), min(rows, spans[k, 1] + 1)):
            clear_cell(lethal, dirty, row, col)


@njit(cache=True)
def clear_outside(lethal, dirty, row_lo, row_hi, col_lo, col_hi):  # type: ignore[no-untyped-def]
    """Clear the marks outside a window of rows [row_lo, row_hi) and columns [col_lo, col_hi)."""
    rows, cols = lethal.shape
    for row in range(rows):
        for col in range(cols):
            inside = row_lo <= row < row_hi and col_lo <= col < col_hi
            if not inside:
                clear_cell(lethal, dirty, row, col)
