"""The cellular automaton that grows obstacles (paper, Algorithm 1)."""

from collections.abc import Iterator

import numpy as np
from numba import njit

from barn_worlds.arrays import BoolGrid
from barn_worlds.parameters import WorldParameters


def grow(parameters: WorldParameters, generator: np.random.Generator) -> BoolGrid:
    """Return a grid (rows, cols) of obstacles, True where filled."""
    *_, grid = iterations(parameters, generator)
    return grid


def iterations(parameters: WorldParameters, generator: np.random.Generator) -> Iterator[BoolGrid]:
    """Yield the random grid and then the grid after each smoothing iteration (as in Fig. 1 of the paper)."""
    grid = random_fill(parameters, generator)
    yield grid
    for _ in range(parameters.smoothing_iterations):
        grid = smooth(grid, parameters.fill_threshold, parameters.clear_threshold)
        grid[[0, -1]] = True  # with the paper's thresholds they stay filled anyway
        yield grid


def random_fill(parameters: WorldParameters, generator: np.random.Generator) -> BoolGrid:
    """Return a grid filled at random, with its first and last row, the side walls, filled completely."""
    grid: BoolGrid = generator.random((parameters.rows, parameters.cols)) < parameters.initial_fill
    grid[[0, -1]] = True
    return grid


def smooth(grid: BoolGrid, fill_threshold: int = 5, clear_threshold: int = 1) -> BoolGrid:
    """Return the grid after one iteration; every cell looks at the grid before it.

    A cell with at least `fill_threshold` filled cells among its 8 neighbours is filled. One with at most
    `clear_threshold` is cleared. Any other stays as it is. Cells above the first and below the last row count as filled
    (corners included), cells beside the first and the last column as free.
    """
    smoothed: BoolGrid = _smooth(np.ascontiguousarray(grid), fill_threshold, clear_threshold)
    return smoothed


@njit(cache=True)
def _smooth(grid: BoolGrid, fill_threshold: int, clear_threshold: int) -> BoolGrid:
    rows, cols = grid.shape
    smoothed = np.empty((rows, cols), np.bool_)
    for row in range(rows):
        for column in range(cols):
            filled = grid[row, column]
            neighbours = -int(filled)
            for r in range(row - 1, row + 2):
                for c in range(column - 1, column + 2):
                    neighbours += r < 0 or r >= rows or (0 <= c < cols and grid[r, c])
            smoothed[row, column] = neighbours >= fill_threshold or (filled and neighbours > clear_threshold)
    return smoothed
