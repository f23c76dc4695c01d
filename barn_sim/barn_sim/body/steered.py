"""Friction of a car's wheels: the front ones roll freely at their angles, the rear ones share a differential."""

import math

import numpy as np
from numba import njit

from barn_sim.body.friction import SWEEPS, TOLERANCE, Matrix, hypot, prepare
from barn_worlds.base.arrays import Floats

_HALVINGS = 50  # of an interval in which a number is sought
_HALF = math.sqrt(0.5)

Pair = tuple[float, float]


@njit(cache=True)
def front_angles(steering: float, wheelbase: float, half_track: float) -> tuple[float, float]:
    """Return the angles of the left and the right front wheel of a car, whose axles meet where it turns about."""
    bend = math.tan(steering)
    aside = bend * half_track / wheelbase
    return math.atan2(bend, 1.0 - aside), math.atan2(bend, 1.0 + aside)


@njit(cache=True)
def solve_steered(
    motion: Floats,
    speed: float,
    angles: tuple[float, float],
    arms: Floats,
    limits: Floats,
    turn: Matrix,
    inverse: Matrix,
    inverse_mass: float,
    impulses: Floats,
) -> None:
    """Do as `solve_friction` for a car: two front wheels at angles (rad) that roll freely, two driven rear wheels.

    speed: mean of the rim speeds of the rear wheels, m/s. Unknowns are a sideways impulse for each wheel and one along
    the rolling direction that the rear wheels share by halves, over the square root of 2 so that its unit has length 1.
    """
    length = max(hypot(turn[1][1], -turn[0][1]), 1e-12)
    along = turn[1][1] / length, -turn[0][1] / length
    lever, across, steps = np.empty((4, 3, 2)), np.empty((4, 2)), np.empty(3)
    _prepare_wheels(along, angles, arms, inverse, inverse_mass, lever, across, steps)
    sideways = np.empty(4)
    driven = _begin(along, across, limits, impulses, sideways)
    _share(driven, sideways, along, across, impulses)
    for i in range(4):
        _apply(motion, lever[i], inverse_mass, impulses[i, 0], impulses[i, 1])
    for _ in range(SWEEPS):
        largest = 0.0
        for i in range(2):
            x, y = _slip(motion, arms[i])
            wanted = sideways[i] - steps[i] * (x * across[i, 0] + y * across[i, 1])
            change = max(-limits[i], min(limits[i], wanted)) - sideways[i]
            sideways[i] += change
            _apply(motion, lever[i], inverse_mass, change * across[i, 0], change * across[i, 1])
            largest = max(largest, abs(change))
        before = driven, sideways[2], sideways[3]
        driven, sideways[2], sideways[3] = _drive(before, motion, speed, along, across, arms, limits, steps[2])
        shared = _HALF * (driven - before[0])
        for i in range(2, 4):
            change = sideways[i] - before[i - 1]
            x, y = change * across[i, 0] + shared * along[0], change * across[i, 1] + shared * along[1]
            _apply(motion, lever[i], inverse_mass, x, y)
            largest = max(largest, abs(x), abs(y))
        if largest < TOLERANCE:
            break
    _share(driven, sideways, along, across, impulses)


@njit(cache=True)
def _prepare_wheels(
    along: Pair,
    angles: Pair,
    arms: Floats,
    inverse: Matrix,
    inverse_mass: float,
    lever: Floats,
    across: Floats,
    steps: Floats,
) -> None:
    """Fill levers (4, 3, 2), directions across the wheels (4, 2) and steps (3,): left, right, rear wheels together."""
    trace = 0.0
    for i in range(4):
        _, levers = prepare((arms[i, 0], arms[i, 1], arms[i, 2]), inverse, inverse_mass)
        for k in range(3):
            lever[i, k, 0], lever[i, k, 1] = levers[2 * k], levers[2 * k + 1]
        angle = angles[i] if i < 2 else 0.0
        c, s = math.cos(angle), math.sin(angle)
        across[i, 0], across[i, 1] = -along[1] * c - along[0] * s, along[0] * c - along[1] * s
        response = _answer(lever[i], arms[i], inverse_mass, across[i, 0], across[i, 1])
        if i < 2:
            steps[i] = 1.0 / response
        else:
            trace += response + _answer(lever[i], arms[i], inverse_mass, along[0], along[1])
    steps[2] = 1.0 / trace  # at most the inverse of the largest eigenvalue


