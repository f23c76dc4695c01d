"""The configuration space of a robot on a grid: where its centre may be."""

from __future__ import annotations

import numpy as np

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
    reach = footprint_cells // 2
    occupied: BoolGrid = np.ascontiguousarray(_spread(_spread(grid, reach).T, reach).T)
    return occupied


def _spread(grid: BoolGrid, reach: int) -> BoolGrid:
    """Return where a column has a filled cell at most `reach` rows away, by counting over a sliding window."""
    rows = grid.shape[0]
    filled = np.zeros((rows + 1, grid.shape[1]), np.int64)
    np.cumsum(grid, axis=0, out=filled[1:])
    row = np.arange(rows)
    first, beyond = np.maximum(row - reach, 0), np.minimum(row + reach + 1, rows)
    spread: BoolGrid = filled[beyond] > filled[first]
    return spread
