"""Kernels of the global plan: growing a potential, poses, parts of a plan.

The potential follows navfn (navfn.cpp, `propNavFnAstar` and `updateCell`). Grids are
flat: cell = row * columns + column.
"""

import math
from collections.abc import Callable
from typing import NamedTuple

import numpy as np
import numpy.typing as npt
from numba import njit

from barn_planners.costmap.kernels import Grid
from barn_worlds.base.arrays import Bytes, Floats, Integers, MediumIntegers, kernel

UNREACHED = 1.0e10
BLOCKED_PRICE = 254.0  # navfn's COST_OBS, one above the highest price
NOWHERE = (1, -1, 1, 1)  # a window without cells, also with a margin of one cell

# Columns of a window, the rows and columns that a potential has touched, half open.
ROW, END_ROW, COL, END_COL = range(4)

# float64, or float32 as in navfn.
Potential = npt.NDArray[np.floating]


class Terrain(NamedTuple):
    """What it costs to enter the cells of a grid."""

    costs: Bytes  # by cell
    columns: int
    prices: Potential  # by cost, inf where blocked, (256,)
    # By cost: how far the potential of a cell must be able to fall for the cell to wait
    # for it, (256,).
    gains: Potential


class Ends(NamedTuple):
    """Cells of the robot, which may be on the border, and of the goal."""

    start: int
    goal: int


class Growth(NamedTuple):
    """Constants of a search, in prices."""

    # Cells below a limit come first; the limit rises by steps.
    first_limit: float
    limit_step: float
    rounds: int  # highest number of rounds
    neutral: float  # price of a free cell
    least: float  # by so much a potential grows per cell at least
    slack: float  # what potentials may fall short of that


class Focus(NamedTuple):
    """Which cells a search prefers and skips, by the distance to the goal in cells."""

    order: float  # price per cell for the order, as in A*; 0: by potential alone
    bounding: float  # price per cell to add before comparing with the bound
    bound: float  # cells beyond it are skipped


class Memory(NamedTuple):
    """Memory for plans on a grid of one size; [0] is of the first search."""

    potentials: Potential  # (2, cells), UNREACHED where no search has been
    pending: Bytes  # by cell: 1 on the border and while a cell waits, else 0
    queues: MediumIntegers  # (3, cells)
    costs: Bytes  # by cell: the cost that the last search saw, within its windows
    windows: Integers  # (2, 4): what the potentials have touched


class _Queues(NamedTuple):
    """First place and end of three queues in one array."""

    current: np.uint64  # cells of this round
    current_end: np.uint64
    following: np.uint64  # cells of the next one
    following_end: np.uint64
    beyond: np.uint64  # cells beyond the limit
    beyond_end: np.uint64


class _Extent(NamedTuple):
    """What a potential has touched, in rows and columns from the goal."""

    first_row: float
    last_row: float
    first_col: float
    last_col: float


def new_memory(rows: int, cols: int, dtype: type[np.floating]) -> Memory:
    """Return memory for plans on a grid of rows x cols, whose border never waits.

    Args:
        rows: Number of rows of the grid.
        cols: Number of its columns.
        dtype: Type of potentials.
    """
    # Border cells never wait, so no search leaves the grid.
    pending = np.ones((rows, cols), np.uint8)
    pending[1:-1, 1:-1] = 0
    return Memory(
        np.full((2, rows * cols), UNREACHED, dtype),
        pending.ravel(),
        np.empty((3, rows * cols), np.int32),
        np.empty(rows * cols, np.uint8),
        np.array([NOWHERE, NOWHERE]),
    )


@njit(inline="always")
def _propagate(
    along: float, across: float, price: float, number: Callable[[float], float]
) -> float:
    """Return a cell's potential from the lower neighbor on each axis and its price.

    The polynomial is navfn's approximation of a plane wave.
    """
    low = min(along, across)
    apart = max(along, across) - low
    q = apart / price
    # navfn fitted it once; the digits are part of its plans.
    value = low + price * number(-0.2301 * q * q + 0.5307 * q + 0.7040)
    # Neighbors so far apart mean a wave along one axis: the higher one adds nothing.
    return low + price if apart >= price else value


