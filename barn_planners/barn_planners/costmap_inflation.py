"""Compiled loops of a costmap's inflation: where marks have changed, and when a grid moves with the robot.

Layers and `dirty` are those of `costmap_kernels`. costs: uint8 [row, column], the highest where the cell is lethal.
by_square: uint8 ((n + 1)^2 + n^2 + 1,), the cost by the square of the distance in cells to the nearest lethal cell; 0
from (n + 1)^2 on. gaps: float32 (rows, columns) work space.
"""

import math

import numpy as np
from numba import njit

_MOST_BOXES = 32


@njit(cache=True)
def refresh(lethal, costs, by_square, gaps, dirty):  # type: ignore[no-untyped-def]
    """Bring costs up to date where cells of the dirty window became or ceased to be lethal, and empty the window.

    A scan clears most marks and sets them again, so that few cells of the window have changed in the end.
    """
    if dirty[1] <= dirty[0]:
        return
    rows, cols = lethal.shape
    reach = _reach(by_square)
    boxes = np.empty((_MOST_BOXES, 4), np.int64)
    for k in range(_changed_boxes(lethal, costs, dirty, by_square[0], reach, boxes)):
        row_lo, row_hi = max(0, boxes[k, 0] - reach), min(rows, boxes[k, 1] + reach)
        inflate(lethal, costs, by_square, gaps, row_lo, row_hi, max(0, boxes[k, 2] - reach), min(cols, boxes[k, 3] + reach))
    far = np.iinfo(np.int64).max
    dirty[0], dirty[1], dirty[2], dirty[3] = far, 0, far, 0


@njit(cache=True)
def _reach(by_square):  # type: ignore[no-untyped-def]
    """Return how many cells an obstacle's costs reach."""
    return int(math.sqrt((len(by_square) - 1) / 2))


@njit(cache=True)
def _changed_boxes(lethal, costs, dirty, highest, near, boxes):  # type: ignore[no-untyped-def]
    """Find the cells of the dirty window whose cost does not tell whether they are lethal; return how many boxes.

    A box is a window as `dirty`. A cell joins the first box of which it is at most `near` cells off; all cells make
    one box where there would be too many.
    """
    count = 0
    for row in range(dirty[0], dirty[1]):
        marked, cost = lethal[row, dirty[2] : dirty[3]], costs[row, dirty[2] : dirty[3]]
        changed = False
        for col in range(len(marked)):
            changed |= (marked[col] != 0) != (cost[col] == highest)
        if not changed:
            continue
        for k in range(len(marked)):
            if (marked[k] != 0) != (cost[k] == highest):
                count = _join(boxes, count, row, dirty[2] + k, near)
                if count > len(boxes):
                    boxes[0] = dirty
                    return 1
    return count


@njit(cache=True)
def _join(boxes, count, row, col, near):  # type: ignore[no-untyped-def]
    """Add a cell to the first box near by, or a new one where there is room; return their number with it."""
    for k in range(count):
        box = boxes[k]
        if box[0] - near <= row < box[1] + near and box[2] - near <= col < box[3] + near:
            box[0], box[1] = min(box[0], row), max(box[1], row + 1)
            box[2], box[3] = min(box[2], col), max(box[3], col + 1)
            return count
    if count < len(boxes):
        boxes[count, 0], boxes[count, 1], boxes[count, 2], boxes[count, 3] = row, row + 1, col, col + 1
    return count + 1


@njit(cache=True)
def shift(lethal, costs, by_square, gaps, d_row, d_col):  # type: ignore[no-untyped-def]
    """Move a grid: cell (i, j) gets what was in (i + d_row, j + d_col), nothing where that was off the grid.

    Only costs beside the edges can change by that, and they are recomputed where there are any.
    """
    rows, cols = lethal.shape
    _move(lethal, d_row, d_col)
    _move(costs, d_row, d_col)
    reach = _reach(by_square)
    if d_row != 0:
        for low, high in ((0, reach), (rows - d_row, rows)) if d_row > 0 else ((rows - reach, rows), (0, -d_row)):
            _inflate_strip(lethal, costs, by_square, gaps, low, high, 0, cols)
    if d_col != 0:
        for low, high in ((0, reach), (cols - d_col, cols)) if d_col > 0 else ((cols - reach, cols), (0, -d_col)):
            _inflate_strip(lethal, costs, by_square, gaps, 0, rows, low, high)


