"""The path through a world, with limited turns on the C-space (paper, Sec. III-A).

The parameters reproduce all 50 shared paths of the original data set cell by cell,
apart from their first cell, which occurs twice there.
"""

import heapq
import math
from collections.abc import Callable, Sequence

import numpy as np

from barn_worlds.base.arrays import BoolGrid, Cells, Floats, Integers, strict_kernel
from barn_worlds.base.errors import WorldError
from barn_worlds.worlds.cspace import closest_obstacle, through_region

# Steps of the 8 directions, 45 degrees apart.
_ROW_STEPS = np.array([0, 1, 1, 1, 0, -1, -1, -1])
_COLUMN_STEPS = np.array([1, 1, 0, -1, -1, -1, 0, 1])
_LENGTHS = np.hypot(_ROW_STEPS, _COLUMN_STEPS)
_STRAIGHT_FIRST = np.array([0, 4, 2, 6, 1, 3, 7, 5])
_NO_DIRECTION = 8

# Largest turn between two steps, in steps of 45 degrees.
LARGEST_TURN = 1
# Cells this close to obstacles are searched later, by weight / distance.
INFLATION_CELLS = 2.0
INFLATION_WEIGHT = 5.0


def plan_path(
    cspace: BoolGrid, start: Sequence[int] | Cells, goal: Sequence[int] | Cells
) -> Cells | None:
    """Return path cells (n, 2), None if none exists; WorldError if an end is outside.

    Two steps in a row turn by at most 45 degrees.

    Steps go to the 8 neighbors, but not between two occupied cells that touch at a
    corner. The inflation term affects a cell's priority but not its cost. Where the
    original's search finds nothing, A* over cells and directions finds a path if there
    is one.

    Args:
        cspace: (rows, cols), True where occupied.
        start: Row and column of the first cell.
        goal: Row and column of the last cell.

    Returns:
        Cells (n, 2) with both ends, or None if there is no path.

    Raises:
        WorldError: If an end is outside the grid.
    """
    rows, cols = cspace.shape
    for row, column in (start, goal):
        if not (0 <= row < rows and 0 <= column < cols):
            raise WorldError(
                f"cell ({row}, {column}) is outside the grid of {rows} x {cols} cells"
            )
        if cspace[row, column]:
            return None

    free = np.ascontiguousarray(~cspace)
    penalty = inflation(cspace)
    start_cell = start[0] * cols + start[1]
    goal_cell = goal[0] * cols + goal[1]
    for complete in (False, True):
        path: Cells = search(free, penalty, start_cell, goal_cell, complete)
        if len(path):
            return path
    return None


def choose_middle(rows: Integers) -> int:
    """Return the index of the one of `rows` (n,) nearest their mean, first of two."""
    return int(np.abs(rows - rows.mean()).argmin())


def plan_through(
    cspace: BoolGrid, choose: Callable[[Integers], int] = choose_middle
) -> Cells | None:
    """Return path cells (n, 2) from first to last column, None if none leads through.

    It begins and ends in the region that leads through.

    Args:
        cspace: (rows, cols), True where occupied.
        choose: Takes the rows (n,) of the region in the first column, then those in the
            last, and returns the place of one of them. By default it is in the middle.

    Returns:
        Cells (n, 2), or None if there is no path.
    """
    region = through_region(cspace)
    if region is None:
        return None

    ends = []
    for column in (0, cspace.shape[1] - 1):
        rows = np.flatnonzero(region[:, column])
        ends.append((int(rows[choose(rows)]), column))
    return plan_path(cspace, *ends)


def inflation(cspace: BoolGrid) -> Floats:
    """Return the penalties (rows, cols) on the priority of cells near an obstacle.

    Args:
        cspace: (rows, cols), True where occupied; the border of the grid is no
            obstacle.

    Returns:
        Weight / Euclidean distance in cells to the nearest occupied cell, 0 beyond the
        inflation distance and where occupied, (rows, cols).
    """
    distance = closest_obstacle(cspace)
    is_near = (distance > 0.0) & (distance <= INFLATION_CELLS)
    penalty = np.zeros(cspace.shape)
    return np.divide(INFLATION_WEIGHT, distance, out=penalty, where=is_near)