@njit(inline="always")
def _queue(
    costs: Bytes,
    gains: Potential,
    pending: Bytes,
    queue: MediumIntegers,
    neighbor: np.uint64,
    present: float,
    value: float,
    end: np.uint64,
) -> np.uint64:
    """Append `neighbor` to the queue if it can gain from `value`; return the new end.

    It gains if its potential can fall enough below `present`.
    """
    can_gain = present > value + gains[costs[neighbor]]
    waits = np.uint8(can_gain) & np.uint8(pending[neighbor] == 0)
    # Written in any case, without a branch; it counts only if the end moves on.
    queue[end] = neighbor
    pending[neighbor] |= waits
    new_end: np.uint64 = end + np.uint64(waits)
    return new_end


@njit(inline="always")
def _release(
    pending: Bytes, queue: MediumIntegers, first: np.uint64, end: np.uint64
) -> None:
    """Let the cells of a queue from `first` to before `end` wait no longer."""
    for k in range(first, end):
        pending[np.uint64(queue[k])] = 0


@kernel
def grow(
    terrain: Terrain,
    ends: Ends,
    growth: Growth,
    focus: Focus,
    memory: Memory,
    index: int,
) -> None:
    """Grow a potential in place from the robot until it reaches the goal or runs out.

    Cells wait in two queues: those below a rising limit come first, in rounds. A cell
    whose value falls queues the neighbors that could gain from it.

    Args:
        terrain: What cells cost.
        ends: Cells to start from and to reach.
        growth: Limits, and the number of rounds.
        focus: Which cells to prefer and to skip.
        memory: Memory for plans.
        index: Number of the potential in the memory; it is UNREACHED everywhere.
    """
    costs, columns, _, gains = terrain
    potential = memory.potentials[index]
    pending = memory.pending
    queue = memory.queues.reshape(memory.queues.size)
    number = potential.dtype.type
    unit = np.uint64(1)
    row = np.uint64(columns)
    size = np.uint64(len(potential))

    cell = np.uint64(ends.start)
    potential[cell] = 0.0
    end = np.uint64(0)
    for neighbor in (cell - unit, cell + unit, cell - row, cell + row):
        # A start on the border has neighbors off the grid.
        if neighbor < size:
            far = number(UNREACHED)
            end = _queue(costs, gains, pending, queue, neighbor, far, number(0.0), end)

    start_row = ends.start // columns - float(ends.goal // columns)
    start_col = ends.start % columns - float(ends.goal % columns)
    extent = _Extent(
        min(0.0, start_row),
        max(0.0, start_row),
        min(0.0, start_col),
        max(0.0, start_col),
    )
    # The order counts from the robot's straight distance on, as in A*.
    limit = growth.first_limit + focus.order * math.hypot(start_row, start_col)
    queues = _Queues(np.uint64(0), end, size, size, size + size, size + size)
    rounds = growth.rounds
    while queues.current_end > queues.current and rounds > 0:
        rounds -= 1
        _release(pending, queue, queues.current, queues.current_end)
        following_end, beyond_end, extent = _take_round(
            terrain, ends.goal, focus, limit, potential, pending, queue, queues, extent
        )
        # What follows is next; if nothing does, the limit rises to what lies beyond.
        current, _, following, _, beyond, _ = queues
        queues = _Queues(following, following_end, current, current, beyond, beyond_end)
        if following_end == following:
            limit += growth.limit_step
            queues = _Queues(beyond, beyond_end, current, current, following, following)
        if potential[ends.goal] < UNREACHED:
            break

    _release(pending, queue, queues.current, queues.current_end)
    _release(pending, queue, queues.beyond, queues.beyond_end)
    window = memory.windows[index]
    window[ROW] = int(extent.first_row + ends.goal // columns)
    window[END_ROW] = int(extent.last_row + ends.goal // columns) + 1
    window[COL] = int(extent.first_col + ends.goal % columns)
    window[END_COL] = int(extent.last_col + ends.goal % columns) + 1


@kernel
def _take_round(
    terrain: Terrain,
    goal: int,
    focus: Focus,
    limit: float,
    potential: Potential,
    pending: Bytes,
    queue: MediumIntegers,
    queues: _Queues,
    extent: _Extent,
) -> tuple[np.uint64, np.uint64, _Extent]:
    """Compute potentials of current cells, queue neighbors; return new ends and extent.

    For speed, indices are unsigned, queueing is inlined, and nothing branches on a
    potential: half of these branches would be mispredicted.

    Returns:
        New ends of the queues of cells below and beyond the limit, and the extent.
    """
    costs, columns, prices, gains = terrain
    order, bounding, bound = focus
    number = potential.dtype.type
    unit = np.uint64(1)
    row = np.uint64(columns)
    goal_row = float(goal // columns)
    goal_col = float(goal % columns)
    width = float(columns)
    rows_per_cell = 1.0 / columns
    following_end = queues.following_end
    beyond_end = queues.beyond_end
    first_row, last_row, first_col, last_col = extent
    for k in range(queues.current, queues.current_end):
        cell = np.uint64(queue[k])
        left = potential[cell - unit]
        right = potential[cell + unit]
        down = potential[cell - row]
        up = potential[cell + row]
        before = potential[cell]
        price = prices[costs[cell]]
        value = _propagate(min(left, right), min(down, up), price, number)

        # A division of integers would take longer.
        place = float(queue[k])
        cell_row = np.floor((place + 0.5) * rows_per_cell)
        d_row = cell_row - goal_row
        d_col = place - cell_row * width - goal_col
        first_row = min(first_row, d_row)
        last_row = max(last_row, d_row)
        first_col = min(first_col, d_col)
        last_col = max(last_col, d_col)
        away = math.sqrt(d_row * d_row + d_col * d_col)

        in_bound = np.uint8(value + bounding * away <= bound)
        falls = np.uint8(value < before) & in_bound
        potential[cell] = value if falls else before
        source = value if falls else number(np.inf)
        near = value + order * away < limit
        end = following_end if near else beyond_end
        end = _queue(costs, gains, pending, queue, cell - unit, left, source, end)
        end = _queue(costs, gains, pending, queue, cell + unit, right, source, end)
        end = _queue(costs, gains, pending, queue, cell - row, down, source, end)
        end = _queue(costs, gains, pending, queue, cell + row, up, source, end)
        following_end = end if near else following_end
        beyond_end = beyond_end if near else end

    return following_end, beyond_end, _Extent(first_row, last_row, first_col, last_col)


@kernel
def search(
    terrain: Terrain, ends: Ends, growth: Growth, is_bounded: bool, memory: Memory
) -> bool:
    """Grow potentials[1] anew from start to goal; return whether it has arrived there.

    Args:
        terrain: What cells cost.
        ends: Cells to start from and to reach.
        growth: Constants of the search.
        is_bounded: Whether to grow potentials[0] straight to the goal first, and then
            to skip cells that are too far from the way for that.
        memory: Memory for plans, which keeps what the search has seen.

    Returns:
        Whether the potential has reached the goal.
    """
    columns = terrain.columns
    windows = memory.windows
    for k in range(2):
        forget(memory.potentials[k], columns, windows[k])
        for side in range(4):
            windows[k, side] = NOWHERE[side]

    # The first search finds one way; cells from which the way cannot be as short are of
    # no use to the second, whose potential the plan follows.
    bound = np.inf
    if is_bounded:
        grow(terrain, ends, growth, Focus(growth.neutral, 0.0, np.inf), memory, 0)
        # The first search need not be exact, since its way is only an upper bound.
        bound = memory.potentials[0, ends.goal] + growth.slack
    if not is_bounded or bound < UNREACHED:
        grow(terrain, ends, growth, Focus(0.0, growth.least, bound), memory, 1)

    # What lies beside a potential has stopped it, so it counts as seen, too.
    for k in range(2):
        for row in range(windows[k, ROW] - 1, windows[k, END_ROW] + 1):
            first = row * columns + windows[k, COL] - 1
            end = row * columns + windows[k, END_COL] + 1
            source = terrain.costs[first:end]
            target = memory.costs[first:end]
            for cell in range(len(source)):
                target[cell] = source[cell]

    is_reached: bool = memory.potentials[1, ends.goal] < UNREACHED
    return is_reached


@kernel
def is_same(terrain: Terrain, memory: Memory) -> bool:
    """Return whether no price has changed where the last search came or beside it.

    Args:
        terrain: What cells cost now.
        memory: Memory of the search.

    Returns:
        False if a price has changed where a potential has come or beside it.
    """
    costs, columns, prices, _ = terrain
    last_costs = memory.costs
    last_row = len(costs) // columns - 1
    for k in range(2):
        potential = memory.potentials[k]
        window = memory.windows[k]
        for row in range(max(window[ROW] - 1, 1), min(window[END_ROW] + 1, last_row)):
            first = row * columns + window[COL] - 1
            end = row * columns + window[END_COL] + 1

            # Most rows have not changed, which a loop without a branch tells quickly.
            source = costs[first:end]
            target = last_costs[first:end]
            differs = False
            for cell in range(len(source)):
                differs |= source[cell] != target[cell]
            if not differs:
                continue

            # Costs with the same price make no difference.
            for cell in range(first, end):
                if prices[costs[cell]] == prices[last_costs[cell]]:
                    continue
                least = min(
                    potential[cell],
                    potential[cell - 1],
                    potential[cell + 1],
                    potential[cell - columns],
                    potential[cell + columns],
                )
                if least < UNREACHED:
                    return False

    return True


@kernel
def forget(potential: Potential, columns: int, window: Integers) -> None:
    """Set a potential back to UNREACHED within a half-open window, in place.

    Args:
        potential: Potential by cell.
        columns: Number of columns of the grid.
        window: Window (4,) of what the potential has touched.
    """
    for row in range(window[ROW], window[END_ROW]):
        first = row * columns + window[COL]
        end = row * columns + window[END_COL]
        potential[first:end] = UNREACHED


@kernel
def poses_along(
    points: Floats, grid: Grid, goal_x: float, goal_y: float, half_cell: float
) -> tuple[Floats, Floats]:
    """Return poses (n + 1, 3) from start to goal without yaws, and steps (n, 2) in m.

    Args:
        points: Points (n, 2) from goal to start, column and row.
        grid: Place of the costmap.
        goal_x: Goal in m, as `goal_y`, which becomes the last pose.
        goal_y: Goal in m.
        half_cell: Offset of a point from the corner of its cell, in cells.

    Returns:
        Poses (n + 1, 3) from start to goal, x and y in m, yaw 0, but that of the last
        pose is not set; steps (n, 2) from each pose to the next in m.
    """
    n = len(points)
    poses = np.zeros((n + 1, 3))
    # The path leads from the goal to the robot, the plan the other way.
    for k in range(n):
        poses[k, 0] = grid.x + (points[n - 1 - k, 0] + half_cell) * grid.resolution
        poses[k, 1] = grid.y + (points[n - 1 - k, 1] + half_cell) * grid.resolution
    poses[n, 0] = goal_x
    poses[n, 1] = goal_y
    return poses, poses[1:, :2] - poses[:-1, :2]


@kernel
def visible_points(plan: Floats, x: float, y: float, radius: float) -> tuple[int, int]:
    """Return first and end index of a plan's first part in a circle, (0, 0) if none.

    The part begins where the plan first enters the circle and ends where it leaves it.

    Args:
        plan: Points (n, 2 or more), x and y in m.
        x: Center of the circle in m, as `y`.
        y: Center of the circle in m.
        radius: Radius of the circle in m.
    """
    first = 0
    while first < len(plan) and not (
        math.hypot(plan[first, 0] - x, plan[first, 1] - y) <= radius
    ):
        first += 1
    if first == len(plan):
        return 0, 0

    end = first
    while end < len(plan) and math.hypot(plan[end, 0] - x, plan[end, 1] - y) <= radius:
        end += 1
    return first, end


@kernel
def passed_points(plan: Floats, x: float, y: float, distance: float) -> int:
    """Return how many points of a plan come before the first one near a place, or all.

    Args:
        plan: Points (n, 2 or more), x and y in m.
        x: Place in m, as `y`.
        y: Place in m.
        distance: Points nearer than this are near, in m.

    Returns:
        All points if none is near.
    """
    for k in range(len(plan)):
        if math.hypot(plan[k, 0] - x, plan[k, 1] - y) < distance:
            return k
    return len(plan)
