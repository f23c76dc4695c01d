"""Many robots advanced in compiled code, each as `barn_sim.motion.ticks.advance` does by itself, to the last bit.

In the iteration for friction each step waits for the one before, and it takes a few sweeps for most robots but a
hundred for some. So sweeps are done for several robots at once, each in a lane of vector instructions. A robot keeps
its lane until it has no tick left, then the next one takes it. When there is none, the last lane takes its place. The
few robots left at the end go on one after the other, each from the beginning of its tick.
"""

import numpy as np
from numba import njit

from barn_sim.body.drive import add_command, turn_wheels
from barn_sim.body.free_motion import fill, triple
from barn_sim.body.friction import (
    SWEEPS,
    TOLERANCE,
    after,
    clipped_abreast,
    sweep_friction,
)
from barn_sim.body.state import Record, Records
from barn_sim.body.tires import forces
from barn_sim.motion.ticks import (
    BARE,
    Push,
    advance,
    begin_push,
    clear_of_movers,
    end_if_clear,
)
from barn_worlds.base.arrays import Floats, Integers

LANES = 32
_FEW = 3  # robots that are faster one after the other
# Rows, each of LANES numbers, in an array of one dimension, so that the compiler knows how far apart they are: motion,
# the largest change of an impulse in a sweep, whether `clipped_abreast` was wrong, sweeps done; and of each wheel those
# columns of `barn_sim.body.tires.stand` that begin with the impulse, then how fast its rim goes along x and y.
_LARGEST, _WRONG, _SWEEPS, _ROWS = 5, 6, 7, 8
_ARM, _LIMIT, _LEVERS, _STEP, _SURE, _RIM, _WHEEL_ROWS = 2, 5, 6, 12, 13, 14, 16


@njit(cache=True)
def advance_all(
    robots: Records, pending: Floats, settings: Records, segments: Floats, cylinders: Integers, noise: Floats,
    ticks: int, indices: Integers, commands: Floats, latency_ns: int, left: Integers, pushes: Floats,
) -> None:  # fmt: skip
    """Do as `barn_sim.motion.ticks.advance` for the robots `indices`; fill in ticks left (n,) and pushes (n, 4, 3).

    commands (n, 2): given now, there must be room for them. segments (n, m, 4): those of each robot's world, the first
    `cylinders` (n,) of a row.
    """
    for index in indices:
        stamp_ns = robots[index].stamp_ns
        add_command(
            robots,
            pending,
            index,
            stamp_ns + latency_ns,
            commands[index, 0],
            commands[index, 1],
        )
        left[index] = ticks
    rows, wheels = (
        np.zeros(_ROWS * LANES),
        np.zeros(settings[0].grips * _WHEEL_ROWS * LANES),
    )
    held, done, begun = (
        np.zeros(LANES, np.int64),
        np.zeros(LANES, np.int64),
        np.zeros((LANES, 12)),
    )
    _advance(
        robots,
        pending,
        settings,
        segments,
        cylinders,
        noise,
        indices,
        left,
        pushes,
        rows,
        wheels,
        held,
        begun,
        done,
    )


