"""The iteration for friction of `friction` for several robots at once, each in a lane of vector instructions.

Rows of a lane are the motion, the largest change of an impulse in a sweep, whether `clipped_abreast` is wrong, sweeps
done, and whether the lane is in use. Rows of each wheel are those of `barn_sim.motion.layout` from the impulse on.
"""

import numpy as np
from numba import njit

from barn_sim.body.friction import SWEEPS, TOLERANCE, after, clipped_abreast
from barn_sim.motion.layout import IMPULSE, LANES, MOTION, SOLVED, WHEEL_ROWS, put_three, three
from barn_worlds.base.arrays import Floats, Integers

_LARGEST, _WRONG, _SWEEPS, _USED, _ROWS = 5, 6, 7, 8, 9
_ARM, _LIMIT, _LEVERS, _STEP, _SURE, _RIM, _WHEEL_ROWS = 2, 5, 6, 12, 13, 14, 16


@njit(cache=True)
def free_lanes(grips: int) -> tuple[Floats, Floats, Integers, Integers]:
    """Return rows, rows of wheels, the place of the robot that each lane holds, -1 for none, and whether it is done."""
    holds, done = np.full(LANES, -1), np.zeros(LANES, np.int64)
    return np.zeros(_ROWS * LANES), np.ones(grips * _WHEEL_ROWS * LANES), holds, done


@njit(cache=True)
def take_up(
    rows: Floats, wheels: Floats, holds: Integers, waiting: Integers, first: int, last: int, begun: Floats,
    contacts: Floats, grips: int,
) -> int:  # fmt: skip
    """Let free lanes hold those robots that wait from the first to before the last place; return the new first.

    begun, contacts: rows of `barn_sim.motion.layout` by groups.
    """
    for lane in range(LANES):
        if holds[lane] < 0 and first < last:
            holds[lane] = waiting[first]
            _hold(rows, wheels, lane, begun, contacts, waiting[first] // LANES, waiting[first] % LANES, grips)
            first += 1
    return first


@njit(cache=True, forceinline=True)
def _hold(
    rows: Floats, wheels: Floats, lane: int, begun: Floats, contacts: Floats, group: int, k: int, grips: int
) -> None:
    for row in range(5):
        rows[row * LANES + lane] = begun[group, (MOTION + row) * LANES + k]
    rows[_WRONG * LANES + lane] = rows[_SWEEPS * LANES + lane] = 0.0
    rows[_USED * LANES + lane] = 1.0
    for i in range(grips):
        to, of = wheels[i * _WHEEL_ROWS * LANES + lane :], contacts[group, (i * WHEEL_ROWS + IMPULSE) * LANES + k :]
        for row in range(_WHEEL_ROWS):
            to[row * LANES] = of[row * LANES]


@njit(cache=True, forceinline=True)
def release(rows: Floats, wheels: Floats, holds: Integers, lane: int, contacts: Floats, grips: int) -> bool:
    """Release the robot of a lane and take over the impulses; tell whether they are right."""
    group, k = holds[lane] // LANES, holds[lane] % LANES
    holds[lane], rows[_USED * LANES + lane] = -1, 0.0
    if rows[_WRONG * LANES + lane] > 0.0:
        return False
    for i in range(grips):
        to, of = (i * WHEEL_ROWS + SOLVED) * LANES + k, i * _WHEEL_ROWS * LANES + lane
        contacts[group, to], contacts[group, to + LANES] = wheels[of], wheels[of + LANES]
    return True


@njit(cache=True, error_model="numpy")
def sweep(rows: Floats, wheels: Floats, done: Integers, grips: int, inverse_mass: float) -> int:
    """Do a sweep of `sweep_friction` in every lane; fill in which are done (LANES,), and return how many."""
    for k in range(LANES):
        rows[_LARGEST * LANES + k] = 0.0
    for i in range(grips):
        _sweep_wheel(rows, wheels[i * _WHEEL_ROWS * LANES : (i + 1) * _WHEEL_ROWS * LANES], inverse_mass)
    for k in range(LANES):
        rows[_SWEEPS * LANES + k] += 1.0
        over = (rows[_LARGEST * LANES + k] < TOLERANCE) | (rows[_SWEEPS * LANES + k] >= SWEEPS)
        over = (over | (rows[_WRONG * LANES + k] > 0.0)) & (rows[_USED * LANES + k] > 0.0)
        done[k] = 1 if over else 0
    count = 0
    for k in range(LANES):
        count += done[k]
    return count


@njit(cache=True, error_model="numpy", forceinline=True)
def _sweep_wheel(rows: Floats, wheel: Floats, inverse_mass: float) -> None:
    for k in range(LANES):
        x, y, z = three(wheel, _ARM, k)
        vx, vy, wx = three(rows, 0, k)
        wy, wz = rows[3 * LANES + k], rows[4 * LANES + k]
        slip_x = vx + wy * z - wz * y - wheel[_RIM * LANES + k]
        slip_y = vy + wz * x - wx * z - wheel[(_RIM + 1) * LANES + k]
        step, limit, surely = wheel[_STEP * LANES + k], wheel[_LIMIT * LANES + k], wheel[_SURE * LANES + k]
        old_x, old_y = wheel[k], wheel[LANES + k]
        new_x, new_y, right = clipped_abreast(old_x - step * slip_x, old_y - step * slip_y, limit, surely)
        rows[_WRONG * LANES + k] = rows[_WRONG * LANES + k] if right else 1.0
        change_x, change_y = new_x - old_x, new_y - old_y
        wheel[k], wheel[LANES + k] = new_x, new_y
        levers = three(wheel, _LEVERS, k) + three(wheel, _LEVERS + 3, k)
        vx, vy, wx, wy, wz = after((vx, vy, wx, wy, wz), levers, inverse_mass, change_x, change_y)
        put_three(rows, 0, k, (vx, vy, wx))
        rows[3 * LANES + k], rows[4 * LANES + k] = wy, wz
        changed = abs(change_x)
        changed = abs(change_y) if abs(change_y) > changed else changed
        largest = rows[_LARGEST * LANES + k]
        rows[_LARGEST * LANES + k] = changed if changed > largest else largest
