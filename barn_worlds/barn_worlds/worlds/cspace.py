"""The configuration space on a grid (where a robot's centre may be), and the free regions of a grid."""

import numpy as np
from numba import njit

from barn_worlds.base.arrays import BoolGrid, Integers
from barn_worlds.base.errors import WorldError

_DOWN = np.array([-1, 0, 0, 1, -1, -1, 1, 1])  # sides, then corners
_RIGHT = np.array([0, -1, 1, 0, -1, 1, -1, 1])


def configuration_space(grid: BoolGrid, footprint_cells: int) -> BoolGrid:
    """Return the cells (rows, cols) in which the centre of a square footprint would cover a filled cell.

    grid: (rows, cols), True where filled. footprint_cells: odd side of the square (`Robot.footprint_cells`); the
    Jackal of the paper takes 5. Cells outside the grid count as free (unlike for the automaton), as in the
    original data set. Raises WorldError for an even or non-positive side.
    """
    if footprint_cells < 1 or footprint_cells % 2 == 0:
        raise WorldError(
            f"footprint must be an odd number of cells from 1, got {footprint_cells}"
        )
    down = _filled_within(np.ascontiguousarray(grid), footprint_cells // 2)
    across = _filled_within(np.ascontiguousarray(down.T), footprint_cells // 2)
    return np.ascontiguousarray(across.T)


@njit(cache=True)
def _filled_within(grid: BoolGrid, reach: int) -> BoolGrid:
    """Return the cells with a filled one at most `reach` rows away, in a time that does not depend on the reach."""
    rows, cols = grid.shape
    within = np.empty((rows, cols), np.bool_)
    for column in range(cols):
        since = 2 * reach + 1  # rows since the last filled one
        for row in range(rows + reach):
            since = 0 if row < rows and grid[row, column] else since + 1
            if row >= reach:
                within[row - reach, column] = since <= 2 * reach
    return within


def through_region(cspace: BoolGrid) -> BoolGrid | None:
    """Return the free region (rows, cols) that leads from the first to the last column of a C-space, or None.

    As in the paper's generator: the largest 4-connected free region that touches the first column, if it is also the
    largest that touches the last one.
    """
    labels, sizes = _label(np.ascontiguousarray(~cspace), 4)
    first, last = _largest(labels[:, 0], sizes), _largest(labels[:, -1], sizes)
    region: BoolGrid = labels == first
    return region if first != 0 and first == last else None


def label_regions(free: BoolGrid, neighbours: int = 4) -> tuple[Integers, Integers]:
    """Return the label (rows, cols) of each free cell's region of 4 or 8 `neighbours`, and how many cells each has.

    Labels start at 1 and rise in reading order. Cells that are not free have label 0, whose count is 0.
    """
    labels, sizes = _label(np.ascontiguousarray(free), neighbours)
    return labels, sizes[: labels.max(initial=0) + 1]


@njit(cache=True)
def _largest(touching: Integers, sizes: Integers) -> int:
    """Return the label with the most cells among those `touching`, the lowest of equals; 0 if there are none."""
    largest = 0
    for label in touching:
        if sizes[label] > sizes[largest] or (
            sizes[label] == sizes[largest] and 0 < label < largest
        ):
            largest = label
    return largest


@njit(cache=True)
def _label(free: BoolGrid, neighbours: int) -> tuple[Integers, Integers]:
    rows, cols = free.shape
    labels = np.zeros((rows, cols), np.int64)
    sizes = np.zeros(rows * cols + 1, np.int64)
    stack = np.empty(rows * cols, np.int64)
    count = 0
    for seed in range(rows * cols):
        if (
            not free[seed // cols, seed % cols]
            or labels[seed // cols, seed % cols] != 0
        ):
            continue
        count += 1
        labels[seed // cols, seed % cols] = count
        stack[0] = seed
        size = 1
        while size > 0:
            size -= 1
            sizes[count] += 1
            row, column = stack[size] // cols, stack[size] % cols
            for k in range(neighbours):
                r, c = row + _DOWN[k], column + _RIGHT[k]
                if 0 <= r < rows and 0 <= c < cols and free[r, c] and labels[r, c] == 0:
                    labels[r, c] = count
                    stack[size] = r * cols + c
                    size += 1
    return labels, sizes
