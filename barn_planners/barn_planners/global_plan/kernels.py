"""Compiled loops of the global plan on flat grids (cell = row * cols + column): growing a potential, poses."""

import math

import numpy as np
from numba import njit

UNREACHED = 1.0e10
ROW, END_ROW, COL, END_COL = range(4)  # of a window: what was touched, half open
NOWHERE = (1, -1, 1, 1)  # a window without cells, also one cell larger on each side


@njit(inline="always")
def _propagate(along, across, price, kind):  # type: ignore[no-untyped-def]
    """Return the potential of a cell from the lower neighbour of each axis and its own price, all of one kind."""
    low, apart = min(along, across), max(along, across) - min(along, across)
    q = apart / price
    value = low + price * kind(-0.2301 * q * q + 0.5307 * q + 0.7040)
    return low + price if apart >= price else value


@njit(inline="always")
def _queue(other, there, told, gain, costs, pending, queue, end):  # type: ignore[no-untyped-def]
    """Queue a neighbour, whose potential is `there`, if it can gain from `told`; return the queue's new end."""
    gains = np.uint8(there > told + gain[costs[other]]) & np.uint8(pending[other] == 0)
    queue[end] = other
    pending[other] |= gains
    return end + np.uint64(gains)


@njit(inline="always")
def _release(pending, queue, first, end):  # type: ignore[no-untyped-def]
    for k in range(first, end):
        pending[np.uint64(queue[k])] = 0