@njit(cache=True, **BARE)
def _advance(
    robots: Records, pending: Floats, settings: Records, segments: Floats, cylinders: Integers, noise: Floats,
    indices: Integers, left: Integers, pushes: Floats, rows: Floats, wheels: Floats, held: Integers, begun: Floats,
    done: Integers,
) -> None:  # fmt: skip
    """Do as `advance_all`, given the commands."""
    fixed: Record = settings[0]
    used = min(LANES, len(indices))
    for lane in range(used):
        held[lane] = indices[lane]
        _begin(robots, pending, settings, held[lane], rows, wheels, begun[lane], lane)
    taken = used
    while used > _FEW:
        while _sweep(rows, wheels, done, fixed.grips, fixed.inverse_mass, used) == 0:
            pass
        for lane in range(used - 1, -1, -1):
            if not done[lane]:
                continue
            index = held[lane]
            near = segments[index, : cylinders[index]]
            if not _end(
                robots,
                settings,
                near,
                noise,
                index,
                rows,
                wheels,
                begun[lane],
                lane,
                left,
                pushes[index],
            ):
                if taken == len(indices):
                    used -= 1
                    held[lane] = held[used]
                    _copy(rows, wheels, begun, used, lane, fixed.grips)
                    continue
                held[lane] = index = indices[taken]
                taken += 1
            _begin(robots, pending, settings, index, rows, wheels, begun[lane], lane)
    for lane in range(used):
        index = held[lane]
        rows[_WRONG * LANES + lane] = 1.0  # so that `_end` solves friction itself
        near = segments[index, : cylinders[index]]
        if _end(
            robots,
            settings,
            near,
            noise,
            index,
            rows,
            wheels,
            begun[lane],
            lane,
            left,
            pushes[index],
        ):
            left[index], push = advance(
                robots, pending, settings, index, near, noise, left[index]
            )
            _fill(pushes[index], push)


@njit(cache=True, **BARE)
def _copy(
    rows: Floats, wheels: Floats, begun: Floats, lane: int, to: int, grips: int
) -> None:
    """Move what is in a lane to another."""
    for row in range(begun.shape[1]):
        begun[to, row] = begun[lane, row]
    for row in range(_ROWS):
        rows[row * LANES + to] = rows[row * LANES + lane]
    for row in range(grips * _WHEEL_ROWS):
        wheels[row * LANES + to] = wheels[row * LANES + lane]


@njit(cache=True, forceinline=True, **BARE)
def _begin(
    robots: Records, pending: Floats, settings: Records, index: int, rows: Floats, wheels: Floats, begun: Floats,
    lane: int,
) -> None:  # fmt: skip
    """Begin a tick of a robot, up to the first sweep; begun (12,): motion, rims, what the loads do."""
    robot: Record = robots[index]
    fixed: Record = settings[0]
    turn_wheels(robot, pending, index, fixed, robot.stamp_ns)
    motion, rims, carried = begin_push(robot, fixed)
    fill(begun, (*motion, *rims, *carried))
    for row in range(5):
        rows[row * LANES + lane] = begun[row]
    rows[_WRONG * LANES + lane] = rows[_SWEEPS * LANES + lane] = 0.0
    for i in range(fixed.grips):
        of, to = robot.wheels[i], wheels[i * _WHEEL_ROWS * LANES + lane :]
        for row in range(_RIM):
            to[row * LANES] = of[3 + row]
        to[_RIM * LANES], to[(_RIM + 1) * LANES] = rims[i % 2], rims[2 + i % 2]


@njit(cache=True, forceinline=True, **BARE)
def _end(
    robots: Records, settings: Records, near: Floats, noise: Floats, index: int, rows: Floats, wheels: Floats,
    begun: Floats, lane: int, left: Integers, pushes: Floats,
) -> bool:  # fmt: skip
    """End the tick of a robot whose friction is solved, or fill in its push where it may touch; tell if it goes on."""
    robot: Record = robots[index]
    fixed: Record = settings[0]
    contacts = robot.wheels[: fixed.contacts]
    if rows[_WRONG * LANES + lane] > 0.0:
        motion, rims = (
            (begun[0], begun[1], begun[2], begun[3], begun[4]),
            (begun[5], begun[6], begun[7], begun[8]),
        )
        grip = contacts[: fixed.grips]
        sweep_friction(
            motion,
            rims,
            grip[:, 5:8],
            grip[:, 8],
            fixed.inverse_mass,
            grip[:, 3:5],
            grip[:, 9:],
        )
    else:
        for i in range(fixed.grips):
            of = i * _WHEEL_ROWS * LANES + lane
            contacts[i, 3], contacts[i, 4] = wheels[of], wheels[of + LANES]
    force, torque = forces((begun[9], begun[10], begun[11]), contacts, fixed.tick_s)
    push = (robot.x, robot.y, robot.yaw), triple(robot.position), force, torque
    if clear_of_movers(robot, fixed) and end_if_clear(
        robot, fixed, near, noise[index], push
    ):
        left[index] -= 1
        return bool(left[index] > 0)
    _fill(pushes, push)
    return False


