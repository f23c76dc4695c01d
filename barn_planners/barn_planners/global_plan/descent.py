"""Compiled loops that follow a potential (flat, cell = row * cols + column) from the goal to the robot."""

import math

import numpy as np
from numba import njit

from barn_planners.global_plan.kernels import UNREACHED


@njit(cache=True)
def gradient(potential, cols, cell, blocked_slope):  # type: ignore[no-untyped-def]
    """Return the unit descent direction (column, row) at a cell; zero on a plateau or the border."""
    row, col = cell // cols, cell % cols
    if row < 1 or col < 1 or col >= cols - 1 or row >= potential.size // cols - 1:
        return 0.0, 0.0
    along = _slope(potential, cell, 1, blocked_slope)
    across = _slope(potential, cell, cols, blocked_slope)
    norm = math.hypot(along, across)
    if norm == 0.0:
        return 0.0, 0.0
    return along / norm, across / norm


@njit(cache=True)
def _slope(potential, cell, offset, blocked_slope):  # type: ignore[no-untyped-def]
    """Return the descent along one axis; at an unreached cell `blocked_slope` towards a reached neighbour."""
    value = potential[np.uint64(cell)]
    before, after = (
        potential[np.uint64(cell - offset)],
        potential[np.uint64(cell + offset)],
    )
    if value >= UNREACHED:
        if before < UNREACHED:
            return -blocked_slope
        return blocked_slope if after < UNREACHED else 0.0
    slope = 0.0
    if before < UNREACHED:
        slope += before - value
    if after < UNREACHED:
        slope += value - after
    return slope


@njit(cache=True)
def _lowest_neighbour(potential, cols, cell):  # type: ignore[no-untyped-def]
    """Return the cell of lowest potential among a cell and its 8 neighbours, the first of equals."""
    best = cell
    for d_row in (-1, 0, 1):
        for d_col in (-1, 0, 1):
            other = cell + d_row * cols + d_col
            if potential[other] < potential[best]:
                best = other
    return best


@njit(cache=True)
def _find_corners(potential, cols, row, col, blocked_slope, last, corners):  # type: ignore[no-untyped-def]
    """Write the gradients (4, 2) of the cells (row + 0 or 1, col + 0 or 1); what `last` (row, column) has is kept."""
    last_row, last_col = last
    if row == last_row and col == last_col:
        return
    kept = corners.copy()
    for i in range(2):
        for j in range(2):
            was_row, was_col = row + i - last_row, col + j - last_col
            if 0 <= was_row <= 1 and 0 <= was_col <= 1:
                gx, gy = kept[2 * was_row + was_col, 0], kept[2 * was_row + was_col, 1]
            else:
                gx, gy = gradient(
                    potential, cols, (row + i) * cols + col + j, blocked_slope
                )
            corners[2 * i + j, 0], corners[2 * i + j, 1] = gx, gy


@njit(cache=True)
def _interpolated(corners, fx, fy):  # type: ignore[no-untyped-def]
    """Return the descent direction (column, row) between the centres of four cells, bilinear."""
    dx = dy = 0.0
    for i in range(2):
        for j in range(2):
            weight = (fy if i else 1.0 - fy) * (fx if j else 1.0 - fx)
            dx += weight * corners[2 * i + j, 0]
            dy += weight * corners[2 * i + j, 1]
    return dx, dy


