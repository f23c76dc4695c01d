"""Kernels that follow a potential down from the goal to the robot.

`descend_as_navfn` repeats navfn's `NavFn::calcPath` and `gradCell` (navfn.cpp);
`descend` has no orbits. Grids are flat: cell = row * columns + column.
"""

import math

import numpy as np

from barn_planners.global_plan.kernels import BLOCKED_PRICE, UNREACHED, Ends, Potential
from barn_worlds.base.arrays import Floats, Singles, kernel

# Range of the int in which the original keeps potentials that it compares.
_LARGEST_INTEGER = 2.0**31


@kernel
def _slope(potential: Potential, cell: int, step: int) -> float:
    """Return the descent at a cell, positive toward cell + step; 0 is level.

    At an unreached cell it is the price of a blocked one, towards a reached neighbor.
    """
    value = potential[np.uint64(cell)]
    before = potential[np.uint64(cell - step)]
    after = potential[np.uint64(cell + step)]
    # An obstacle itself: navfn lets the path slide off towards any side that is free.
    if value >= UNREACHED:
        if before < UNREACHED:
            return -BLOCKED_PRICE
        return BLOCKED_PRICE if after < UNREACHED else 0.0

    # The sum of one-sided differences, not their mean: only the direction counts.
    slope = 0.0
    if before < UNREACHED:
        slope += before - value
    if after < UNREACHED:
        slope += value - after
    return slope


@kernel
def _is_beside_wall(potential: Potential, columns: int, cell: int) -> bool:
    """Return whether a cell or one of its 8 neighbors is unreached or off the grid."""
    for d_row in (-1, 0, 1):
        for d_col in (-1, 0, 1):
            neighbor = cell + d_row * columns + d_col
            if (
                neighbor < 0
                or neighbor >= potential.size
                or potential[neighbor] >= UNREACHED
            ):
                return True
    return False


@kernel
def _unit_gradient(
    potential: Potential, columns: int, cell: int
) -> tuple[float, float]:
    """Return the unit descent (column, row) at a cell, zero on a plateau or border."""
    row = cell // columns
    col = cell % columns
    last_row = potential.size // columns - 1
    # Differences need neighbors on all four sides.
    if row < 1 or col < 1 or col >= columns - 1 or row >= last_row:
        return 0.0, 0.0

    along = _slope(potential, cell, 1)
    across = _slope(potential, cell, columns)
    norm = math.hypot(along, across)
    # On a plateau there is no direction; the caller then takes the lowest neighbor.
    if norm == 0.0:
        return 0.0, 0.0
    return along / norm, across / norm


@kernel
def _direction(
    potential: Potential, columns: int, x: float, y: float
) -> tuple[float, float]:
    """Return the descent (column, row) at x, y in cells, bilinear between four cells.

    It is not normalized.
    """
    row = math.floor(y)
    col = math.floor(x)
    fx = x - col
    fy = y - row
    dx = 0.0
    dy = 0.0
    for i in range(2):
        for j in range(2):
            corner = (row + i) * columns + col + j
            gx, gy = _unit_gradient(potential, columns, corner)
            weight = (fy if i else 1.0 - fy) * (fx if j else 1.0 - fx)
            dx += weight * gx
            dy += weight * gy
    return dx, dy


@kernel
def _lowest_neighbor(potential: Potential, columns: int, cell: int) -> int:
    """Return the index of the lowest of a cell and its 8 neighbors, all on the grid."""
    best = cell
    for d_row in (-1, 0, 1):
        for d_col in (-1, 0, 1):
            neighbor = cell + d_row * columns + d_col
            if potential[neighbor] < potential[best]:
                best = neighbor
    return best


