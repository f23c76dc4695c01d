"""Ends of routes through a map: far apart, round corners, past narrow places."""

import heapq
import math
from collections.abc import Iterator

import numpy as np

from barn_worlds.base.arrays import BoolGrid, Cells, Floats, strict_kernel

# Of a route: about 50 s at 0.5 m/s at most. A map without routes that are long enough
# gives those of at least half its longest.
LONGEST_M = 25.0
_SHORTEST_M = 10.0
# A route this many times as long as the straight line cannot be bent better.
_MOST_DETOUR = 2.0
# More meters through narrow places make a route no better.
_MOST_NARROW_M = 3.0
# What a further use of a place costs, where length, detour and narrow places are worth
# up to 1 each: routes spread over the map.
_REUSE_COST = 0.1
_FEWEST_PLACES = 8
_MOST_PLACES = 100
_CANDIDATES = 2000


def draw_ends(
    region: BoolGrid,
    open_cells: BoolGrid,
    narrow_cells: BoolGrid,
    cell_m: float,
    block_cells: int,
    count: int,
    seed: int,
) -> Iterator[tuple[Cells, Cells]]:
    """Yield first and last cell (2,) of routes, best first, none if no cell is open.

    The ends are places spread over the region. Each pair of places has the length of
    the shortest path between them, how much longer it is than the straight line, and
    how much of it is narrow. The same arguments give the same routes.

    Args:
        region: (rows, cols), connected cells where the robot's center may be.
        open_cells: Those of the region where a route may end.
        narrow_cells: Those where the robot is close to obstacles.
        cell_m: Size of a cell.
        block_cells: Paths are measured over blocks of as many cells. Less than half
            the robot's side, so that no path jumps a wall.
        count: Number of routes that are wanted, which decides how many places there
            are.
        seed: Seed of the draw.
    """
    if not open_cells.any():
        return
    generator = np.random.default_rng(seed)
    number = min(max(_FEWEST_PLACES, 2 * count), _MOST_PLACES)
    places = _spread_places(np.argwhere(open_cells), number, generator)
    blocks = places // block_cells
    free_blocks = _pool(region, block_cells)
    narrow_blocks = ~_pool(region & ~narrow_cells, block_cells)

    lengths_m = np.empty((len(places), len(places)))
    narrow_m = np.empty_like(lengths_m)
    rows, columns = blocks.T
    for k, (row, column) in enumerate(blocks):
        paths = _measure_paths(free_blocks, narrow_blocks, row, column)
        lengths_m[k], narrow_m[k] = paths[:, rows, columns] * block_cells * cell_m

    # Both directions of a pair are one route.
    is_route = np.triu(lengths_m <= LONGEST_M, 1)
    if not is_route.any():
        return
    longest_m = lengths_m[is_route].max()
    is_route &= lengths_m >= min(_SHORTEST_M, longest_m / 2.0)

    steps_m = (places[:, None] - places) * cell_m
    straight_m = np.maximum(np.hypot(*steps_m.T), cell_m)
    detour = np.minimum(lengths_m / straight_m, _MOST_DETOUR) - 1.0
    narrow = np.minimum(narrow_m / _MOST_NARROW_M, 1.0)
    worth = np.where(is_route, detour + narrow, -np.inf)
    uses = np.zeros(len(places))
    while True:
        value = worth - _REUSE_COST * (uses[:, None] + uses)
        first, last = np.unravel_index(value.argmax(), value.shape)
        if value[first, last] == -np.inf:
            return
        worth[first, last] = -np.inf
        uses[[first, last]] += 1.0
        if generator.integers(2):
            first, last = last, first
        yield places[first], places[last]


def _spread_places(cells: Cells, number: int, generator: np.random.Generator) -> Cells:
    """Return up to `number` random cells of (n, 2), each far from those before."""
    size = min(len(cells), _CANDIDATES)
    candidates = cells[generator.choice(len(cells), size, replace=False)]
    places = [candidates[0]]
    distance = np.full(size, np.inf)
    while len(places) < min(number, size):
        distance = np.minimum(distance, np.hypot(*(candidates - places[-1]).T))
        places.append(candidates[distance.argmax()])
    return np.array(places)


def _pool(mask: BoolGrid, block_cells: int) -> BoolGrid:
    """Return a mask of square blocks of cells, True where any cell of a block is."""
    padded = np.pad(mask, [(0, -side % block_cells) for side in mask.shape])
    rows, cols = padded.shape
    shape = (rows // block_cells, block_cells, cols // block_cells, block_cells)
    blocks: BoolGrid = np.logical_or.reduce(padded.reshape(shape), axis=(1, 3))
    return blocks


@strict_kernel
def _measure_paths(free: BoolGrid, narrow: BoolGrid, row: int, column: int) -> Floats:
    """Return path lengths from a block, total and narrow, (2, rows, cols); inf if none.

    Args:
        free: (rows, cols), blocks that paths lead over, to any of the 8 neighbors.
        narrow: (rows, cols), those whose steps count as narrow.
        row: Row of the first block.
        column: Column of the first block.

    Returns:
        (2, rows, cols) in blocks; the length is infinite where no path leads.
    """
    rows, cols = free.shape
    paths = np.full((2, rows, cols), np.inf)
    paths[:, row, column] = 0.0
    heap = [(0.0, row, column)]
    while len(heap) > 0:
        length, row, column = heapq.heappop(heap)
        if length > paths[0, row, column]:
            continue
        for r in range(max(0, row - 1), min(rows, row + 2)):
            for c in range(max(0, column - 1), min(cols, column + 2)):
                step = math.hypot(r - row, c - column)
                if free[r, c] and length + step < paths[0, r, c]:
                    paths[0, r, c] = length + step
                    paths[1, r, c] = paths[1, row, column] + step * narrow[r, c]
                    heapq.heappush(heap, (length + step, r, c))
    return paths