@njit(cache=True)
def _begin(along: Pair, across: Floats, limits: Floats, impulses: Floats, sideways: Floats) -> float:
    """Fill the sideways impulses (4,) with the last ones as far as friction allows, and return the driving one."""
    for i in range(4):
        sideways[i] = impulses[i, 0] * across[i, 0] + impulses[i, 1] * across[i, 1]
        if i < 2:
            sideways[i] = max(-limits[i], min(limits[i], sideways[i]))
    x, y = impulses[2, 0] + impulses[3, 0], impulses[2, 1] + impulses[3, 1]
    driven, sideways[2], sideways[3] = through_differential(
        _HALF * (x * along[0] + y * along[1]), sideways[2], sideways[3], limits[2], limits[3]
    )
    return driven


@njit(cache=True)
def _share(driven: float, sideways: Floats, along: Pair, across: Floats, impulses: Floats) -> None:
    """Fill in the impulses (4, 2) of the wheels."""
    for i in range(4):
        shared = _HALF * driven if i >= 2 else 0.0
        impulses[i, 0] = sideways[i] * across[i, 0] + shared * along[0]
        impulses[i, 1] = sideways[i] * across[i, 1] + shared * along[1]


@njit(cache=True)
def _drive(
    before: tuple[float, float, float],
    motion: Floats,
    speed: float,
    along: Pair,
    across: Floats,
    arms: Floats,
    limits: Floats,
    step: float,
) -> tuple[float, float, float]:
    """Return the impulses of the rear wheels after a step: the driving one, left and right sideways."""
    left_x, left_y = _slip(motion, arms[2])
    right_x, right_y = _slip(motion, arms[3])
    slip = _HALF * ((left_x + right_x) * along[0] + (left_y + right_y) * along[1] - 2.0 * speed)
    return through_differential(
        before[0] - step * slip,
        before[1] - step * (left_x * across[2, 0] + left_y * across[2, 1]),
        before[2] - step * (right_x * across[3, 0] + right_y * across[3, 1]),
        limits[2],
        limits[3],
    )


@njit(cache=True)
def through_differential(
    driven: float, left: float, right: float, left_limit: float, right_limit: float
) -> tuple[float, float, float]:
    """Return the nearest impulses that the friction of both rear wheels allows.

    driven: along the rolling direction, of which each wheel has 1 / sqrt(2). left, right: sideways.
    """
    squared = 0.5 * driven * driven
    if squared + left * left <= left_limit * left_limit and squared + right * right <= right_limit * right_limit:
        return driven, left, right
    low, high = 0.0, min(abs(driven), math.sqrt(2.0) * min(left_limit, right_limit))
    for _ in range(_HALVINGS):
        middle = 0.5 * (low + high)
        gain = middle - abs(driven)  # half of the derivative of the squared distance
        for aside, limit in ((abs(left), left_limit), (abs(right), right_limit)):
            room = math.sqrt(max(limit * limit - 0.5 * middle * middle, 0.0))
            if aside > room:
                gain += (aside - room) * 0.5 * middle / max(room, 1e-300)
        if gain > 0.0:
            high = middle
        else:
            low = middle
    rooms = (
        math.sqrt(max(left_limit * left_limit - 0.5 * low * low, 0.0)),
        math.sqrt(max(right_limit * right_limit - 0.5 * low * low, 0.0)),
    )
    return math.copysign(low, driven), max(-rooms[0], min(rooms[0], left)), max(-rooms[1], min(rooms[1], right))


@njit(cache=True)
def _slip(motion: Floats, arm: Floats) -> tuple[float, float]:
    """Return the velocity of the body where a wheel touches the ground."""
    x, y, z = arm[0], arm[1], arm[2]
    return motion[0] + motion[3] * z - motion[4] * y, motion[1] + motion[4] * x - motion[2] * z


@njit(cache=True)
def _answer(lever: Floats, arm: Floats, inverse_mass: float, x: float, y: float) -> float:
    """Return the velocity of a contact along a unit vector x, y per impulse along it."""
    spin_x, spin_y = lever[0, 0] * x + lever[0, 1] * y, lever[1, 0] * x + lever[1, 1] * y
    spin_z = lever[2, 0] * x + lever[2, 1] * y
    along_x = inverse_mass * x + spin_y * arm[2] - spin_z * arm[1]
    along_y = inverse_mass * y + spin_z * arm[0] - spin_x * arm[2]
    result: float = x * along_x + y * along_y
    return result


@njit(cache=True)
def _apply(motion: Floats, lever: Floats, inverse_mass: float, x: float, y: float) -> None:
    """Add the effect of an impulse on `motion` (5,); lever (3, 2): change of spin per impulse."""
    motion[0] += inverse_mass * x
    motion[1] += inverse_mass * y
    for k in range(3):
        motion[2 + k] += lever[k, 0] * x + lever[k, 1] * y
