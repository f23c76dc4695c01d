"""The path through a world: planned on the C-space with limited turns (paper, section III-A)."""

import heapq
import math

import numpy as np
from numba import njit

from barn_worlds.base.arrays import BoolGrid, Cells, Floats, Integers
from barn_worlds.base.errors import WorldError
from barn_worlds.worlds.cspace import through_region

_DOWN = np.array([0, 1, 1, 1, 0, -1, -1, -1])
_RIGHT = np.array([1, 1, 0, -1, -1, -1, 0, 1])
_LENGTH = np.hypot(_DOWN, _RIGHT)
_STRAIGHT_FIRST = np.array([0, 4, 2, 6, 1, 3, 7, 5])
_NO_DIRECTION = 8


# With these all 50 of the shared paths are repeated cell by cell, apart from their first cell, which is there twice.
LARGEST_TURN = 1  # between two steps, in steps of 45 degrees
INFLATION_CELLS, INFLATION_WEIGHT = (
    2.0,
    5.0,
)  # cells this close to obstacles are searched later, by weight / distance


def plan_path(
    cspace: BoolGrid, start: tuple[int, int], goal: tuple[int, int]
) -> Cells | None:
    """Return a path (n, 2) of free cells from start to goal, both included, or None if there is none.

    Steps go to the 8 neighbours, but not between two occupied cells that touch at a corner; turns are limited. The
    inflation term affects a cell's priority but not its cost. Where the original's search finds nothing, A* over cells
    and directions finds a path if there is one. Raises WorldError for a cell outside the grid.
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
    first, last = start[0] * cols + start[1], goal[0] * cols + goal[1]
    penalty = inflation(cspace)
    for complete in (False, True):
        path: Cells = search(free, penalty, first, last, complete)
        if len(path):
            return path
    return None


def plan_through(cspace: BoolGrid) -> Cells | None:
    """Return a path (n, 2) from the first to the last column, or None if there is none.

    Its ends are the cells of the region that leads through that are closest to its middle (the lower row of two).
    """
    region = through_region(cspace)
    if region is None:
        return None
    ends = [np.flatnonzero(region[:, column]) for column in (0, -1)]
    start, goal = (int(rows[np.argmin(np.abs(rows - rows.mean()))]) for rows in ends)
    return plan_path(cspace, (start, 0), (goal, cspace.shape[1] - 1))


def inflation(cspace: BoolGrid) -> Floats:
    """Return the penalty on each cell's priority (rows, cols): weight / distance, 0 beyond the inflation distance.

    Distances are Euclidean, in cells, to occupied C-space cells; the border of the grid is no obstacle.
    """
    rows, cols = cspace.shape
    reach = math.floor(INFLATION_CELLS)
    padded = np.pad(cspace, reach)
    penalty = np.zeros((rows, cols))
    for down in range(-reach, reach + 1):
        for right in range(-reach, reach + 1):
            distance = math.hypot(down, right)
            if 0.0 < distance <= INFLATION_CELLS:
                near = padded[
                    reach + down : reach + down + rows,
                    reach + right : reach + right + cols,
                ]
                np.maximum(penalty, near * (INFLATION_WEIGHT / distance), out=penalty)
    return penalty


@njit(cache=True)
def search(
    free: BoolGrid, penalty: Floats, start: int, goal: int, complete: bool
) -> Cells:
    """Return a path (n, 2) of free cells (rows, cols), expanded in order of cost so far plus penalty; empty if none.

    Unless complete, it is the search of the original. A cell is discovered without a heuristic. An open cell that is
    then reached at less cost changes its predecessor, and gets a priority with the Euclidean distance to the goal. So
    the first discovery nearly always decides, and because of the turn limit an existing path may be missed.
    complete: A* over pairs of cell and direction, with the octile distance as the heuristic. Then a path is found if
    there is one, without a penalty a shortest one.
    """
    rows, cols = free.shape
    states = 9 if complete else 1  # per cell
    size = rows * cols * states
    cost, parent, direction = (
        np.full(size, np.inf),
        np.full(size, -1, np.int64),
        np.full(size, _NO_DIRECTION, np.int64),
    )
    done, entry = (
        np.zeros(size, np.bool_),
        np.zeros(size, np.int64),
    )  # the heap's entry that counts, not an older one
    first = start * states + (_NO_DIRECTION if complete else 0)
    cost[first] = 0.0
    heap = [(0.0, 0, first)]
    pushed = 1
    while len(heap) > 0:
        _, number, state = heapq.heappop(heap)
        if done[state] or number != entry[state]:
            continue
        done[state] = True
        cell = state // states
        if cell == goal:
            return _trace(parent, state, states, cols)
        for turn in _STRAIGHT_FIRST:
            before = direction[state]
            if (
                before != _NO_DIRECTION
                and min((turn - before) % 8, (before - turn) % 8) > LARGEST_TURN
            ):
                continue
            target = _step(free, cell, turn)
            if target < 0:
                continue
            reached = target * states + (turn if complete else 0)
            new_cost = cost[state] + _LENGTH[turn]
            if new_cost < cost[reached] and not done[reached]:
                known = complete or cost[reached] < np.inf
                remaining = _remaining(target, goal, cols, complete) if known else 0.0
                cost[reached], parent[reached], direction[reached] = (
                    new_cost,
                    state,
                    turn,
                )
                entry[reached] = pushed
                heapq.heappush(
                    heap,
                    (
                        new_cost + remaining + penalty[target // cols, target % cols],
                        pushed,
                        reached,
                    ),
                )
                pushed += 1
    return np.empty((0, 2), np.int64)


@njit(cache=True)
def _step(free: BoolGrid, cell: int, direction: int) -> int:
    """Return the neighbouring cell in a direction, -1 if it may not be entered."""
    rows, cols = free.shape
    row, column = cell // cols, cell % cols
    r, c = row + _DOWN[direction], column + _RIGHT[direction]
    if not (0 <= r < rows and 0 <= c < cols) or not free[r, c]:
        return -1
    if not free[row, c] and not free[r, column]:
        return -1
    target: int = r * cols + c
    return target


@njit(cache=True)
def _remaining(cell: int, goal: int, cols: int, octile: bool) -> float:
    """Return the distance to the goal in cells, straight or by steps to the 8 neighbours."""
    down, right = abs(cell // cols - goal // cols), abs(cell % cols - goal % cols)
    if octile:
        return max(down, right) + (math.sqrt(2.0) - 1.0) * min(down, right)
    return math.sqrt(down * down + right * right)


@njit(cache=True)
def _trace(parent: Integers, last: int, states_per_cell: int, cols: int) -> Cells:
    """Return the cells (n, 2) from the start to the state `last`."""
    path, state = [(0, 0)], last
    while state >= 0:
        path.append((state // states_per_cell // cols, state // states_per_cell % cols))
        state = parent[state]
    return np.array(path[:0:-1])
