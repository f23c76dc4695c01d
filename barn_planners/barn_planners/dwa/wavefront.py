"""Steps around what blocks, to the plan and to its end; a wavefront spreads only as far as is asked for."""

import math
from typing import NamedTuple

import numpy as np
import numpy.typing as npt
from numba import njit

UNREACHED = np.int32(2**30)
OPEN, BLOCKED, REACHED = np.uint8(0), np.uint8(1), np.uint8(2)
HEAD, TAIL = (
    0,
    1,
)  # of the queue: the place from which it goes on, and the number of cells in it


class Wavefront(NamedTuple):
    """Flat arrays of a grid padded by one blocked cell: cell = (row + 1) * columns + column + 1 of the padded grid."""

    distances: npt.NDArray[
        np.int32
    ]  # steps from the nearest seed, where the wavefront has come
    state: npt.NDArray[np.uint8]  # OPEN, BLOCKED or REACHED
    queue: npt.NDArray[np.int32]  # cells that it has reached, in order
    ends: npt.NDArray[np.int64]  # HEAD and TAIL of the queue
    columns: int


def new_wavefront(rows: int, cols: int) -> Wavefront:
    """Return a wavefront on a grid of rows x columns cells."""
    size = (rows + 2) * (cols + 2)
    cells = np.empty(size, np.int32), np.empty(size, np.uint8), np.empty(size, np.int32)
    return Wavefront(*cells, np.zeros(2, np.int64), cols + 2)


@njit(cache=True)
def blocked(costs, first, spans, state):  # type: ignore[no-untyped-def]
    """Write to `state` (padded, flat) where a cell costs 253 or more, but for those of `footprint_spans`."""
    rows, cols = costs.shape
    width = cols + 2
    state[:] = BLOCKED
    for row in range(rows):
        line, here = costs[row], state[(row + 1) * width + 1 : (row + 2) * width - 1]
        for col in range(cols):
            here[col] = BLOCKED if line[col] >= 253 else OPEN
    for k in range(len(spans)):
        col = first + k
        if 0 <= col < cols:
            for row in range(max(0, spans[k, 0]), min(rows, spans[k, 1] + 1)):
                state[(row + 1) * width + col + 1] = OPEN


@njit(cache=True)
def plan_cells(plan, origin_x, origin_y, resolution, rows, cols, cells):  # type: ignore[no-untyped-def]
    """Write the padded cells under the part of a plan (n, 2 or more) on the grid to `cells`; return their number."""
    count = 0
    for k in range(len(plan)):
        before = max(0, k - 1)
        length = math.hypot(plan[k, 0] - plan[before, 0], plan[k, 1] - plan[before, 1])
        pieces = max(1, math.ceil(length / resolution + 1e-6))
        for piece in range(1, pieces + 1):
            part = piece / pieces
            x = plan[before, 0] + part * (plan[k, 0] - plan[before, 0])
            y = plan[before, 1] + part * (plan[k, 1] - plan[before, 1])
            row = math.floor((y - origin_y) / resolution)
            col = math.floor((x - origin_x) / resolution)
            if 0 <= row < rows and 0 <= col < cols:
                cell = (row + 1) * (cols + 2) + col + 1
                if count == 0 or cells[count - 1] != cell:
                    if count == len(cells):
                        return count
                    cells[count] = cell
                    count += 1
            elif count:
                return count
    return count


@njit(cache=True)
def begin(front, blocked_cells, seeds):  # type: ignore[no-untyped-def]
    """Let a wavefront start anew from its seeds, 0 wherever they are; blocked_cells: as `blocked` writes it."""
    distances, state, queue = front.distances, front.state, front.queue
    for cell in range(
        len(state)
    ):  # an assignment of the whole would take ten times as long
        state[cell] = blocked_cells[cell]
    tail = 0
    for seed in seeds:
        if state[seed] != REACHED:
            distances[seed], state[seed] = 0, REACHED
            queue[tail] = seed
            tail += 1
    front.ends[HEAD], front.ends[TAIL] = 0, tail


@njit(cache=True)
def steps_to(front, cell):  # type: ignore[no-untyped-def]
    """Return the 4-connected steps from the nearest seed to a cell, UNREACHED if there is no way."""
    cell = np.uint64(cell)
    if front.state[cell] == OPEN:
        _spread(front, cell)
    return front.distances[cell] if front.state[cell] == REACHED else UNREACHED


@njit(cache=True)
def borders_reached(front, cell):  # type: ignore[no-untyped-def]
    """Tell whether a cell without a way to it lies beside one that the wavefront reaches."""
    for other in (cell - 1, cell + 1, cell - front.columns, cell + front.columns):
        if steps_to(front, other) < UNREACHED:
            return True
    return False


@njit(cache=True)
def _spread(front, wanted):  # type: ignore[no-untyped-def]
    distances, state, queue = front.distances, front.state, front.queue
    one, row = np.uint64(1), np.uint64(front.columns)
    head, tail = np.uint64(front.ends[HEAD]), np.uint64(front.ends[TAIL])
    while head < tail and state[wanted] == OPEN:
        cell = np.uint64(queue[head])
        head += one
        steps = distances[cell] + np.int32(1)
        for other in (cell - one, cell + one, cell - row, cell + row):
            # nothing branches on a state: half of such branches would be guessed wrongly
            is_open = state[other] == OPEN
            distances[other] = steps if is_open else distances[other]
            state[other] = REACHED if is_open else state[other]
            queue[tail] = other
            tail += np.uint64(is_open)
    front.ends[HEAD], front.ends[TAIL] = head, tail


@njit(cache=True)
def least_beyond(front):  # type: ignore[no-untyped-def]
    """Return a number of steps that no cell is nearer than, of those that the wavefront has not reached."""
    head = front.ends[HEAD]
    return front.distances[front.queue[head]] if head < front.ends[TAIL] else UNREACHED
