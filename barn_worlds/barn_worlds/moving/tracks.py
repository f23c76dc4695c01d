"""Positions of all moving obstacles of a world at any time."""

import math
from collections.abc import Sequence
from itertools import pairwise
from operator import attrgetter

import numpy as np

from barn_worlds.base.arrays import BoolGrid, Floats, Integers, Points, strict_kernel
from barn_worlds.moving.motion import MovingObstacle

# Motions of n obstacles for `evaluate`: the first piece (n + 1,) of each; begin (m,)
# and duration (m,) in s, and coefficients (m, 2, k) of all pieces; period (n,) and
# phase (n,) in s. A tuple, since numba takes no objects.
MotionTable = tuple[Integers, Floats, Floats, Floats, Floats, Floats]

# Numbers of an obstacle that do not change with time.
_NUMBERS = (
    "radius_m",
    "height_m",
    "yaw_rad",
    "motion.period_s",
    "phase_s",
    "size_x_m",
    "size_y_m",
)


class Tracks:
    """The motions of some obstacles, tabulated to evaluate them at any time."""

    # In the order of all arrays.
    names: tuple[str, ...]
    # (n,) of cylinders, 0 for a box.
    radius_m: Floats
    # (n, 2) of boxes along their own x and y, 0 for a cylinder.
    size_m: Points
    # (n,)
    height_m: Floats
    # (n,) headings of boxes.
    yaw_rad: Floats
    # (n,) that the obstacle never exceeds, except in a jump.
    fastest_mps: Floats
    table: MotionTable

    def __init__(self, obstacles: Sequence[MovingObstacle]):
        """Tabulate motions, sizes and top speeds of obstacles, in their order."""
        self.names = tuple(obstacle.name for obstacle in obstacles)
        # Floats, also if all numbers are integers: kernels have one type.
        numbers = np.array(list(map(attrgetter(*_NUMBERS), obstacles)), np.float64)
        # Rows of a copy are contiguous, as kernels take them.
        columns = numbers.reshape(-1, len(_NUMBERS)).T.copy()
        self.radius_m, self.height_m, self.yaw_rad, period_s, phase_s = columns[:5]
        self.size_m = np.ascontiguousarray(columns[5:].T)

        # An empty table of pieces comes first, so that a world without moving obstacles
        # has arrays too.
        pieces = [(np.empty(0), np.empty(0), np.empty((0, 2, 1)))]
        pieces += [obstacle.motion.pieces() for obstacle in obstacles]
        begins, durations, tables = zip(*pieces, strict=True)
        first = np.cumsum(list(map(len, begins)), dtype=np.int64)
        begin_s = np.concatenate(begins)
        duration_s = np.concatenate(durations)

        # Pieces of lower order get zeros for the higher powers.
        powers = max(table.shape[2] for table in tables)
        coefficients = np.zeros((len(begin_s), 2, powers))
        for place, table in zip(first[:-1].tolist(), tables[1:], strict=True):
            coefficients[place : place + len(table), :, : table.shape[2]] = table

        speeds_mps = _speed_bounds(coefficients) / duration_s
        self.fastest_mps = np.array(
            [speeds_mps[start:end].max() for start, end in pairwise(first)]
        )
        self.table = (first, begin_s, duration_s, coefficients, period_s, phase_s)

    def __len__(self) -> int:
        """Return the number of obstacles."""
        return len(self.names)

    def at(self, time_s: float) -> tuple[Points, Points]:
        """Return positions (n, 2) in m, velocities (n, 2) in m/s at a time, map frame.

        A jump at the end of a period does not count as velocity.
        """
        positions = np.empty((len(self), 2))
        velocities = np.empty((len(self), 2))
        evaluate(time_s, self.table, positions, velocities)
        return positions, velocities

    def over(self, times_s: Floats) -> tuple[Floats, Floats]:
        """Return positions and velocities, each (m, n, 2), in m and m/s at m times."""
        positions = np.empty((len(times_s), len(self), 2))
        velocities = np.empty((len(times_s), len(self), 2))
        _evaluate_all(times_s, self.table, positions, velocities)
        return positions, velocities


def _speed_bounds(coefficients: Floats) -> Floats:
    """Return upper bounds (n,) on the slopes of pieces (n, 2, k), in m per share.

    A polynomial stays within the convex hull of its Bernstein coefficients.
    """
    # Coefficients of the derivative by the share of a piece.
    slopes = coefficients[:, :, 1:] * np.arange(1, coefficients.shape[2])
    degree = slopes.shape[2] - 1
    bounds: Floats = np.zeros(len(coefficients))
    for place in range(degree + 1):
        bernstein = sum(
            math.comb(place, power) / math.comb(degree, power) * slopes[:, :, power]
            for power in range(place + 1)
        )
        corner = np.asarray(bernstein).reshape(len(coefficients), 2)
        bounds = np.maximum(bounds, np.hypot(*corner.T))
    return bounds


def jumps(positions: Floats, velocities: Floats, step_s: float) -> BoolGrid:
    """Return a mask (m - 1, n), True where an obstacle jumped between two samples.

    Args:
        positions: (m, n, 2) in m.
        velocities: (m, n, 2) in m/s.
        step_s: Time between two samples.

    Returns:
        (m - 1, n), True where the step is longer than the speeds at its ends explain.
    """
    steps_m = np.linalg.norm(np.diff(positions, axis=0), axis=2)
    speeds_mps = np.linalg.norm(velocities, axis=2)
    # Twice the way at the faster end: speeds change between the samples.
    reach_m = 2.0 * step_s * np.maximum(speeds_mps[1:], speeds_mps[:-1])
    is_jump: BoolGrid = steps_m > 0.2 + reach_m
    return is_jump


@strict_kernel
def evaluate(
    time_s: float, table: MotionTable, positions: Points, velocities: Points
) -> None:
    """Write positions and velocities of n obstacles at a time into two arrays.

    Each follows the piece that it is in; before the first piece and after the last one
    it rests.

    Args:
        time_s: Seconds since all motions began, phases apart.
        table: Motions of n obstacles.
        positions: (n, 2) in m, which is written.
        velocities: (n, 2) in m/s, which is written.
    """
    first, begin, duration, coefficients, period, phase = table
    powers = coefficients.shape[2]
    for k in range(len(positions)):
        motion_s = (time_s + phase[k]) % period[k]
        low = first[k]
        high = first[k + 1]
        later = np.searchsorted(begin[low:high], motion_s, side="right")
        piece = max(low, low + later - 1)

        share = (motion_s - begin[piece]) / duration[piece]
        is_moving = 0.0 <= share <= 1.0
        share = min(max(share, 0.0), 1.0)
        for axis in range(2):
            # Horner's scheme gives value and slope together.
            value = coefficients[piece, axis, powers - 1]
            slope = 0.0
            for power in range(powers - 2, -1, -1):
                slope = slope * share + value
                value = value * share + coefficients[piece, axis, power]
            positions[k, axis] = value
            velocities[k, axis] = slope / duration[piece] if is_moving else 0.0


@strict_kernel
def _evaluate_all(
    times_s: Floats, table: MotionTable, positions: Floats, velocities: Floats
) -> None:
    """Write positions and velocities at times (m,) into two arrays (m, n, 2)."""
    for k in range(len(times_s)):
        evaluate(times_s[k], table, positions[k], velocities[k])