@njit(cache=True)
def _inflate_strip(lethal, costs, by_square, gaps, row_lo, row_hi, col_lo, col_hi):  # type: ignore[no-untyped-def]
    """Recompute the costs of a window, which may extend beyond the grid, if there are costs in it or near it."""
    rows, cols = costs.shape
    reach = _reach(by_square)
    near = costs[max(0, row_lo - reach) : row_hi + reach, max(0, col_lo - reach) : col_hi + reach]
    if near.any():
        inflate(lethal, costs, by_square, gaps, max(0, row_lo), min(rows, row_hi), max(0, col_lo), min(cols, col_hi))


@njit(cache=True)
def _move(layer, d_row, d_col):  # type: ignore[no-untyped-def]
    """Move the cells of a layer as `shift` does, in place."""
    rows, cols = layer.shape
    if abs(d_row) >= rows or abs(d_col) >= cols:
        layer[:] = 0
        return
    cells, step = layer.reshape(rows * cols), d_row * cols + d_col
    if step > 0:
        for k in range(len(cells) - step):
            cells[k] = cells[k + step]
    else:
        for k in range(len(cells) - 1, -step - 1, -1):
            cells[k] = cells[k + step]
    if d_row > 0:
        layer[rows - d_row :] = 0
    else:
        layer[:-d_row] = 0
    if d_col > 0:
        layer[:, cols - d_col :] = 0
    else:
        layer[:, :-d_col] = 0


@njit(cache=True)
def inflate(lethal, costs, by_square, gaps, row_lo, row_hi, col_lo, col_hi):  # type: ignore[no-untyped-def]
    """Recompute the costs of a window: each cell gets the cost of its distance to the nearest lethal cell.

    by_square: uint8 ((n + 1)^2 + n^2 + 1,), the cost by the square of that distance in cells; 0 from (n + 1)^2 on.
    Lethal cells up to n outside the window count.
    gaps: float32 (rows, columns) work space. In single precision the inner loops take eight cells at once.
    """
    rows, cols = lethal.shape
    reach = _reach(by_square)
    first_row, end_row = max(0, row_lo - reach), min(rows, row_hi + reach)
    first_col, end_col = max(0, col_lo - reach), min(cols, col_hi + reach)
    _column_gaps(lethal, gaps, reach, first_row, end_row, first_col, end_col)
    width, start = col_hi - col_lo, reach - (col_lo - first_col)
    padded = -(-width // 32) * 32  # so that no loop ends with single cells
    squares = np.full(padded + 2 * reach, np.float32((reach + 1) ** 2), np.float32)
    nearest = np.empty(padded, np.float32)
    for row in range(row_lo, row_hi):
        gap, square = gaps[row, first_col:end_col], squares[start : start + end_col - first_col]
        for col in range(len(gap)):
            square[col] = gap[col] * gap[col]
        for col in range(padded):
            nearest[col] = squares[reach + col]
        for offset in range(1, reach + 1):
            apart = np.float32(offset * offset)
            left, right = squares[reach - offset : reach - offset + padded], squares[reach + offset :]
            for col in range(padded):
                nearest[col] = min(nearest[col], min(left[col], right[col]) + apart)
        line = costs[row, col_lo:col_hi]
        for col in range(width):
            line[col] = by_square[np.uint64(np.int32(nearest[col]))]


@njit(cache=True)
def _column_gaps(lethal, gaps, reach, first_row, end_row, first_col, end_col):  # type: ignore[no-untyped-def]
    """Write the distance in cells to the nearest lethal cell of the column, at most reach + 1, within a window."""
    zero, one, far = np.float32(0), np.float32(1), np.float32(reach + 1)
    width = end_col - first_col
    gaps[first_row, first_col:end_col] = far
    for row in range(first_row, end_row):
        marked, here = lethal[row, first_col:end_col], gaps[row, first_col:end_col]
        above = gaps[max(row - 1, first_row), first_col:end_col]
        for col in range(width):
            here[col] = zero if marked[col] else min(above[col] + one, far)
    for row in range(end_row - 2, first_row - 1, -1):
        here, below = gaps[row, first_col:end_col], gaps[row + 1, first_col:end_col]
        for col in range(width):
            here[col] = min(here[col], below[col] + one)
