"""Where moving obstacles are at a time, all of a world at once."""

import math
from collections.abc import Sequence
from itertools import pairwise
from operator import attrgetter

import numpy as np
from numba import njit

from barn_worlds.base.arrays import BoolGrid, Floats, Integers, Points
from barn_worlds.moving.motion import MovingObstacle

Table = tuple[Integers, Floats, Floats, Floats, Floats, Floats]


class Tracks:
    """The motions of some obstacles, ready to be asked for any time.

    names: of the obstacles, in the order of all arrays. radius_m (n,): of a cylinder, 0 for a box. size_m (n, 2): of
    a box along its own x and y, 0 for a cylinder. height_m (n,). yaw_rad (n,): headings of boxes. fastest_mps (n,):
    what none of them is ever faster than, jumps apart. table: their motions for `evaluate`: the first piece (n + 1,) of
    each, begin (m,), duration (m,) and coefficients (m, 2, k) of the pieces, period (n,) and phase (n,).
    """

    def __init__(self, obstacles: Sequence[MovingObstacle]) -> None:
        self.names = tuple(one.name for one in obstacles)
        numbers = (
            "radius_m",
            "height_m",
            "yaw_rad",
            "motion.period_s",
            "phase_s",
            "size_x_m",
            "size_y_m",
        )
        columns: Floats = (
            np.array([attrgetter(*numbers)(one) for one in obstacles])
            .reshape(-1, len(numbers))
            .T.copy()
        )
        self.radius_m, self.height_m, self.yaw_rad, period, phase = columns[:5]
        self.size_m: Points = columns[5:].T.copy()
        pieces = [one.motion.pieces() for one in obstacles]
        ends = np.cumsum([0, *(len(begin) for begin, _, _ in pieces)], dtype=np.int64)
        begin, duration = (
            np.concatenate([np.empty(0), *(one[k] for one in pieces)]) for k in (0, 1)
        )
        powers = max((table.shape[2] for _, _, table in pieces), default=1)
        coefficients: Floats = np.zeros((len(begin), 2, powers))
        for place, (_, _, table) in zip(ends.tolist(), pieces, strict=False):
            coefficients[place : place + len(table), :, : table.shape[2]] = table
        speeds = _speed_bounds(coefficients) / duration
        self.fastest_mps: Floats = np.array(
            [speeds[one:other].max() for one, other in pairwise(ends)]
        )
        self.table: Table = ends, begin, duration, coefficients, period, phase

    def __len__(self) -> int:
        """Return the number of obstacles."""
        return len(self.names)

    def at(self, time_s: float) -> tuple[Points, Points]:
        """Return the positions (n, 2) in m and the velocities (n, 2) in m/s at a time, in the map frame.

        A velocity is that of the motion itself: a jump to its begin has none.
        """
        positions, velocities = np.empty((len(self), 2)), np.empty((len(self), 2))
        evaluate(time_s, self.table, positions, velocities)
        return positions, velocities

    def over(self, times_s: Floats) -> tuple[Floats, Floats]:
        """Return positions (m, n, 2) in m and velocities (m, n, 2) in m/s at m times."""
        positions, velocities = (
            np.empty((len(times_s), len(self), 2)),
            np.empty((len(times_s), len(self), 2)),
        )
        _evaluate_all(
            np.asarray(times_s, np.float64), self.table, positions, velocities
        )
        return positions, velocities


def _speed_bounds(coefficients: Floats) -> Floats:
    """Return what the derivatives of pieces (n, 2, k) by their share never exceed in length, (n,).

    A polynomial stays within the convex hull of its Bernstein coefficients.
    """
    slopes = coefficients[:, :, 1:] * np.arange(1, coefficients.shape[2])
    degree = slopes.shape[2] - 1
    hull = [
        sum(
            math.comb(place, power) / math.comb(degree, power) * slopes[:, :, power]
            for power in range(place + 1)
        )
        for place in range(degree + 1)
    ]
    corners = np.array(hull).reshape(degree + 1, len(coefficients), 2)
    bounds: Floats = np.hypot(corners[:, :, 0], corners[:, :, 1]).max(
        axis=0, initial=0.0
    )
    return bounds


def jumps(positions: Floats, velocities: Floats, step_s: float) -> BoolGrid:
    """Return whether (m - 1, n) obstacles jumped between positions (m, n, 2) that lie `step_s` apart."""
    moved_m, speed_mps = (
        np.linalg.norm(np.diff(positions, axis=0), axis=2),
        np.linalg.norm(velocities, axis=2),
    )
    found: BoolGrid = moved_m > 0.2 + 2.0 * step_s * np.maximum(
        speed_mps[1:], speed_mps[:-1]
    )
    return found


@njit(cache=True)
def evaluate(
    time_s: float, table: Table, positions: Points, velocities: Points
) -> None:
    """Write the positions (n, 2) and velocities (n, 2) of the motions of a table at a time.

    Each follows the piece that it is in; before the first piece and after the last one it rests.
    """
    first, begin, duration, coefficients, period, phase = table
    powers = coefficients.shape[2]
    for k in range(len(positions)):
        own, low, high = (time_s + phase[k]) % period[k], first[k], first[k + 1]
        piece = max(low, low + np.searchsorted(begin[low:high], own, side="right") - 1)
        share = (own - begin[piece]) / duration[piece]
        moving = 0.0 <= share <= 1.0
        share = min(max(share, 0.0), 1.0)
        for axis in range(2):
            value, slope = coefficients[piece, axis, powers - 1], 0.0
            for power in range(powers - 2, -1, -1):
                slope = slope * share + value
                value = value * share + coefficients[piece, axis, power]
            positions[k, axis] = value
            velocities[k, axis] = slope / duration[piece] if moving else 0.0


@njit(cache=True)
def _evaluate_all(
    times_s: Floats, table: Table, positions: Floats, velocities: Floats
) -> None:
    """Write positions and velocities (m, n, 2) at times (m,)."""
    for k in range(len(times_s)):
        evaluate(times_s[k], table, positions[k], velocities[k])
