"""Steps on the grid to the plan and to its end.

They are base_local_planner's `MapGrid::computeTargetDistance` (map_grid.cpp), but a
wavefront spreads only as far as someone asks for. Its cells are numbers in a flat grid
that is padded by one blocked cell on each side, which spares checks at the edges.
"""

import math
from typing import NamedTuple

import numpy as np

from barn_planners.costmap.kernels import INSCRIBED, Cell, Grid, cell_at, is_on_grid
from barn_worlds.base.arrays import Bytes, Cells, Integers, MediumIntegers, Points
from barn_worlds.base.kernel import kernel

UNREACHED = 2**30

# States of a cell.
OPEN = np.uint8(0)
BLOCKED = np.uint8(1)
REACHED = np.uint8(2)

# Positions in `Wavefront.ends`.
_HEAD = 0  # place in the queue of the cell to go on with
_TAIL = 1  # number of cells in the queue


class Wavefront(NamedTuple):
    """Flat arrays over the padded grid, and how far the wavefront has come."""

    distances: MediumIntegers  # steps from the nearest seed, valid where REACHED
    state: Bytes  # OPEN, BLOCKED or REACHED
    queue: MediumIntegers  # cells in the order in which they are reached
    ends: Integers  # head and tail of the queue
    columns: int  # of the padded grid


def new_wavefront(rows: int, cols: int) -> Wavefront:
    """Return memory for a wavefront on rows x cols cells; `start_wavefront` seeds it.

    Args:
        rows: Number of rows of the costmap.
        cols: Number of its columns.
    """
    size = (rows + 2) * (cols + 2)
    return Wavefront(
        np.empty(size, np.int32),
        np.empty(size, np.uint8),
        np.empty(size, np.int32),
        np.zeros(2, np.int64),
        cols + 2,
    )


@kernel
def padded(cell: Cell, columns: int) -> int:
    """Return a cell's index in the flat grid that is padded by a cell on each side.

    Args:
        cell: Cell of the costmap.
        columns: Number of columns of the padded grid.
    """
    return (cell.row + 1) * columns + cell.col + 1


@kernel
def block_cells(costs: Bytes, state: Bytes) -> None:
    """Write BLOCKED for cells of cost 253 and more and the padding, OPEN for others.

    Args:
        costs: Costs of the costmap (rows, columns).
        state: Array over the padded grid that receives OPEN or BLOCKED.
    """
    rows, cols = costs.shape
    width = cols + 2
    state[:] = BLOCKED
    for row in range(rows):
        source = costs[row]
        target = state[(row + 1) * width + 1 : (row + 2) * width - 1]
        for col in range(cols):
            target[col] = BLOCKED if source[col] >= INSCRIBED else OPEN


@kernel
def open_cells(cells: Cells, columns: int, state: Bytes) -> None:
    """Set cells under the robot to OPEN in the padded `state`, whatever they cost.

    `MapGrid` sets them within_robot.

    Args:
        cells: Cells (n, 2) of the costmap.
        columns: Number of columns of the padded grid.
        state: Array over the padded grid, from `block_cells`.
    """
    for row, col in cells:
        state[padded(Cell(row, col), columns)] = OPEN


@kernel
def plan_cells(
    plan: Points, grid: Grid, shape: tuple[int, int], cells: Integers
) -> int:
    """Write the padded indices of cells under a plan, on the grid; return how many.

    Follows `MapGrid::adjustPlanResolution` and `setTargetCells`: long segments are cut
    so that no cell is left out.

    Args:
        plan: Points (n, 2 or more), x and y in m.
        grid: Place of the costmap.
        shape: Numbers of rows and columns of the costmap.
        cells: Array that receives the padded numbers; a longer plan is cut off.

    Returns:
        Number of cells.
    """
    count = 0
    for k in range(len(plan)):
        before = max(0, k - 1)
        dx = plan[k, 0] - plan[before, 0]
        dy = plan[k, 1] - plan[before, 1]
        pieces = max(1, math.ceil(math.hypot(dx, dy) / grid.resolution + 1e-6))
        for piece in range(1, pieces + 1):
            # From the start of the segment, so that errors do not add up.
            share = piece / pieces
            x = plan[before, 0] + share * dx
            y = plan[before, 1] + share * dy
            cell = cell_at(grid, x, y)
            # The plan may begin off the costmap; it ends where it first leaves it.
            if not is_on_grid(cell, shape):
                if count > 0:
                    return count
                continue

            number = padded(cell, shape[1] + 2)
            if count == 0 or cells[count - 1] != number:
                if count == len(cells):
                    return count
                cells[count] = number
                count += 1

    return count


@kernel
def start_wavefront(front: Wavefront, walls: Bytes, seeds: Integers) -> None:
    """Reset a wavefront in place: cells as in `walls`, but seeds reached in 0 steps.

    Args:
        front: Wavefront to start.
        walls: What blocks, from `block_cells`.
        seeds: Padded numbers of the cells with distance 0, wherever they are.
    """
    # A loop is ten times as fast here as numba's assignment of a whole array.
    for cell in range(len(walls)):
        front.state[cell] = walls[cell]

    # Seeds count as reached even where they are blocked, so that ways lead out of them.
    tail = 0
    for seed in seeds:
        if front.state[seed] != REACHED:
            front.distances[seed] = 0
            front.state[seed] = REACHED
            front.queue[tail] = seed
            tail += 1
    front.ends[_HEAD] = 0
    front.ends[_TAIL] = tail


@kernel
def steps_to(front: Wavefront, cell: int) -> int:
    """Spread a wavefront to a cell; return its 4-connected steps from the nearest seed.

    Args:
        front: Wavefront, which spreads to the cell.
        cell: Padded number of the cell.

    Returns:
        UNREACHED if no way leads to the cell.
    """
    place = np.uint64(cell)
    if front.state[place] == OPEN:
        _spread(front, place)
    if front.state[place] != REACHED:
        return UNREACHED

    steps: int = front.distances[place]
    return steps


@kernel
def is_bordered(front: Wavefront, cell: int) -> bool:
    """Return whether a wavefront, which spreads for that, reaches a neighbor of a cell.

    Args:
        front: Wavefront, which spreads as far as necessary.
        cell: Padded number of the cell, which is not in the padding.
    """
    steps = min(
        steps_to(front, cell - 1),
        steps_to(front, cell + 1),
        steps_to(front, cell - front.columns),
        steps_to(front, cell + front.columns),
    )
    return steps < UNREACHED


@kernel
def _spread(front: Wavefront, goal: np.uint64) -> None:
    """Continue a wavefront in place until it reaches a padded index or cannot go on."""
    distances = front.distances
    state = front.state
    queue = front.queue
    row = np.uint64(front.columns)
    unit = np.uint64(1)
    head = np.uint64(front.ends[_HEAD])
    tail = np.uint64(front.ends[_TAIL])
    while head < tail and state[goal] == OPEN:
        cell = np.uint64(queue[head])
        head += unit
        steps = distances[cell] + np.int32(1)
        for neighbor in (cell - unit, cell + unit, cell - row, cell + row):
            # Selections instead of branches, half of which would be mispredicted.
            is_open = state[neighbor] == OPEN
            distances[neighbor] = steps if is_open else distances[neighbor]
            state[neighbor] = REACHED if is_open else state[neighbor]
            # Written in any case; the place counts only if the tail moves on.
            queue[tail] = neighbor
            tail += np.uint64(is_open)

    front.ends[_HEAD] = head
    front.ends[_TAIL] = tail
