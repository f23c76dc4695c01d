"""The configuration space on a grid, its free regions, and distances in it."""

import numpy as np

from barn_worlds.base.arrays import BoolGrid, Floats, Integers, strict_kernel
from barn_worlds.base.errors import WorldError


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
    spread_rows = _spread_over_rows(np.ascontiguousarray(grid), reach)
    spread_both = _spread_over_rows(np.ascontiguousarray(spread_rows.T), reach)
    return np.ascontiguousarray(spread_both.T)


@strict_kernel
def _spread_over_rows(grid: BoolGrid, reach: int) -> BoolGrid:
    """Return a grid where filled cells also fill `reach` cells above and below them.

    The time does not depend on the reach.
    """
    rows, cols = grid.shape
    spread = np.empty((rows, cols), np.bool_)
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
                spread[row - reach, column] = rows_since_filled <= 2 * reach
    return spread


def closest_obstacle(cspace: BoolGrid) -> Floats:
    """Return each cell's distance in cells to the nearest occupied one; inf if none is.

    The distance is Euclidean, from center to center, and 0 in occupied cells.
    """
    # Imported here because it takes a while, and most programs read worlds with paths.
    from scipy import ndimage  # noqa: PLC0415

    if not cspace.any():
        return np.full(cspace.shape, np.inf)
    distance: Floats = ndimage.distance_transform_edt(~cspace)
    return distance


def through_region(cspace: BoolGrid) -> BoolGrid | None:
    """Return a mask of the free region that is largest at both end columns, or None.

    As in the paper's generator, it is the largest 4-connected free region that touches
    the first column, provided that it is also the largest that touches the last one.
    """
    labels, sizes = label_regions(~cspace)
    first, last = (_largest(labels[:, column], sizes) for column in (0, -1))
    if first == 0 or first != last:
        return None

    region: BoolGrid = labels == first
    return region


def label_regions(free: BoolGrid, neighbors: int = 4) -> tuple[Integers, Integers]:
    """Return regions' labels (rows, cols), 0 if not free, and cell counts by label.

    Args:
        free: (rows, cols), True where free.
        neighbors: 4 to connect cells at their sides, 8 also at their corners.

    Returns:
        The label (rows, cols) of each cell's region, and the number of cells by label.
        Labels start at 1 and rise in reading order. Label 0 means not free; its number
        is 0.
    """
    from scipy import ndimage  # noqa: PLC0415 (as above)

    labels, count = ndimage.label(free, np.ones((3, 3)) if neighbors == 8 else None)
    return labels, np.bincount(labels[free], minlength=count + 1)


def _largest(labels: Integers, sizes: Integers) -> int:
    """Return which of `labels` has the largest size, lowest of equals; 0 for none."""
    candidates = np.sort(labels)
    return int(candidates[sizes[candidates].argmax()])
