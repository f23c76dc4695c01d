"""Restoring what .world files leave out: filled cells whose 8 neighbours are all filled.

An enclosed gap in the file may be such a hollow, or it may have been empty: the file looks the same. But if filling a
gap would surround a cell that the file shows, the gap was empty. So every enclosed gap is filled unless that
contradicts the file, the largest first. This recovers all but 2 of 18 000 generated worlds and all of the 50 shared
originals. An error has no effect: no robot and no ray gets into such a gap, and one of up to 4 x 4 cells is occupied
in the C-space of a Jackal anyway.
"""

import numpy as np
from numba import njit

from barn_worlds.arrays import BoolGrid, Integers
from barn_worlds.flood import label_regions


def fill_hollow(shown: BoolGrid) -> BoolGrid:
    """Return the grid (rows, cols) of which a .world file shows the cells `shown`."""
    shown = np.ascontiguousarray(shown)
    labels, sizes = label_regions(~shown, neighbours=8)
    rim = np.concatenate([labels[0], labels[-1], labels[:, 0], labels[:, -1]])
    enclosed = np.setdiff1d(np.arange(1, len(sizes)), rim)
    by_label = np.argsort(labels, axis=None, kind="stable")
    ends = np.cumsum(np.concatenate([[shown.size - sizes.sum()], sizes[1:]]))
    order = enclosed[np.argsort(-sizes[enclosed], kind="stable")]
    grid: BoolGrid = _fill(shown, by_label, ends, order)
    return grid


@njit(cache=True)
def _fill(shown: BoolGrid, by_label: Integers, ends: Integers, order: Integers) -> BoolGrid:
    """Fill the gaps in this order, except where that would surround a shown cell.

    by_label: indices of all cells, sorted by label; those of label k end at ends[k].
    """
    cols = shown.shape[1]
    grid: BoolGrid = shown.copy()
    for label in order:
        cells = by_label[ends[label - 1] : ends[label]]
        for cell in cells:
            grid[cell // cols, cell % cols] = True
        for cell in cells:
            if _surrounds_shown(grid, shown, cell // cols, cell % cols):
                for undone in cells:
                    grid[undone // cols, undone % cols] = False
                break
    return grid


@njit(cache=True)
def _surrounds_shown(grid: BoolGrid, shown: BoolGrid, row: int, column: int) -> bool:
    """Tell whether a shown neighbour of an inner cell has no free neighbour."""
    rows, cols = grid.shape
    for r in range(max(1, row - 1), min(rows - 1, row + 2)):
        for c in range(max(1, column - 1), min(cols - 1, column + 2)):
            around = grid[r - 1 : r + 2, c - 1 : c + 2]
            if shown[r, c] and np.all(around):
                return True
    return False