@njit(cache=True, error_model="numpy")
def grow(  # type: ignore[no-untyped-def]
    costs, cols, prices, ends, focus, bound, limits, potential, pending, queues, window
):
    """Grow the potential from one of the two ends until the other is reached, nothing is left or all rounds are over.

    Cells wait in two queues: those below a rising limit are processed first, in rounds. A cell whose value falls queues
    those neighbours that could gain from it. prices: by costmap value, the cost of entering a cell (256,), inf where
    blocked, and by how much its potential must be able to fall for it to be queued (256,). limits: first limit, step by
    which it rises, number of rounds. focus: (for order, for bound), the least price per cell of the remaining distance.
    The limit is compared with the potential plus the first times the distance to the goal, as in A*; cells where the
    second makes it exceed `bound` are skipped. potential must be UNREACHED everywhere, pending 0 except 1 on the
    border; queues: (3, cells) work space. window: takes what was touched. For speed, indices are unsigned, what is
    queued is inlined, and nothing branches on a potential: half of such branches would be guessed wrongly.
    """
    (start, goal), (order, bounding), (first_limit, limit_step, rounds) = (
        ends,
        focus,
        limits,
    )
    (price, gain), kind = prices, potential.dtype.type
    one, row, size, queue = (
        np.uint64(1),
        np.uint64(cols),
        np.uint64(len(potential)),
        queues.reshape(queues.size),
    )
    goal_row, goal_col, width, per_cell = (
        float(goal // cols),
        float(goal % cols),
        float(cols),
        1.0 / cols,
    )
    start_row, start_col = (
        start // cols - goal_row,
        start % cols - goal_col,
    )  # rows and columns count from the goal
    row_lo, row_hi, col_lo, col_hi = (
        min(0.0, start_row),
        max(0.0, start_row),
        min(0.0, start_col),
        max(0.0, start_col),
    )
    limit = first_limit + order * math.hypot(start_row, start_col)
    current, following, beyond = (
        np.uint64(0),
        size,
        size + size,
    )  # where the queues begin
    current_end, following_end, beyond_end = current, following, beyond
    origin = np.uint64(start)
    potential[origin] = 0.0
    for other in (origin - one, origin + one, origin - row, origin + row):
        if other < size:  # the start may lie on the border
            current_end = _queue(
                other,
                kind(UNREACHED),
                kind(0.0),
                gain,
                costs,
                pending,
                queue,
                current_end,
            )
    while current_end > current and rounds > 0:
        rounds -= 1
        _release(pending, queue, current, current_end)
        for k in range(current, current_end):
            cell, number = np.uint64(queue[k]), float(queue[k])
            left, right = potential[cell - one], potential[cell + one]
            down, up = potential[cell - row], potential[cell + row]
            before = potential[cell]
            value = _propagate(
                min(left, right), min(down, up), price[costs[cell]], kind
            )
            cell_row = np.floor(
                (number + 0.5) * per_cell
            )  # a division of integers would take longer
            d_row, d_col = cell_row - goal_row, number - cell_row * width - goal_col
            row_lo, row_hi = min(row_lo, d_row), max(row_hi, d_row)
            col_lo, col_hi = min(col_lo, d_col), max(col_hi, d_col)
            away = math.sqrt(d_row * d_row + d_col * d_col)
            falls = np.uint8(value < before) & np.uint8(
                value + bounding * away <= bound
            )
            potential[cell] = value if falls else before
            told = value if falls else kind(np.inf)
            near = value + order * away < limit
            end = following_end if near else beyond_end
            end = _queue(cell - one, left, told, gain, costs, pending, queue, end)
            end = _queue(cell + one, right, told, gain, costs, pending, queue, end)
            end = _queue(cell - row, down, told, gain, costs, pending, queue, end)
            end = _queue(cell + row, up, told, gain, costs, pending, queue, end)
            following_end = end if near else following_end
            beyond_end = beyond_end if near else end
        current, following, current_end = following, current, following_end
        if current_end == current:
            limit += limit_step
            current, beyond, current_end = beyond, current, beyond_end
            beyond_end = beyond
        following_end = following
        if potential[goal] < UNREACHED:
            break
    _release(pending, queue, current, current_end)
    _release(pending, queue, beyond, beyond_end)
    window[ROW], window[END_ROW] = int(row_lo + goal_row), int(row_hi + goal_row) + 1
    window[COL], window[END_COL] = int(col_lo + goal_col), int(col_hi + goal_col) + 1


@njit(cache=True)
def search(costs, cols, prices, ends, bounded, neutral, limits, work):  # type: ignore[no-untyped-def]
    """Grow potentials[1] from the one end to the other, the goal; tell whether it was reached.

    bounded: first grow potentials[0] straight towards the goal, and skip cells that are too far off the way for that.
    limits: (first, step, rounds of `grow`, least growth per cell, slack of the bound). work: as `GlobalPlanner` has it.
    """
    potentials, pending, queues, seen, windows = work
    for k in range(2):
        forget(potentials[k], cols, windows[k])
        windows[k, ROW], windows[k, END_ROW], windows[k, COL], windows[k, END_COL] = (
            NOWHERE
        )
    first, whole, bound = potentials[0], potentials[1], np.inf
    (_, goal), (first_limit, limit_step, rounds, least, slack) = ends, limits
    growth = (first_limit, limit_step, rounds)
    if bounded:
        grow(
            costs,
            cols,
            prices,
            ends,
            (neutral, 0.0),
            bound,
            growth,
            first,
            pending,
            queues,
            windows[0],
        )
        bound = first[goal] + slack
    if not bounded or bound < UNREACHED:
        grow(
            costs,
            cols,
            prices,
            ends,
            (0.0, least),
            bound,
            growth,
            whole,
            pending,
            queues,
            windows[1],
        )
    for k in range(2):
        for row in range(windows[k, ROW] - 1, windows[k, END_ROW] + 1):
            low, high = (
                row * cols + windows[k, COL] - 1,
                row * cols + windows[k, END_COL] + 1,
            )
            now, then = costs[low:high], seen[low:high]
            for col in range(len(now)):
                then[col] = now[col]
    return whole[goal] < UNREACHED


@njit(cache=True)
def is_same(costs, cols, price, potentials, seen, windows):  # type: ignore[no-untyped-def]
    """Tell whether no price that the last `search` has looked at, where it came and beside it, has changed."""
    last_row = len(costs) // cols - 1
    for k in range(2):
        potential, window = potentials[k], windows[k]
        for row in range(max(window[ROW] - 1, 1), min(window[END_ROW] + 1, last_row)):
            low, high = row * cols + window[COL] - 1, row * cols + window[END_COL] + 1
            now, then, differs = costs[low:high], seen[low:high], False
            for col in range(len(now)):
                differs |= now[col] != then[col]
            if not differs:
                continue
            for cell in range(low, high):
                if price[costs[cell]] == price[seen[cell]]:
                    continue
                around = min(
                    potential[cell - 1],
                    potential[cell + 1],
                    potential[cell - cols],
                    potential[cell + cols],
                )
                if min(around, potential[cell]) < UNREACHED:
                    return False
    return True


@njit(cache=True)
def forget(potential, cols, window):  # type: ignore[no-untyped-def]
    """Set the cells of a window, as `grow` has left it, back to UNREACHED."""
    for row in range(window[ROW], window[END_ROW]):
        potential[row * cols + window[COL] : row * cols + window[END_COL]] = UNREACHED


@njit(cache=True)
def poses_along(points, frame, half_cell):  # type: ignore[no-untyped-def]
    """Return poses (n + 1, 3), yaw 0, of points in cells from goal to start (n, 2), and the steps (2, n) between."""
    n, (origin_x, origin_y, resolution, x, y) = len(points), frame
    poses, steps = np.empty((n + 1, 3)), np.empty((2, n))
    for k in range(n):
        poses[k, 0] = origin_x + (points[n - 1 - k, 0] + half_cell) * resolution
        poses[k, 1] = origin_y + (points[n - 1 - k, 1] + half_cell) * resolution
        poses[k, 2] = 0.0
    poses[n, 0], poses[n, 1] = x, y
    for k in range(n):
        steps[0, k], steps[1, k] = (
            poses[k + 1, 0] - poses[k, 0],
            poses[k + 1, 1] - poses[k, 1],
        )
    return poses, steps


@njit(cache=True)
def visible_points(plan, x, y, radius):  # type: ignore[no-untyped-def]
    """Return first and end of the points of a plan (n, 2 or more) within the radius, up to where it leaves it."""
    first = 0
    while (
        first < len(plan)
        and not math.hypot(plan[first, 0] - x, plan[first, 1] - y) <= radius
    ):
        first += 1
    if first == len(plan):
        return 0, 0
    end = first
    while end < len(plan) and math.hypot(plan[end, 0] - x, plan[end, 1] - y) <= radius:
        end += 1
    return first, end


@njit(cache=True)
def count_passed_points(plan, x, y, keep):  # type: ignore[no-untyped-def]
    """Return the number of points of a plan (n, 2 or more) before the first one nearer than `keep`; all if none is."""
    for k in range(len(plan)):
        if math.hypot(plan[k, 0] - x, plan[k, 1] - y) < keep:
            return k
    return len(plan)