@strict_kernel
def search(
    free: BoolGrid, penalty: Floats, start: int, goal: int, complete: bool
) -> Cells:
    """Return the path cells (n, 2) that a search finds, empty (0, 2) if it finds none.

    The original's search discovers a cell without a heuristic. An open cell that is
    then reached at less cost changes its predecessor, and gets a priority with the
    Euclidean distance to the goal. So the first discovery nearly always decides, and
    because of the turn limit it may miss an existing path.

    The complete search is A* over pairs of cell and direction, with the octile distance
    as the heuristic. It finds a path if there is one; without a penalty it is a
    shortest one.

    Args:
        free: (rows, cols), True where free.
        penalty: (rows, cols) on the priority of cells.
        start: First cell, as row * cols + column.
        goal: Last cell, likewise.
        complete: Whether to search over cells and directions instead of as the
            original.

    Returns:
        Cells (n, 2) with both ends; empty if there is no path.
    """
    rows, cols = free.shape
    states_per_cell = 9 if complete else 1
    size = rows * cols * states_per_cell
    cost = np.full(size, np.inf)
    parent = np.full(size, -1, np.int64)
    direction = np.full(size, _NO_DIRECTION, np.int64)
    done = np.zeros(size, np.bool_)
    # Number of the heap entry that counts; earlier entries of a state are outdated.
    valid_entry = np.zeros(size, np.int64)

    first_state = start * states_per_cell + (_NO_DIRECTION if complete else 0)
    cost[first_state] = 0.0
    heap = [(0.0, 0, first_state)]
    entries = 1
    while len(heap) > 0:
        _, entry, state = heapq.heappop(heap)
        if done[state] or entry != valid_entry[state]:
            continue
        done[state] = True
        cell = state // states_per_cell
        if cell == goal:
            return trace(parent, state, states_per_cell, cols)

        previous = direction[state]
        for turn in _STRAIGHT_FIRST:
            angle = min((turn - previous) % 8, (previous - turn) % 8)
            if previous != _NO_DIRECTION and angle > LARGEST_TURN:
                continue
            target = _step(free, cell, turn)
            if target < 0:
                continue

            target_state = target * states_per_cell + (turn if complete else 0)
            new_cost = cost[state] + _LENGTHS[turn]
            if new_cost >= cost[target_state] or done[target_state]:
                continue
            # Without a heuristic where the original has none.
            remaining = 0.0
            if complete or cost[target_state] < np.inf:
                remaining = _remaining(target, goal, cols, complete)
            cost[target_state] = new_cost
            parent[target_state] = state
            direction[target_state] = turn
            valid_entry[target_state] = entries
            priority = new_cost + remaining + penalty[target // cols, target % cols]
            # Of equal priorities the older entry comes first.
            heapq.heappush(heap, (priority, entries, target_state))
            entries += 1
    return np.empty((0, 2), np.int64)


@strict_kernel
def _step(free: BoolGrid, cell: int, direction: int) -> int:
    """Return the neighbor's index (row * cols + column), -1 if it is blocked."""
    rows, cols = free.shape
    row = cell // cols
    column = cell % cols
    r = row + _ROW_STEPS[direction]
    c = column + _COLUMN_STEPS[direction]
    if not (0 <= r < rows and 0 <= c < cols) or not free[r, c]:
        return -1
    # Not between two occupied cells that touch at a corner.
    if not free[row, c] and not free[r, column]:
        return -1
    target: int = r * cols + c
    return target


@strict_kernel
def _remaining(cell: int, goal: int, cols: int, octile: bool) -> float:
    """Return a cell's distance to the goal in cells, octile or Euclidean."""
    rows_left = abs(cell // cols - goal // cols)
    columns_left = abs(cell % cols - goal % cols)
    if octile:
        diagonal = (math.sqrt(2.0) - 1.0) * min(rows_left, columns_left)
        return max(rows_left, columns_left) + diagonal
    return math.sqrt(rows_left * rows_left + columns_left * columns_left)


@strict_kernel
def trace(parent: Integers, last: int, states_per_cell: int, cols: int) -> Cells:
    """Return the cells (n, 2) from a search's first state to state `last`, inclusive.

    Args:
        parent: The state before each state, below 0 for the first one.
        last: State to go back from.
        states_per_cell: States that each cell has; they follow each other.
        cols: Columns of the grid, whose cells are numbered row by row.
    """
    # Numba infers the type of the list from its first entry, which is dropped below.
    path = [(0, 0)]
    state = last
    while state >= 0:
        cell = state // states_per_cell
        path.append((cell // cols, cell % cols))
        state = parent[state]
    return np.array(path[:0:-1])
