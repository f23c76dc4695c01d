"""Compiled inner loops of the metrics: rays over a grid, True where occupied."""

import math

import numpy as np

from barn_worlds.base.arrays import BoolGrid, Cells, Floats, Integers, strict_kernel

SQRT2 = math.sqrt(2.0)
TAN_22_5 = SQRT2 - 1.0
# Length in cells of a step along an axis of 22.5 degrees.
_LONG_STEP = 1.0 / math.cos(math.pi / 8.0)

# (row, column) directions around the circle, about 22.5 degrees apart: those of a
# quadrant, and the same turned by one, two and three right angles.
_QUADRANT: Integers = np.array([(0, 1), (1, 2), (1, 1), (2, 1)], np.int64)
_RIGHT_ANGLE: Integers = np.array([(0, -1), (1, 0)], np.int64)
ORDERED_RAYS: Integers = np.concatenate(
    [_QUADRANT @ np.linalg.matrix_power(_RIGHT_ANGLE, turns) for turns in range(4)]
)
# The original swaps (-1, -2) and (-2, -1).
SIXTEEN_RAYS: Integers = ORDERED_RAYS[[*range(9), 11, 10, 9, *range(12, 16)]]
# 45 degrees apart; the last four oppose the first four.
EIGHT_RAYS: Integers = ORDERED_RAYS[::2].copy()
# Number of sampled points on each of the sixteen rays.
EVEN_POINTS: Integers = np.array([3, 2] * 8, np.int64)
# In the original, four of the in-between rays have a point more and reach 6 cells far.
PUBLISHED_POINTS: Integers = EVEN_POINTS.copy()
PUBLISHED_POINTS[[7, 9, 11, 13]] = 3

# Per axis: step along rows and along columns (in cells, rounded per point), and length
# of a step in cells.
EIGHT_AXES: Floats = np.array(
    [
        (0, 1, 1),
        (1, 1, SQRT2),
        (1, 0, 1),
        (1, -1, SQRT2),
        (TAN_22_5, 1, _LONG_STEP),
        (1, TAN_22_5, _LONG_STEP),
        (1, -TAN_22_5, _LONG_STEP),
        (TAN_22_5, -1, _LONG_STEP),
    ],
    np.float64,
)


@strict_kernel
def free_cells(
    occupied: BoolGrid, row: int, column: int, row_step: float, column_step: float
) -> tuple[int, bool]:
    """Return a ray's count of free cells after the start, and if an obstacle ends it.

    Args:
        occupied: (rows, cols).
        row: Cell at which the ray starts.
        column: Cell at which the ray starts.
        row_step: Rows per point; points are rounded to cells.
        column_step: Columns per point.
    """
    rows, cols = occupied.shape
    count = 0
    while True:
        r = row + round((count + 1) * row_step)
        c = column + round((count + 1) * column_step)
        if r < 0 or r >= rows or c < 0 or c >= cols:
            return count, False
        if occupied[r, c]:
            return count, True
        count += 1


@strict_kernel
def average_visibility(occupied: BoolGrid, cells: Cells) -> Floats:
    """Return the mean length of eight rays per cell, end included, diagonals sqrt 2.

    Args:
        occupied: (rows, cols).
        cells: Free cells (n, 2).

    Returns:
        (n,), in cell lengths.
    """
    values = np.empty(len(cells))
    for i in range(len(cells)):
        row, column = cells[i]
        total = 0.0
        for k in range(8):
            row_step, column_step = EIGHT_RAYS[k]
            length, _ = free_cells(occupied, row, column, row_step, column_step)
            is_diagonal = row_step != 0 and column_step != 0
            total += (length + 1) * (SQRT2 if is_diagonal else 1.0)
        values[i] = total / 8.0
    return values


@strict_kernel
def average_visibility_published(occupied: BoolGrid, cells: Cells) -> Floats:
    """Return published visibility (n,): floored mean of blocked rays, NaN without any.

    Args:
        occupied: (rows, cols).
        cells: Free cells (n, 2).

    Returns:
        (n,), in cells, rounded down; NaN where no obstacle ends a ray.
    """
    values = np.empty(len(cells))
    for i in range(len(cells)):
        row, column = cells[i]
        total = 0
        ended_rays = 0
        for k in range(8):
            row_step, column_step = EIGHT_RAYS[k]
            length, is_blocked = free_cells(
                occupied, row, column, row_step, column_step
            )
            if is_blocked:
                total += length + 1
                ended_rays += 1
        values[i] = total // ended_rays if ended_rays > 0 else np.nan
    return values


@strict_kernel
def ray_blocked(
    occupied: BoolGrid, row: int, column: int, direction: Integers, points: int
) -> bool:
    """Tell whether one of a ray's first `points` cells, start excluded, is occupied.

    Args:
        occupied: (rows, cols); beyond it the ray is open.
        row: Cell at which the ray starts.
        column: Cell at which the ray starts.
        direction: Rows and columns per point, (2,).
        points: Number of cells that are looked at.
    """
    rows, cols = occupied.shape
    row_step, column_step = direction
    for k in range(1, points + 1):
        r = row + k * row_step
        c = column + k * column_step
        if r < 0 or r >= rows or c < 0 or c >= cols:
            return False
        if occupied[r, c]:
            return True
    return False


@strict_kernel
def dispersion(
    occupied: BoolGrid, cells: Cells, rays: Integers, points: Integers
) -> Floats:
    """Return per cell how often rays in a circle change between blocked and open, (n,).

    Args:
        occupied: (rows, cols).
        cells: Free cells (n, 2).
        rays: Directions (m, 2) in order around the circle.
        points: Number of cells (m,) of each ray.

    Returns:
        (n,).
    """
    values = np.empty(len(cells))
    for i in range(len(cells)):
        row, column = cells[i]
        was_blocked = ray_blocked(occupied, row, column, rays[-1], points[-1])
        changes = 0
        for k in range(len(rays)):
            is_blocked = ray_blocked(occupied, row, column, rays[k], points[k])
            if is_blocked != was_blocked:
                changes += 1
            was_blocked = is_blocked
        values[i] = changes
    return values


@strict_kernel
def characteristic_dimension(occupied: BoolGrid, cells: Cells, axes: Floats) -> Floats:
    """Return per cell (n,) the free length (cells) of its shortest axis, both ways.

    Args:
        occupied: (rows, cols).
        cells: Free cells (n, 2).
        axes: As `EIGHT_AXES`.

    Returns:
        (n,), in cells.
    """
    values = np.empty(len(cells))
    for i in range(len(cells)):
        row, column = cells[i]
        shortest = np.inf
        for k in range(len(axes)):
            row_step, column_step, step_length = axes[k]
            ahead, _ = free_cells(occupied, row, column, row_step, column_step)
            behind, _ = free_cells(occupied, row, column, -row_step, -column_step)
            shortest = min(shortest, (ahead + behind) * step_length)
        values[i] = shortest
    return values