@njit(cache=True)
def descend(potential, cols, start, goal, step, neutral, blocked_slope, points):  # type: ignore[no-untyped-def]
    """Follow the potential down from `goal` to `start`; return how many points (column, row) are written, 0 on failure.

    Steps are `step` cells along the interpolated gradient; beside unreached cells, or when oscillating, to the lowest
    neighbour's centre.
    """
    rows = potential.size // cols
    x, y = float(goal % cols), float(goal // cols)
    corners, last = np.empty((4, 2)), (-2, -2)
    for n in range(len(points)):
        row, col = math.floor(y + 0.5), math.floor(x + 0.5)
        if row < 0 or col < 0 or row >= rows or col >= cols:
            return 0
        cell = row * cols + col
        if potential[cell] < neutral:
            points[n, 0], points[n, 1] = float(start % cols), float(start // cols)
            return n + 1
        if row < 1 or col < 1 or row >= rows - 1 or col >= cols - 1:
            return 0
        points[n, 0], points[n, 1] = x, y
        to_and_fro = n >= 2 and points[n - 2, 0] == x and points[n - 2, 1] == y
        dx = dy = 0.0
        if not to_and_fro and not _beside_wall(potential, cols, cell):
            low_row, low_col = math.floor(y), math.floor(x)
            _find_corners(
                potential, cols, low_row, low_col, blocked_slope, last, corners
            )
            last = low_row, low_col
            dx, dy = _interpolated(corners, x - low_col, y - low_row)
        norm = math.hypot(dx, dy)
        if norm > 0.0:
            x += step * dx / norm
            y += step * dy / norm
            continue
        lowest = _lowest_neighbour(potential, cols, cell)
        if potential[lowest] >= UNREACHED or (lowest == cell and x == col and y == row):
            return 0
        x, y = float(lowest % cols), float(lowest // cols)
    return 0


@njit(cache=True)
def descend_as_navfn(potential, cols, start, goal, neutral, blocked_slope, points):  # type: ignore[no-untyped-def]
    """Follow the potential (float32) down as navfn does; return the points written and whether they reach `start`.

    A place is a cell and offsets from its centre, all in single precision. Gradients are interpolated, or extrapolated
    where an offset is negative, and only that cell's neighbours are looked at for walls; so the path may orbit.
    """
    size = potential.size
    cell, dx, dy = goal, np.float32(0.0), np.float32(0.0)
    for n in range(len(points)):
        nearest = cell + _rounded(dx) + cols * _rounded(dy)
        if potential[max(0, min(size - 1, nearest))] < neutral:
            points[n, 0], points[n, 1] = start % cols, start // cols
            return n + 1, True
        if cell < cols or cell > size - cols:
            return n, False
        points[n, 0], points[n, 1] = (
            np.float32(cell % cols) + dx,
            np.float32(cell // cols) + dy,
        )
        to_and_fro = (
            n >= 2
            and points[n - 2, 0] == points[n, 0]
            and points[n - 2, 1] == points[n, 1]
        )
        if to_and_fro or _beside_wall(potential, cols, cell):
            cell, dx, dy = (
                _lowest_in_whole_numbers(potential, cols, cell),
                np.float32(0.0),
                np.float32(0.0),
            )
            if potential[cell] >= UNREACHED:
                return n + 1, False
            continue
        x, y = _direction(potential, cols, cell, dx, dy, blocked_slope)
        if x == 0.0 and y == 0.0:
            return n + 1, False
        share = np.float32(0.5) / _length(x, y)
        columns, dx = _whole_cells(dx + x * share)
        rows, dy = _whole_cells(dy + y * share)
        cell += columns + cols * rows
    return len(points), False


@njit(cache=True)
def _whole_cells(offset):  # type: ignore[no-untyped-def]
    """Return how many cells an offset leads on, and what is left of it in [-1, 1]."""
    cells = int(offset > 1.0) - int(offset < -1.0)
    return cells, np.float32(np.float64(offset) - cells)


@njit(cache=True)
def _direction(potential, cols, cell, dx, dy, blocked_slope):  # type: ignore[no-untyped-def]
    """Return the gradient at an offset from a cell, between or beyond that cell and those above and to the right."""
    x, y = np.empty(4, np.float32), np.empty(4, np.float32)
    for k, corner in enumerate((cell, cell + 1, cell + cols, cell + cols + 1)):
        x[k], y[k] = _unit_gradient(potential, cols, corner, blocked_slope)
    return _between(x, dx, dy), _between(y, dx, dy)


@njit(cache=True)
def _rounded(offset):  # type: ignore[no-untyped-def]
    """Return an offset in (-1, 1) to the nearest whole number, halves away from zero."""
    return int(offset >= 0.5) - int(offset <= -0.5)


@njit(cache=True)
def _length(x, y):  # type: ignore[no-untyped-def]
    """Return the length of a vector in single precision."""
    return np.float32(
        math.sqrt(np.float64(x) * np.float64(x) + np.float64(y) * np.float64(y))
    )


@njit(cache=True)
def _between(corners, dx, dy):  # type: ignore[no-untyped-def]
    """Return a value between (or beyond) four corners, rounded to single precision where navfn does."""
    one = np.float64(1.0)
    low = np.float32((one - dx) * corners[0] + dx * corners[1])
    high = np.float32((one - dx) * corners[2] + dx * corners[3])
    return np.float32((one - dy) * low + dy * high)


@njit(cache=True)
def _unit_gradient(potential, cols, cell, blocked_slope):  # type: ignore[no-untyped-def]
    """Return the unit descent direction (column, row) at a cell, in single precision; zero off the grid."""
    zero = np.float32(0.0)
    if cell < cols or cell > potential.size - cols:
        return zero, zero
    along = np.float32(_slope(potential, cell, 1, blocked_slope))
    across = np.float32(_slope(potential, cell, cols, blocked_slope))
    norm = _length(along, across)
    if norm <= 0.0:
        return zero, zero
    share = np.float32(1.0 / np.float64(norm))
    return share * along, share * across


@njit(cache=True)
def _beside_wall(potential, cols, cell):  # type: ignore[no-untyped-def]
    """Tell whether a cell or one of its 8 neighbours is unreached or off the grid."""
    for d_row in (-1, 0, 1):
        for d_col in (-1, 0, 1):
            other = cell + d_row * cols + d_col
            if other < 0 or other >= potential.size or potential[other] >= UNREACHED:
                return True
    return False


@njit(cache=True)
def _lowest_in_whole_numbers(potential, cols, cell):  # type: ignore[no-untyped-def]
    """Return the cell of lowest potential of a cell and its 8 neighbours, each compared with a number rounded down."""
    best, lowest = cell, -(2.0**31)
    if potential[cell] < 2.0**31:
        lowest = math.floor(potential[cell])
    for d_row in (-1, 0, 1):
        for d_col in (-1, 0, 1):
            other = cell + d_row * cols + d_col
            if 0 <= other < potential.size and potential[other] < lowest:
                best, lowest = other, math.floor(potential[other])
    return best
