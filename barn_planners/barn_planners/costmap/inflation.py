"""Compiled loops of a costmap's inflation: where marks have changed, and when a grid moves with the robot.

Layers and `dirty` are those of `kernels`. costs: uint8 [row, column], the highest where the cell is lethal.
by_square: uint8 ((n + 1)^2 + n^2 + 1,), the cost by the square of the distance in cells to the nearest lethal cell; 0
from (n + 1)^2 on. squares: (n + 2,), those of 0 to n + 1, in an unsigned type that holds twice the last one.
"""

import numpy as np
from numba import njit

_MOST_BOXES = 32
_BAND = 64  # rows, which a cache holds


@njit(cache=True)
def refresh(lethal, costs, by_square, squares, dirty, by_front=False):  # type: ignore[no-untyped-def]
    """Bring costs up to date where cells of the dirty window became or ceased to be lethal, and empty the window."""
    if dirty[1] <= dirty[0]:
        return
    rows, cols = lethal.shape
    reach = len(squares) - 2
    boxes = np.empty((_MOST_BOXES, 4), np.int64)
    for k in range(
        _changed_boxes(lethal, costs, dirty, by_square[0], 2 * reach, boxes)
    ):
        row_lo, row_hi = max(0, boxes[k, 0] - reach), min(rows, boxes[k, 1] + reach)
        col_lo, col_hi = max(0, boxes[k, 2] - reach), min(cols, boxes[k, 3] + reach)
        if by_front:
            inflate_by_front(
                lethal, costs, by_square, squares, row_lo, row_hi, col_lo, col_hi
            )
        else:
            inflate(lethal, costs, by_square, squares, row_lo, row_hi, col_lo, col_hi)
    far = np.iinfo(np.int64).max
    dirty[0], dirty[1], dirty[2], dirty[3] = far, 0, far, 0


@njit(cache=True)
def _changed_boxes(lethal, costs, dirty, highest, near, boxes):  # type: ignore[no-untyped-def]
    """Find boxes (windows as `dirty`, `near` apart) of cells that changed; return how many, one if too many."""
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
        if (
            box[0] - near <= row < box[1] + near
            and box[2] - near <= col < box[3] + near
        ):
            box[0], box[1] = min(box[0], row), max(box[1], row + 1)
            box[2], box[3] = min(box[2], col), max(box[3], col + 1)
            return count
    if count < len(boxes):
        boxes[count, 0], boxes[count, 1], boxes[count, 2], boxes[count, 3] = (
            row,
            row + 1,
            col,
            col + 1,
        )
    return count + 1


@njit(cache=True)
def shift(lethal, costs, by_square, squares, d_row, d_col):  # type: ignore[no-untyped-def]
    """Move a grid: cell (i, j) gets what was in (i + d_row, j + d_col); costs beside the edges are recomputed."""
    rows, cols = lethal.shape
    _move(lethal, d_row, d_col)
    _move(costs, d_row, d_col)
    reach = len(squares) - 2
    if d_row != 0:
        for low, high in (
            ((0, reach), (rows - d_row, rows))
            if d_row > 0
            else ((rows - reach, rows), (0, -d_row))
        ):
            _inflate_strip(lethal, costs, by_square, squares, low, high, 0, cols)
    if d_col != 0:
        for low, high in (
            ((0, reach), (cols - d_col, cols))
            if d_col > 0
            else ((cols - reach, cols), (0, -d_col))
        ):
            _inflate_strip(lethal, costs, by_square, squares, 0, rows, low, high)


@njit(cache=True)
def _inflate_strip(lethal, costs, by_square, squares, row_lo, row_hi, col_lo, col_hi):  # type: ignore[no-untyped-def]
    """Recompute the costs of a window, which may extend beyond the grid, where costs are near."""
    rows, cols = costs.shape
    reach = len(squares) - 2
    top, bottom, left, right = rows, -1, cols, -1
    for row in range(max(0, row_lo - reach), min(rows, row_hi + reach)):
        for col in range(max(0, col_lo - reach), min(cols, col_hi + reach)):
            if costs[row, col]:
                top, bottom, left, right = (
                    min(top, row),
                    row,
                    min(left, col),
                    max(right, col),
                )
    row_lo, row_hi = max(0, row_lo, top - reach), min(rows, row_hi, bottom + reach + 1)
    col_lo, col_hi = max(0, col_lo, left - reach), min(cols, col_hi, right + reach + 1)
    if row_lo < row_hi and col_lo < col_hi:
        inflate(lethal, costs, by_square, squares, row_lo, row_hi, col_lo, col_hi)


@njit(cache=True)
def _move(layer, d_row, d_col):  # type: ignore[no-untyped-def]
    """Move the cells of a layer as `shift` does, in place."""
    rows, cols = layer.shape
    if abs(d_row) >= rows or abs(d_col) >= cols:
        layer[:] = 0
        return
    cells, before, step = (
        layer.reshape(rows * cols),
        layer.copy().reshape(rows * cols),
        d_row * cols + d_col,
    )
    source, target = (before[step:], cells) if step > 0 else (before, cells[-step:])
    for k in range(len(cells) - abs(step)):
        target[k] = source[k]
    if d_row > 0:
        layer[rows - d_row :] = 0
    else:
        layer[:-d_row] = 0
    if d_col > 0:
        layer[:, cols - d_col :] = 0
    else:
        layer[:, :-d_col] = 0


