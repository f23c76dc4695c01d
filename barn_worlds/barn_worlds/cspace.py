"""The configuration space of a robot on a grid: where its centre may be."""

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
