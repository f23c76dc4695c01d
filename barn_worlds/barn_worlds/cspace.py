"""The configuration space of a robot on a grid: where its centre may be."""

from __future__ import annotations

import numpy as np
from numba import njit

from barn_worlds.arrays import BoolGrid
from barn_worlds.errors import WorldError


def configuration_space(grid: BoolGrid, footprint_cells: int) -> BoolGrid:
    """Return the cells (rows, cols) in which the centre of a square footprint would cover a filled cell.

    grid: (rows, cols), True where filled. footprint_cells: odd side of the square (`Robot.footprint_cells`); the
    Jackal of the paper takes 5. Cells outside the grid count as free (unlike for the automaton), as in the
    original data set. Raises WorldError for an even or non-positive side.
    """
    if footprint_cells < 1 or footprint_cells % 2 == 0:
        raise WorldError(f"footprint must be an odd number of cells from 1, got {footprint_cells}")
    occupied: BoolGrid = _dilate(np.ascontiguousarray(grid), footprint_cells // 2)
    return occupied


@njit(cache=True)
def _dilate(grid: BoolGrid, reach: int) -> BoolGrid:
    """Return the cells with a filled one at most `reach` rows and columns away: first along rows, then columns.

    In each line the next free cell follows from how far back the last filled one is, there and backwards, so that
    the time does not depend on the reach.
    """
    rows, cols = grid.shape
    along = np.zeros((rows, cols), np.bool_)
    for row in range(rows):
        since = reach + 1
        for column in range(cols):
            since = 0 if grid[row, column] else since + 1
            along[row, column] = since <= reach
        since = reach + 1
        for column in range(cols - 1, -1, -1):
            since = 0 if grid[row, column] else since + 1
            along[row, column] |= since <= reach
    dilated = np.zeros((rows, cols), np.bool_)
    since_in_column = np.full(cols, reach + 1)
    for row in range(rows):
        for column in range(cols):
            since_in_column[column] = 0 if along[row, column] else since_in_column[column] + 1
            dilated[row, column] = since_in_column[column] <= reach
    since_in_column[:] = reach + 1
    for row in range(rows - 1, -1, -1):
        for column in range(cols):
            since_in_column[column] = 0 if along[row, column] else since_in_column[column] + 1
            dilated[row, column] |= since_in_column[column] <= reach
    return dilated
