"""Inflation of a costmap's obstacles: costs by the distance to the nearest lethal cell.

`inflate` computes exact distances. `inflate_by_front` repeats costmap_2d's inflation
layer (plugins/inflation_layer.cpp), which approximates them.
"""

import math
from typing import NamedTuple

import numpy as np
import numpy.typing as npt

from barn_planners.costmap.config import CostmapConfig
from barn_planners.costmap.kernels import (
    INSCRIBED,
    LETHAL,
    Cell,
    Marks,
    Window,
    grow_window,
    is_on_grid,
)
from barn_worlds.base.arrays import Bytes, Integers, MediumIntegers, kernel

_MAX_BOXES = 32
_BAND_ROWS = 64  # so many rows fit into the processor's cache
_NO_BOUNDS = (np.iinfo(np.int64).max, 0, np.iinfo(np.int64).max, 0)

Squares = npt.NDArray[np.unsignedinteger]


class Layers(NamedTuple):
    """Obstacles and costs of a grid, and what inflation needs to know of the robot."""

    marks: Marks
    costs: Bytes  # (rows, columns), 254 exactly where a cell is marked
    # Cost by the square of the distance in cells, ((n + 1)^2 + n^2 + 1,) where n is the
    # reach of inflation in cells; 0 from (n + 1)^2 on.
    by_square: Bytes
    # Squares of 0 to n + 1, in an unsigned type that holds twice the last one. The
    # smaller the type is, the more cells a vectorized loop takes at once.
    squares: Squares


class _Front(NamedTuple):
    """Cells that wait for a front, in a linked list for each square of the distance."""

    # Of each entry: row and column of the cell, row and column of the lethal cell that
    # its front comes from, next entry of the list or -1.
    entries: MediumIntegers
    # First and last entry of each list, -1 if it is empty.
    first: MediumIntegers
    last: MediumIntegers


def costs_by_square(config: CostmapConfig, resolution: float) -> Bytes:
    """Return a table of costs by squared distance in cells to the nearest lethal cell.

    Follows costmap_2d's `InflationLayer::computeCost` (inflation_layer.h): 254 at 0,
    253 up to the inscribed radius r, then int(252 exp(-scaling (d - r))) at distance d
    up to the inflation radius.

    Args:
        config: Radii and scaling.
        resolution: Side of a cell in m.

    Returns:
        Costs ((n + 1)^2 + n^2 + 1,) by the square in cells, where n is the reach of
        inflation in cells.
    """
    # 1e-9 keeps rounding from moving a radius that is a whole number of cells.
    soft_reach = 0
    if config.soft_costs:
        soft_reach = math.ceil(config.inflation_radius_m / resolution - 1e-9)
    reach = max(soft_reach, math.floor(config.inscribed_m / resolution + 1e-9))

    costs = np.zeros((reach + 1) ** 2 + reach**2 + 1, np.uint8)
    for row, col in np.ndindex(reach + 1, reach + 1):
        cells = math.hypot(row, col)
        beyond_m = cells * resolution - config.inscribed_m
        if beyond_m <= 1e-9:
            costs[row**2 + col**2] = INSCRIBED
        elif cells <= soft_reach:
            decay = math.exp(-config.cost_scaling_per_m * beyond_m)
            costs[row**2 + col**2] = int(252.0 * decay)

    costs[0] = LETHAL
    return costs


