"""The configuration space on a grid, where a robot's center may be, and its regions."""

import numpy as np

from barn_worlds.base.arrays import BoolGrid, Integers, strict_kernel
from barn_worlds.base.errors import WorldError

# Steps to the neighbors: first the four at the sides, then the four at the corners.
_ROW_STEPS = np.array([-1, 0, 0, 1, -1, -1, 1, 1])
_COLUMN_STEPS = np.array([0, -1, 1, 0, -1, 1, -1, 1])


def configuration_space(grid: BoolGrid, footprint_cells: int) -> BoolGrid:
    """Return the C-space, True where the center may not be; WorldError for even sides.

    There a square footprint around the center of the cell covers a filled cell.

    Args:
        grid: (rows, cols), True where filled. Outside it everything is free, as in the
            original data set (and unlike in the cellular automaton).
        footprint_cells: Odd side of the square (`Robot.footprint_cells`); 5 for the
            paper's Jackal.

    Returns:
        (rows, cols), True where the center may not be.

    Raises:
        WorldError: If the side is even or not positive.
    """
    if footprint_cells < 1 or footprint_cells % 2 == 0:
        raise WorldError(
            "side of the footprint must be an odd number of cells, at least 1,"
            f" got {footprint_cells}"
        )

    # A square is a span of rows followed by a span of columns.
    reach = footprint_cells // 2
    spread_rows = _fill_along_rows(np.ascontiguousarray(grid), reach)
    spread_both = _fill_along_rows(np.ascontiguousarray(spread_rows.T), reach)
    return np.ascontiguousarray(spread_both.T)


@strict_kernel
def _fill_along_rows(grid: BoolGrid, reach: int) -> BoolGrid:
    """Return a mask, True where a filled cell is within `reach` rows in the column.

    The time does not depend on the reach.
    """
    rows, cols = grid.shape
    near = np.empty((rows, cols), np.bool_)
    for column in range(cols):
        # As if the last filled cell were just out of reach.
        rows_since_filled = 2 * reach + 1
        for row in range(rows + reach):
            if row < rows and grid[row, column]:
                rows_since_filled = 0
            else:
                rows_since_filled += 1
            # Known now: no later row is within reach.
            if row >= reach:
                near[row - reach, column] = rows_since_filled <= 2 * reach
    return near


def through_region(cspace: BoolGrid) -> BoolGrid | None:
    """Return a mask (rows, cols) of the free region that leads through, or None.

    It leads from the first column to the last.

    As in the paper's generator, it is the largest 4-connected free region that touches
    the first column, provided that it is also the largest that touches the last one.
    """
    labels, sizes = _label(np.ascontiguousarray(~cspace), 4)
    first = _largest(labels[:, 0], sizes)
    last = _largest(labels[:, -1], sizes)
    if first == 0 or first != last:
        return None

    region: BoolGrid = labels == first
    return region


def label_regions(free: BoolGrid, neighbors: int = 4) -> tuple[Integers, Integers]:
    """Return regions' labels (rows, cols), 0 if not free, and cell counts by label.

    Args:
        free: (rows, cols), True where free.
        neighbors: 4 to connect cells at their sides, 8 also at their corners.

    Returns: The label (rows, cols) of each cell's region, and the number of cells by
        label. Labels start at 1 and rise in reading order. Label 0 means not free; its
        number is 0.
    """
    labels, sizes = _label(np.ascontiguousarray(free), neighbors)
    return labels, sizes[: labels.max(initial=0) + 1]


@strict_kernel
def _largest(labels: Integers, sizes: Integers) -> int:
    """Return which of `labels` has the largest size, lowest of equals; 0 for none."""
    largest = 0
    for label in labels:
        is_first_of_equals = sizes[label] == sizes[largest] and 0 < label < largest
        if sizes[label] > sizes[largest] or is_first_of_equals:
            largest = label
    return largest


@strict_kernel
def _label(free: BoolGrid, neighbors: int) -> tuple[Integers, Integers]:
    """Return labels (rows, cols), 0 where not free, and cells per possible label."""
    rows, cols = free.shape
    labels = np.zeros((rows, cols), np.int64)
    sizes = np.zeros(rows * cols + 1, np.int64)
    stack = np.empty(rows * cols, np.int64)
    count = 0
    # In reading order, which makes labels rise in it.
    for seed in range(rows * cols):
        row = seed // cols
        column = seed % cols
        if not free[row, column] or labels[row, column] != 0:
            continue

        # Flood the region of this cell.
        count += 1
        labels[row, column] = count
        stack[0] = seed
        waiting = 1
        while waiting > 0:
            waiting -= 1
            sizes[count] += 1
            row = stack[waiting] // cols
            column = stack[waiting] % cols
            for k in range(neighbors):
                r = row + _ROW_STEPS[k]
                c = column + _COLUMN_STEPS[k]
                if 0 <= r < rows and 0 <= c < cols and free[r, c] and labels[r, c] == 0:
                    labels[r, c] = count
                    stack[waiting] = r * cols + c
                    waiting += 1
    return labels, sizes
