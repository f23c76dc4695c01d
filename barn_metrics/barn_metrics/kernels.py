"""Compiled inner loops of the metrics: rays over a grid of bools, True where occupied."""

import math

import numpy as np
from numba import njit

from barn_worlds.base.arrays import BoolGrid, Cells, Floats, Integers

SQRT2 = math.sqrt(2.0)
TAN_22_5 = SQRT2 - 1.0
LONG = 1.0 / math.cos(
    math.pi / 8.0
)  # in cells, of a step along an axis of 22.5 degrees

# (row, column) directions in cells, 45 degrees apart; the second four are the opposites of the first.
EIGHT_RAYS: Integers = np.array(
    [(0, 1), (1, 1), (1, 0), (1, -1), (0, -1), (-1, -1), (-1, 0), (-1, 1)], np.int64
)

# Around the circle in the order of the original, which swaps (-1, -2) and (-2, -1).
SIXTEEN_RAYS: Integers = np.array(
    [
        *[(0, 1), (1, 2), (1, 1), (2, 1), (1, 0), (2, -1), (1, -1), (1, -2)],
        *[(0, -1), (-2, -1), (-1, -1), (-1, -2), (-1, 0), (-2, 1), (-1, 1), (-1, 2)],
    ],
    np.int64,
)
ORDERED_RAYS: Integers = SIXTEEN_RAYS[[*range(9), 11, 10, 9, *range(12, 16)]]
# Number of sampled points on each of the sixteen rays.
PUBLISHED_POINTS: Integers = np.array(
    [3, 2, 3, 2, 3, 2, 3, 3, 3, 3, 3, 3, 3, 3, 3, 2], np.int64
)
EVEN_POINTS: Integers = np.array([3, 2] * 8, np.int64)

# Per axis: step along rows, step along columns (cells per point, fractions rounded) and length of a step in cells.
FOUR_AXES: Floats = np.array(
    [(0, 1, 1), (1, 1, SQRT2), (1, 0, 1), (1, -1, SQRT2)], np.float64
)
_BETWEEN = [
    (TAN_22_5, 1, LONG),
    (1, TAN_22_5, LONG),
    (1, -TAN_22_5, LONG),
    (TAN_22_5, -1, LONG),
]
EIGHT_AXES: Floats = np.array([*FOUR_AXES, *_BETWEEN], np.float64)


@njit(cache=True)
def free_cells(
    occupied: BoolGrid, row: int, column: int, down: float, right: float
) -> tuple[int, bool]:
    """Return how many cells of a ray, rounded (row + k down, column + k right), are free, if an obstacle ends it."""
    rows, cols = occupied.shape
    count = 0
    while True:
        r = row + round((count + 1) * down)
        c = column + round((count + 1) * right)
        if r < 0 or r >= rows or c < 0 or c >= cols:
            return count, False
        if occupied[r, c]:
            return count, True
        count += 1


@njit(cache=True)
def average_visibility(occupied: BoolGrid, cells: Cells) -> Floats:
    """Return the corrected average visibility (n,) of free cells (n, 2): all eight rays, in cell lengths."""
    values = np.empty(len(cells))
    for i in range(len(cells)):
        total = 0.0
        for k in range(8):
            down, right = EIGHT_RAYS[k]
            length, _ = free_cells(occupied, cells[i, 0], cells[i, 1], down, right)
            total += (length + 1) * (SQRT2 if down != 0 and right != 0 else 1.0)
        values[i] = total / 8.0
    return values


@njit(cache=True)
def average_visibility_published(occupied: BoolGrid, cells: Cells) -> Floats:
    """Return the published average visibility (n,) of free cells (n, 2): in cells, of rays that obstacles end."""
    values = np.empty(len(cells))
    for i in range(len(cells)):
        total, ended = 0, 0
        for k in range(8):
            length, blocked = free_cells(
                occupied, cells[i, 0], cells[i, 1], EIGHT_RAYS[k, 0], EIGHT_RAYS[k, 1]
            )
            if blocked:
                total += length + 1
                ended += 1
        values[i] = total // ended if ended > 0 else np.nan
    return values


@njit(cache=True)
def ray_blocked(
    occupied: BoolGrid, row: int, column: int, direction: Integers, points: int
) -> bool:
    """Tell whether one of the first `points` cells of a ray is occupied; beyond the grid it is open."""
    rows, cols = occupied.shape
    down, right = direction
    for k in range(1, points + 1):
        r, c = row + k * down, column + k * right
        if r < 0 or r >= rows or c < 0 or c >= cols:
            return False
        if occupied[r, c]:
            return True
    return False


@njit(cache=True)
def dispersion(
    occupied: BoolGrid, cells: Cells, rays: Integers, points: Integers
) -> Floats:
    """Return how often neighbouring rays (m, 2), `points` (m,) cells long, change between blocked and open, (n,)."""
    values = np.empty(len(cells))
    for i in range(len(cells)):
        row, column = cells[i]
        before = ray_blocked(occupied, row, column, rays[-1], points[-1])
        changes = 0
        for k in range(len(rays)):
            blocked = ray_blocked(occupied, row, column, rays[k], points[k])
            if blocked != before:
                changes += 1
            before = blocked
        values[i] = changes
    return values


@njit(cache=True)
def characteristic_dimension(occupied: BoolGrid, cells: Cells, axes: Floats) -> Floats:
    """Return the free length (n,), in cells, along the shortest of axes, as `FOUR_AXES`, through free cells (n, 2)."""
    values = np.empty(len(cells))
    for i in range(len(cells)):
        shortest = np.inf
        for k in range(len(axes)):
            down, right, step = axes[k]
            ahead, _ = free_cells(occupied, cells[i, 0], cells[i, 1], down, right)
            behind, _ = free_cells(occupied, cells[i, 0], cells[i, 1], -down, -right)
            shortest = min(shortest, (ahead + behind) * step)
        values[i] = shortest
    return values
