"""The search behind `barn_worlds.path_planner`, compiled.

Cells are numbered in reading order (row * cols + column), directions are multiples of 45 degrees from +column towards
+row. The search allows turns of at most `largest_turn` x 45 degrees and resolves ties in order of discovery, so the
same input gives the same path.
"""

import heapq
import math

import numpy as np
from numba import njit

from barn_worlds.arrays import BoolGrid, Cells, Floats, Integers

_DOWN = np.array([0, 1, 1, 1, 0, -1, -1, -1])
_RIGHT = np.array([1, 1, 0, -1, -1, -1, 0, 1])
_LENGTH = np.hypot(_DOWN, _RIGHT)
_STRAIGHT_FIRST = np.array([0, 4, 2, 6, 1, 3, 7, 5])
_NO_DIRECTION = 8


@njit(cache=True)
def search(free: BoolGrid, penalty: Floats, start: int, goal: int, largest_turn: int, complete: bool) -> Cells:
    """Return a path (n, 2) of free cells (rows, cols), expanded in order of cost so far plus penalty; empty if none.

    Unless complete, a cell keeps the neighbour from which it was discovered first. So the penalty, though not part of
    the cost, decides how a cell is reached, and because of the turn limit an existing path may be missed.
    complete: A* over pairs of cell and direction, with the octile distance as the heuristic. Then a path is found if
    there is one, without a penalty a shortest one.
    """
    rows, cols = free.shape
    states = 9 if complete else 1  # per cell
    cost = np.full(rows * cols * states, np.inf)
    parent = np.full(rows * cols * states, -1, np.int64)
    direction = np.full(rows * cols * states, _NO_DIRECTION, np.int64)
    done = np.zeros(rows * cols * states, np.bool_)
    first = start * states + (_NO_DIRECTION if complete else 0)
    cost[first] = 0.0
    heap = [(0.0, 0, first)]
    pushed = 1
    while len(heap) > 0:
        _, _, state = heapq.heappop(heap)
        if done[state]:
            continue
        done[state] = True
        cell = state // states
        if cell == goal:
            return _trace(parent, state, states, cols)
        for turn in _STRAIGHT_FIRST:
            if _turned(direction[state], turn) > largest_turn:
                continue
            target = _step(free, cell, turn)
            if target < 0:
                continue
            reached = target * states + (turn if complete else 0)
            new_cost = cost[state] + _LENGTH[turn]
            if new_cost < cost[reached] and not done[reached] and (complete or cost[reached] == np.inf):
                cost[reached], parent[reached], direction[reached] = new_cost, state, turn
                remaining = _octile(target, goal, cols) if complete else 0.0
                heapq.heappush(heap, (new_cost + remaining + penalty[target // cols, target % cols], pushed, reached))
                pushed += 1
    return np.empty((0, 2), np.int64)


@njit(cache=True)
def _turned(before: int, after: int) -> int:
    """Return the turn of a step in multiples of 45 degrees; 0 for the first step."""
    if before == _NO_DIRECTION:
        return 0
    return min((after - before) % 8, (before - after) % 8)


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
def _octile(cell: int, goal: int, cols: int) -> float:
    """Return the octile distance."""
    down = abs(cell // cols - goal // cols)
    right = abs(cell % cols - goal % cols)
    return max(down, right) + (math.sqrt(2.0) - 1.0) * min(down, right)


@njit(cache=True)
def _trace(parent: Integers, last: int, states_per_cell: int, cols: int) -> Cells:
    """Return the cells (n, 2) from the start to the state `last`."""
    count = 0
    state = last
    while state >= 0:
        count += 1
        state = parent[state]
    path = np.empty((count, 2), np.int64)
    state = last
    for k in range(count - 1, -1, -1):
        cell = state // states_per_cell
        path[k, 0], path[k, 1] = cell // cols, cell % cols
        state = parent[state]
    return path
