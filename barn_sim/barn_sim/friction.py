"""Coulomb friction of wheels whose rim speeds are given; `barn_sim.tyres` says what is solved, and why here."""

import math

import numpy as np
from numba import njit

from barn_worlds.arrays import Floats

SWEEPS = 100
TOLERANCE = 1e-8  # of an impulse, in N s: 1e-9 m/s of the Jackal
_SURELY = 1.0 - 1e-12  # more than squares are rounded by


@njit(cache=True)
def solve_friction(
    motion: Floats,
    left: float,
    right: float,
    arms: Floats,
    limits: Floats,
    turn: Floats,
    inverse: Floats,
    inverse_mass: float,
    impulses: Floats,
) -> None:
    """Find the friction impulses (n, 2) of the wheels and add their effect to `motion` (vx, vy, wx, wy, wz).

    limits (n,): largest impulse of each wheel, N s; `impulses` is the start of the iteration, then its result.
    """
    count = len(arms)
    length = max(math.hypot(turn[1, 1], -turn[0, 1]), 1e-12)
    rolling_x, rolling_y = turn[1, 1] / length, -turn[0, 1] / length
    lever = np.empty((count, 3, 2))  # change of spin per impulse
    step = np.empty(count)
    for i in range(count):
        step[i] = prepare(arms[i], inverse, inverse_mass, lever[i])
        _clip(impulses[i], limits[i])
        apply(motion, lever[i], inverse_mass, impulses[i, 0], impulses[i, 1])
    for _ in range(SWEEPS):
        largest = 0.0
        for i in range(count):
            rim = left if i % 2 == 0 else right
            x, y, z = arms[i, 0], arms[i, 1], arms[i, 2]
            slip_x = motion[0] + motion[3] * z - motion[4] * y - rim * rolling_x
            slip_y = motion[1] + motion[4] * x - motion[2] * z - rim * rolling_y
            old_x, old_y = impulses[i, 0], impulses[i, 1]
            impulses[i, 0] -= step[i] * slip_x
            impulses[i, 1] -= step[i] * slip_y
            _clip(impulses[i], limits[i])
            change_x, change_y = impulses[i, 0] - old_x, impulses[i, 1] - old_y
            apply(motion, lever[i], inverse_mass, change_x, change_y)
            largest = max(largest, abs(change_x), abs(change_y))
        if largest < TOLERANCE:
            break


@njit(cache=True)
def prepare(arm: Floats, inverse: Floats, inverse_mass: float, lever: Floats) -> float:
    """Fill `lever` (3, 2) and return the step: the inverse of the largest eigenvalue of the contact's 2 x 2 matrix."""
    x, y, z = arm[0], arm[1], arm[2]
    for k in range(3):
        lever[k, 0] = inverse[k, 1] * z - inverse[k, 2] * y
        lever[k, 1] = inverse[k, 2] * x - inverse[k, 0] * z
    a = inverse_mass + lever[1, 0] * z - lever[2, 0] * y
    b = lever[1, 1] * z - lever[2, 1] * y
    c = inverse_mass + lever[2, 1] * x - lever[0, 1] * z
    largest: float = 0.5 * (a + c) + math.hypot(0.5 * (a - c), b)
    return 1.0 / largest


@njit(cache=True)
def apply(motion: Floats, lever: Floats, inverse_mass: float, x: float, y: float) -> None:
    """Add the effect of an impulse on `motion`; lever: see `prepare`."""
    motion[0] += inverse_mass * x
    motion[1] += inverse_mass * y
    for k in range(3):
        motion[2 + k] += lever[k, 0] * x + lever[k, 1] * y


@njit(cache=True)
def _clip(impulse: Floats, limit: float) -> None:
    if impulse[0] * impulse[0] + impulse[1] * impulse[1] < _SURELY * limit * limit:
        return
    length = math.hypot(impulse[0], impulse[1])
    if length > limit:
        impulse[0] *= limit / length
        impulse[1] *= limit / length