def new_layers(rows: int, cols: int, by_square: Bytes) -> Layers:
    """Return empty marks, zero costs and inflation's tables for a grid, rows along y.

    Args:
        rows: Number of rows.
        cols: Number of columns.
        by_square: Costs from `costs_by_square`.
    """
    # The length of the costs, (n + 1)^2 + n^2 + 1, gives the reach n back.
    reach = math.isqrt((len(by_square) - 1) // 2)
    squares: Squares = np.arange(reach + 2, dtype=np.uint32) ** 2
    if 2 * squares[-1] <= np.iinfo(np.uint16).max:
        squares = squares.astype(np.uint16)

    cells = np.zeros((rows, cols), np.uint8)
    marks = Marks(cells, np.array(_NO_BOUNDS))
    return Layers(marks, np.zeros_like(cells), by_square, squares)


@kernel
def shift(layers: Layers, d_row: int, d_col: int) -> None:
    """Shift marks and costs in place: cell (i, j) gets what (i + d_row, j + d_col) had.

    Cells that come in are free; costs near the edges are recomputed.

    Args:
        layers: Layers to change in place; their costs must be up to date.
        d_row: Rows by which the grid moves.
        d_col: Columns by which the grid moves.
    """
    rows, cols = layers.costs.shape
    _shift_cells(layers.marks.cells, d_row, d_col)
    _shift_cells(layers.costs, d_row, d_col)

    # Inflation from what has left the grid ends, and reaches into what has come in.
    reach = len(layers.squares) - 2
    if d_row != 0:
        for row, end_row in _edge_strips(rows, d_row, reach):
            _inflate_strip(layers, Window(row, end_row, 0, cols))
    if d_col != 0:
        for col, end_col in _edge_strips(cols, d_col, reach):
            _inflate_strip(layers, Window(0, rows, col, end_col))


@kernel
def _shift_cells(layer: Bytes, d_row: int, d_col: int) -> None:
    """Move the cells of one layer as `shift` does, in place; what comes in is 0."""
    rows, cols = layer.shape
    if abs(d_row) >= rows or abs(d_col) >= cols:
        layer[:] = 0
        return

    # All cells move by one step on a flat grid. Loops over rows would take longer.
    step = d_row * cols + d_col
    cells = layer.reshape(layer.size)
    source = cells.copy()[max(0, step) :]
    target = cells[max(0, -step) :]
    for k in range(layer.size - abs(step)):
        target[k] = source[k]

    # The step carries cells across the edges, so what has come in is cleared last.
    layer[max(0, rows - d_row) :] = 0
    layer[: max(0, -d_row)] = 0
    layer[:, max(0, cols - d_col) :] = 0
    layer[:, : max(0, -d_col)] = 0


@kernel
def _inflate_strip(layers: Layers, strip: Window) -> None:
    """Recompute the costs in a strip, cut off at the grid, unless all near it are 0."""
    costs = layers.costs
    near = grow_window(strip, len(layers.squares) - 2, costs.shape)
    # Most edges are far from what the lidar sees.
    if costs[near.row : near.end_row, near.col : near.end_col].any():
        inflate(layers, grow_window(strip, 0, costs.shape))


@kernel
def _edge_strips(
    count: int, step: int, reach: int
) -> tuple[tuple[int, int], tuple[int, int]]:
    """Return the half-open ranges of rows (or columns) at both edges to inflate.

    The grid has `count` of them and has moved by `step`; inflation reaches `reach`.
    """
    if step > 0:
        return (0, reach), (count - step, count)
    return (count - reach, count), (0, -step)


@kernel
def refresh(layers: Layers, by_front: bool) -> None:
    """Recompute costs near changed marks, then empty the bounds of what has changed.

    Args:
        layers: Layers to change in place.
        by_front: Whether costs come from costmap_2d's front, not from exact distances.
    """
    bounds = layers.marks.bounds
    if bounds[1] <= bounds[0]:
        return

    reach = len(layers.squares) - 2
    boxes = np.empty((_MAX_BOXES, 4), np.int64)
    # A changed cell changes costs within the reach, so boxes twice as far apart do not
    # share any.
    for k in range(_find_changes(layers, boxes, 2 * reach)):
        box = Window(boxes[k, 0], boxes[k, 1], boxes[k, 2], boxes[k, 3])
        window = grow_window(box, reach, layers.costs.shape)
        if by_front:
            inflate_by_front(layers, window)
        else:
            inflate(layers, window)

    for k in range(4):
        bounds[k] = _NO_BOUNDS[k]


@kernel
def _find_changes(layers: Layers, boxes: Integers, distance: int) -> int:
    """Write half-open boxes around changed cells; return how many, 1 if too many.

    These became or ceased to be lethal. Boxes lie at least `distance` cells apart. If
    they are too many, one covers the bounds.
    """
    bounds = layers.marks.bounds
    count = 0
    for row in range(bounds[0], bounds[1]):
        marks = layers.marks.cells[row, bounds[2] : bounds[3]]
        costs = layers.costs[row, bounds[2] : bounds[3]]

        # Most rows have not changed, which this loop without a branch tells quickly.
        is_different = False
        for k in range(len(marks)):
            is_different |= (marks[k] != 0) != (costs[k] == LETHAL)
        if not is_different:
            continue

        for k in range(len(marks)):
            if (marks[k] != 0) != (costs[k] == LETHAL):
                count = _add_to_boxes(boxes, count, row, bounds[2] + k, distance)
                if count > len(boxes):
                    boxes[0] = bounds
                    return 1

    return count


@kernel
def _add_to_boxes(
    boxes: Integers, count: int, row: int, col: int, distance: int
) -> int:
    """Extend the first near box by a cell or add one; return the count, plus 1 if full.

    Near is within `distance` cells. The count is one more than there is room for if the
    cell needs a box.
    """
    for k in range(count):
        box = boxes[k]
        if (
            box[0] - distance <= row < box[1] + distance
            and box[2] - distance <= col < box[3] + distance
        ):
            box[0] = min(box[0], row)
            box[1] = max(box[1], row + 1)
            box[2] = min(box[2], col)
            box[3] = max(box[3], col + 1)
            return count

    if count < len(boxes):
        boxes[count, 0] = row
        boxes[count, 1] = row + 1
        boxes[count, 2] = col
        boxes[count, 3] = col + 1
    return count + 1


@kernel
def inflate(layers: Layers, window: Window) -> None:
    """Recompute the costs of a window by exact distances to the nearest lethal cell.

    The square of the distance is the least sum of two squares, so it takes one pass
    along the columns and one along the rows.

    Args:
        layers: Layers; their costs change in place.
        window: Cells of the grid to recompute.
    """
    squares = layers.squares
    reach = len(squares) - 2
    width = window.end_col - window.col + 2 * reach
    band = min(_BAND_ROWS, window.end_row - window.row)
    seeds = np.empty((band + 2 * reach, width), squares.dtype)
    upright = np.empty(band * width, squares.dtype)
    nearest = np.empty(band * width, squares.dtype)
    # Bands of rows keep the three arrays in the processor's cache.
    for first in range(window.row, window.end_row, _BAND_ROWS):
        count = min(band, window.end_row - first)
        used = seeds[: count + 2 * reach]
        _seed(layers.marks.cells, used, first - reach, window.col - reach, squares[-1])
        _spread(seeds.reshape(seeds.size), upright[: count * width], width, squares)
        _spread(upright, nearest[: count * width - 2 * reach], 1, squares)
        for row in range(count):
            costs = layers.costs[first + row, window.col : window.end_col]
            distances = nearest[row * width : (row + 1) * width]
            for col in range(len(costs)):
                costs[col] = layers.by_square[distances[col]]


@kernel
def _seed(
    marks: Bytes, seeds: Squares, first_row: int, first_col: int, far: int
) -> None:
    """Write 0 into `seeds` where a cell is marked, else `far`, also off the grid.

    The first of the seeds is that of the cell (first_row, first_col).
    """
    rows, cols = marks.shape
    end_row = first_row + seeds.shape[0]
    col = max(0, first_col)
    end_col = min(cols, first_col + seeds.shape[1])
    # Only where the window reaches beyond the grid is there anything to fill in.
    if first_row < 0 or end_row > rows or end_col - col < seeds.shape[1]:
        seeds[:] = far
    for row in range(max(0, first_row), min(rows, end_row)):
        source = marks[row, col:end_col]
        target = seeds[row - first_row, col - first_col : end_col - first_col]
        for k in range(len(source)):
            target[k] = 0 if source[k] else far


@kernel
def _spread(source: Squares, nearest: Squares, stride: int, squares: Squares) -> None:
    """Write the least of a neighbor's value plus squared distance, up to the reach.

    Offsets count in strides of the flat source; nearest[0] belongs to
    source[n * stride].
    """
    reach = len(squares) - 2
    center = source[reach * stride :]
    for k in range(len(nearest)):
        nearest[k] = center[k]
    for offset in range(1, reach + 1):
        square = squares[offset]
        before = source[(reach - offset) * stride :]
        after = source[(reach + offset) * stride :]
        for k in range(len(nearest)):
            # In the type of the squares, or numba would widen the whole loop.
            distance = squares.dtype.type(min(before[k], after[k]) + square)
            nearest[k] = min(nearest[k], distance)


@kernel
def inflate_by_front(layers: Layers, window: Window) -> None:
    """Recompute the costs of a window by costmap_2d's front, not by exact distances.

    Follows costmap_2d's `InflationLayer::updateCosts`. A cell gets the cost of the
    distance to the lethal cell whose front comes first. That is not the nearest one
    where other fronts bar its way. Of equal distances the first in the queue counts;
    lethal cells enter it row by row.

    Args:
        layers: Layers; their costs change in place.
        window: Cells of the grid to recompute.
    """
    marks = layers.marks.cells
    costs = layers.costs
    reach = len(layers.squares) - 2
    area = grow_window(window, reach, costs.shape)
    height = area.end_row - area.row
    width = area.end_col - area.col

    # The least square with which a cell waits or the front has taken it.
    end_square = reach * reach + 1
    nearest = np.full((height, width), end_square, np.int32)
    front = _Front(
        np.empty((5 * height * width, 5), np.int32),
        np.full(end_square, -1, np.int32),
        np.full(end_square, -1, np.int32),
    )
    count = 0
    for row in range(height):
        for col in range(width):
            if marks[area.row + row, area.col + col]:
                nearest[row, col] = 0
                count = _append(front, count, 0, Cell(row, col), Cell(row, col))

    entries = front.entries
    costs[window.row : window.end_row, window.col : window.end_col] = 0
    for square in range(end_square):
        entry = front.first[square]
        while entry >= 0:
            row, col, source_row, source_col, _ = entries[entry]

            # A shorter distance may have come up while the cell waited.
            if nearest[row, col] == square:
                grid_row = area.row + row
                grid_col = area.col + col
                inside_rows = window.row <= grid_row < window.end_row
                if inside_rows and window.col <= grid_col < window.end_col:
                    costs[grid_row, grid_col] = layers.by_square[square]

                cell = Cell(row, col)
                source = Cell(source_row, source_col)
                count = _reach_neighbors(front, count, nearest, cell, source)

            # The last cell of the list has a next one if a neighbor has joined it.
            entry = entries[entry, 4]


@kernel
def _reach_neighbors(
    front: _Front, count: int, nearest: MediumIntegers, cell: Cell, source: Cell
) -> int:
    """Append those of 4 neighbors that `source` is nearest to; return the new count."""
    square = nearest[cell.row, cell.col]
    for d_row, d_col in ((0, -1), (-1, 0), (0, 1), (1, 0)):
        side = Cell(cell.row + d_row, cell.col + d_col)
        if not is_on_grid(side, nearest.shape):
            continue

        # The front never goes back, and of equal distances the first one counts.
        away = (side.row - source.row) ** 2 + (side.col - source.col) ** 2
        if square <= away < nearest[side.row, side.col]:
            nearest[side.row, side.col] = away
            count = _append(front, count, away, side, source)

    return count


@kernel
def _append(front: _Front, count: int, square: int, cell: Cell, source: Cell) -> int:
    """Append a cell to the front's list of a squared distance; return the new count."""
    entries, first, last = front
    entries[count, 0] = cell.row
    entries[count, 1] = cell.col
    entries[count, 2] = source.row
    entries[count, 3] = source.col
    entries[count, 4] = -1
    if first[square] < 0:
        first[square] = count
    else:
        entries[last[square], 4] = count
    last[square] = count
    return count + 1