@kernel
def descend(
    potential: Potential,
    columns: int,
    ends: Ends,
    step: float,
    neutral: float,
    points: Floats,
) -> int:
    """Write the path from goal to start down a potential; return how many points, or 0.

    Beside unreached cells, and where it would go to and fro, the path takes the center
    of the lowest neighbor.

    Args:
        potential: Potential by cell.
        columns: Number of columns of the grid.
        ends: The path leads from the goal to the start.
        step: Length of a step in cells.
        neutral: Price of a free cell; below it, the start is reached.
        points: Array (n, 2) that receives the path, column and row.

    Returns:
        Number of points, 0 on failure.
    """
    rows = potential.size // columns
    x = float(ends.goal % columns)
    y = float(ends.goal // columns)
    for n in range(len(points)):
        # Points count in cells from the center of the first one, so the nearest cell
        # rounds.
        row = math.floor(y + 0.5)
        col = math.floor(x + 0.5)
        if row < 0 or col < 0 or row >= rows or col >= columns:
            return 0

        cell = row * columns + col
        # Below the price of one cell only the start itself is left.
        if potential[cell] < neutral:
            points[n, 0] = float(ends.start % columns)
            points[n, 1] = float(ends.start // columns)
            return n + 1

        if row < 1 or col < 1 or row >= rows - 1 or col >= columns - 1:
            return 0

        points[n, 0] = x
        points[n, 1] = y
        # Steps that undo one another would never end.
        to_and_fro = n >= 2 and points[n - 2, 0] == x and points[n - 2, 1] == y
        dx = 0.0
        dy = 0.0
        if not to_and_fro and not _is_beside_wall(potential, columns, cell):
            dx, dy = _direction(potential, columns, x, y)

        norm = math.hypot(dx, dy)
        if norm > 0.0:
            # Steps have equal lengths, however steep the potential is.
            x += step * dx / norm
            y += step * dy / norm
            continue

        lowest = _lowest_neighbor(potential, columns, cell)
        # From a local minimum nothing leads on: a plan cannot be finished.
        is_stuck = lowest == cell and x == col and y == row
        if is_stuck or potential[lowest] >= UNREACHED:
            return 0
        x = float(lowest % columns)
        y = float(lowest // columns)

    return 0


@kernel
def descend_as_navfn(
    potential: Singles, columns: int, ends: Ends, neutral: float, points: Singles
) -> tuple[int, bool]:
    """Write navfn's path, in single precision; return how many points, and success.

    A place is a cell and offsets from its center. Gradients are interpolated, or
    extrapolated where an offset is negative, and only that cell's neighbors are looked
    at for walls. So the path may orbit.

    Args:
        potential: Potential by cell.
        columns: Number of columns of the grid.
        ends: The path leads from the goal to the start.
        neutral: Price of a free cell; below it, the start is reached.
        points: Array (n, 2) that receives the path, column and row.

    Returns:
        Number of points, and whether they reach the start.
    """
    size = potential.size
    cell = ends.goal
    dx = np.float32(0.0)
    dy = np.float32(0.0)
    for n in range(len(points)):
        nearest = cell + _round(dx) + columns * _round(dy)
        if potential[max(0, min(size - 1, nearest))] < neutral:
            points[n, 0] = ends.start % columns
            points[n, 1] = ends.start // columns
            return n + 1, True

        # navfn tests only the first and the last row; columns wrap around.
        if cell < columns or cell > size - columns:
            return n, False

        points[n, 0] = np.float32(cell % columns) + dx
        points[n, 1] = np.float32(cell // columns) + dy
        to_and_fro = (
            n >= 2
            and points[n - 2, 0] == points[n, 0]
            and points[n - 2, 1] == points[n, 1]
        )
        if to_and_fro or _is_beside_wall(potential, columns, cell):
            cell = _lowest_neighbor_as_navfn(potential, columns, cell)
            dx = np.float32(0.0)
            dy = np.float32(0.0)
            if potential[cell] >= UNREACHED:
                return n + 1, False
            continue

        x, y = _direction_as_navfn(potential, columns, cell, dx, dy)
        if x == 0.0 and y == 0.0:
            return n + 1, False

        # Half a cell on, then over to the next cell where that is more than one away.
        share = np.float32(0.5) / _length(x, y)
        whole_columns, dx = _split_offset(dx + x * share)
        whole_rows, dy = _split_offset(dy + y * share)
        cell += whole_columns + columns * whole_rows

    return len(points), False


@kernel
def _round(offset: np.float32) -> int:
    """Return an offset in (-1, 1) as the nearest integer, halves away from zero."""
    return int(offset >= 0.5) - int(offset <= -0.5)


@kernel
def _split_offset(offset: np.float32) -> tuple[int, np.float32]:
    """Return the whole cells (-1, 0 or 1) in an offset, and the rest in [-1, 1]."""
    cells = int(offset > 1.0) - int(offset < -1.0)
    return cells, np.float32(np.float64(offset) - cells)


@kernel
def _direction_as_navfn(
    potential: Singles, columns: int, cell: int, dx: np.float32, dy: np.float32
) -> tuple[np.float32, np.float32]:
    """Return the descent (column, row) at offsets dx, dy in cells from a cell's center.

    It is between or beyond that cell and those above and to the right.
    """
    x = np.empty(4, np.float32)
    y = np.empty(4, np.float32)
    for k, corner in enumerate((cell, cell + 1, cell + columns, cell + columns + 1)):
        x[k], y[k] = _unit_gradient_as_navfn(potential, columns, corner)
    return _interpolate(x, dx, dy), _interpolate(y, dx, dy)


@kernel
def _interpolate(corners: Singles, dx: np.float32, dy: np.float32) -> np.float32:
    """Return the bilinear value between 4 corners, rounded to float32 as in navfn."""
    unit = np.float64(1.0)
    # In C the double 1.0 widens each term, and the assignment rounds it to a float.
    low = np.float32((unit - dx) * corners[0] + dx * corners[1])
    high = np.float32((unit - dx) * corners[2] + dx * corners[3])
    value: np.float32 = np.float32((unit - dy) * low + dy * high)
    return value


@kernel
def _unit_gradient_as_navfn(
    potential: Singles, columns: int, cell: int
) -> tuple[np.float32, np.float32]:
    """Return the unit descent (column, row), zero in outermost rows and on plateaus."""
    zero = np.float32(0.0)
    if cell < columns or cell > potential.size - columns:
        return zero, zero

    # As in the original, the norm is rounded before it divides.
    along = np.float32(_slope(potential, cell, 1))
    across = np.float32(_slope(potential, cell, columns))
    norm = _length(along, across)
    if norm <= 0.0:
        return zero, zero

    share = np.float32(1.0 / np.float64(norm))
    return share * along, share * across


@kernel
def _length(x: np.float32, y: np.float32) -> np.float32:
    """Return the length of a vector in double precision, rounded to float32."""
    # hypot of the original takes doubles.
    square = np.float64(x) * np.float64(x) + np.float64(y) * np.float64(y)
    length: np.float32 = np.float32(math.sqrt(square))
    return length


@kernel
def _lowest_neighbor_as_navfn(potential: Singles, columns: int, cell: int) -> int:
    """Return the index of the lowest of a cell and its 8 neighbors as navfn finds it.

    It keeps the lowest value so far in an int, so that a value counts as lower only if
    it is below that one rounded down.
    """
    best = cell
    lowest = -_LARGEST_INTEGER
    if potential[cell] < _LARGEST_INTEGER:
        lowest = math.floor(potential[cell])
    for d_row in (-1, 0, 1):
        for d_col in (-1, 0, 1):
            neighbor = cell + d_row * columns + d_col
            if 0 <= neighbor < potential.size and potential[neighbor] < lowest:
                best = neighbor
                lowest = math.floor(potential[neighbor])
    return best