@njit(cache=True)
def _fill(rows: Floats, push: Push) -> None:
    for k in range(4):
        fill(rows[k], push[k])


@njit(cache=True, error_model="numpy", forceinline=True, **BARE)
def _sweep(
    rows: Floats,
    wheels: Floats,
    done: Integers,
    grips: int,
    inverse_mass: float,
    used: int,
) -> int:
    """Do a sweep of `sweep_friction` in the lanes in use; fill in which are done (LANES,), and return how many."""
    width = (
        (used + 7) // 8 * 8
    )  # whole vectors; what is computed in the lanes beyond, nobody reads
    for k in range(width):
        rows[_LARGEST * LANES + k] = 0.0
    for i in range(grips):
        _sweep_wheel(
            rows,
            wheels[i * _WHEEL_ROWS * LANES : (i + 1) * _WHEEL_ROWS * LANES],
            inverse_mass,
            width,
        )
    for k in range(width):
        rows[_SWEEPS * LANES + k] += 1.0
        over = (rows[_LARGEST * LANES + k] < TOLERANCE) | (
            rows[_SWEEPS * LANES + k] >= SWEEPS
        )
        done[k] = 1 if over | (rows[_WRONG * LANES + k] > 0.0) else 0
    count = 0
    for k in range(used):
        count += done[k]
    return count


@njit(cache=True, error_model="numpy", forceinline=True, **BARE)
def _sweep_wheel(rows: Floats, wheel: Floats, inverse_mass: float, width: int) -> None:
    for k in range(width):
        x, y, z = (
            wheel[_ARM * LANES + k],
            wheel[(_ARM + 1) * LANES + k],
            wheel[(_ARM + 2) * LANES + k],
        )
        vx, vy, wx = rows[k], rows[LANES + k], rows[2 * LANES + k]
        wy, wz = rows[3 * LANES + k], rows[4 * LANES + k]
        slip_x = vx + wy * z - wz * y - wheel[_RIM * LANES + k]
        slip_y = vy + wz * x - wx * z - wheel[(_RIM + 1) * LANES + k]
        step, limit, surely = (
            wheel[_STEP * LANES + k],
            wheel[_LIMIT * LANES + k],
            wheel[_SURE * LANES + k],
        )
        old_x, old_y = wheel[k], wheel[LANES + k]
        new_x, new_y, right = clipped_abreast(
            old_x - step * slip_x, old_y - step * slip_y, limit, surely
        )
        rows[_WRONG * LANES + k] = rows[_WRONG * LANES + k] if right else 1.0
        change_x, change_y = new_x - old_x, new_y - old_y
        wheel[k], wheel[LANES + k] = new_x, new_y
        levers = (
            wheel[_LEVERS * LANES + k], wheel[(_LEVERS + 1) * LANES + k], wheel[(_LEVERS + 2) * LANES + k],
            wheel[(_LEVERS + 3) * LANES + k], wheel[(_LEVERS + 4) * LANES + k], wheel[(_LEVERS + 5) * LANES + k],
        )  # fmt: skip
        motion = after((vx, vy, wx, wy, wz), levers, inverse_mass, change_x, change_y)
        (
            rows[k],
            rows[LANES + k],
            rows[2 * LANES + k],
            rows[3 * LANES + k],
            rows[4 * LANES + k],
        ) = motion
        changed = abs(change_x)
        changed = abs(change_y) if abs(change_y) > changed else changed
        largest = rows[_LARGEST * LANES + k]
        rows[_LARGEST * LANES + k] = changed if changed > largest else largest