@njit(cache=True)
def inflate(lethal, costs, by_square, squares, row_lo, row_hi, col_lo, col_hi):  # type: ignore[no-untyped-def]
    """Recompute the costs of a window by the distance of each cell to the nearest lethal one, in long lines."""
    reach = len(squares) - 2
    width = col_hi - col_lo + 2 * reach
    band = min(_BAND, row_hi - row_lo)
    marks = np.empty((band + 2 * reach, width), squares.dtype)
    upright, nearest = (
        np.empty(band * width, squares.dtype),
        np.empty(band * width, squares.dtype),
    )
    for first in range(row_lo, row_hi, band):
        count = min(band, row_hi - first)
        _copy_marks(
            lethal,
            marks,
            first - reach,
            first + count + reach,
            col_lo - reach,
            squares[reach + 1],
        )
        _spread(marks.reshape(marks.size), upright[: count * width], width, squares)
        _spread(upright, nearest[: count * width - 2 * reach], 1, squares)
        for row in range(count):
            line, found = (
                costs[first + row, col_lo:col_hi],
                nearest[row * width : (row + 1) * width],
            )
            for col in range(len(line)):
                line[col] = by_square[found[col]]


@njit(cache=True)
def _copy_marks(lethal, marks, row_lo, row_hi, col_lo, far):  # type: ignore[no-untyped-def]
    """Write 0 where a cell is lethal, else `far`, also off the grid; the first cell of `marks` is (row_lo, col_lo)."""
    rows, cols = lethal.shape
    first, end = max(0, col_lo), min(cols, col_lo + marks.shape[1])
    if row_lo < 0 or row_hi > rows or end - first < marks.shape[1]:
        marks[:] = far
    for row in range(max(0, row_lo), min(rows, row_hi)):
        seen, mark = (
            lethal[row, first:end],
            marks[row - row_lo, first - col_lo : end - col_lo],
        )
        for col in range(len(seen)):
            mark[col] = 0 if seen[col] else far


@njit(cache=True)
def _spread(found, nearest, apart, squares):  # type: ignore[no-untyped-def]
    """Write the least of square plus squared offset, up to n to both sides; nearest[0] is for found[n * apart]."""
    reach = len(squares) - 2
    centre = found[reach * apart :]
    for k in range(len(nearest)):
        nearest[k] = centre[k]
    for offset in range(1, reach + 1):
        more = squares[offset]
        before, after = (
            found[(reach - offset) * apart :],
            found[(reach + offset) * apart :],
        )
        for k in range(len(nearest)):
            # In the type of the squares, so that the loop takes as many cells at once as possible.
            here = squares.dtype.type(min(before[k], after[k]) + more)
            nearest[k] = min(nearest[k], here)


@njit(cache=True)
def inflate_by_front(lethal, costs, by_square, squares, row_lo, row_hi, col_lo, col_hi):  # type: ignore[no-untyped-def]
    """Recompute the costs of a window as costmap_2d does: by a front that spreads from lethal cells to neighbours.

    A cell gets the cost of the distance to the lethal cell whose front reaches it first, which is not the nearest where
    that one's way is barred. Equals are taken in the order in which they were reached, lethal ones row by row.
    """
    (rows, cols), reach = lethal.shape, len(squares) - 2
    top, left = max(0, row_lo - reach), max(0, col_lo - reach)
    bottom, right = min(rows, row_hi + reach), min(cols, col_hi + reach)
    height, width, ends = bottom - top, right - left, reach * reach + 1
    nearest = np.full(
        height * width, ends, np.int32
    )  # the square with which a cell waits or was taken
    queue = (
        np.empty((5 * height * width, 3), np.int32),
        np.full(ends, -1, np.int32),
        np.full(ends, -1, np.int32),
    )
    count = 0
    for row in range(top, bottom):
        marks = lethal[row, left:right]
        for col in range(width):
            if marks[col]:
                cell = (row - top) * width + col
                nearest[cell] = 0
                count = _append(queue, count, 0, cell, cell)
    costs[row_lo:row_hi, col_lo:col_hi] = 0
    cells, first, _ = queue
    for square in range(ends):
        at = first[square]
        while at >= 0:
            cell, source = np.int64(cells[at, 0]), np.int64(cells[at, 1])
            if nearest[cell] == square:
                row, col, from_row, from_col = (
                    cell // width,
                    cell % width,
                    source // width,
                    source % width,
                )
                if row_lo <= row + top < row_hi and col_lo <= col + left < col_hi:
                    costs[row + top, col + left] = by_square[square]
                for d_row, d_col in ((0, -1), (-1, 0), (0, 1), (1, 0)):
                    side_row, side_col = row + d_row, col + d_col
                    inside = 0 <= side_row < height and 0 <= side_col < width
                    side, away = (
                        side_row * width + side_col,
                        (side_row - from_row) ** 2 + (side_col - from_col) ** 2,
                    )
                    # what has been passed is not gone back to, and of equals the first one counts
                    if inside and square <= away < nearest[side]:
                        nearest[side] = away
                        count = _append(queue, count, away, side, source)
            at = cells[at, 2]


@njit(cache=True)
def _append(queue, count, square, cell, source):  # type: ignore[no-untyped-def]
    """Append (cell, source) to the linked list of a square of the distance; return the number of all entries."""
    cells, first, last = queue
    cells[count, 0], cells[count, 1], cells[count, 2] = cell, source, -1
    if first[square] < 0:
        first[square] = count
    else:
        cells[last[square], 2] = count
    last[square] = count
    return count + 1
