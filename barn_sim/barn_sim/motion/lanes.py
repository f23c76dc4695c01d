"""Many robots advanced in compiled code, each as `barn_sim.motion.ticks.advance` does.

In the iteration for friction each step waits for the one before, and it takes a few
sweeps for most robots but a hundred for some. So sweeps are done for several robots at
once, each in a lane of vector instructions. A robot keeps its lane until it has no tick
left, then the next one takes the lane. When there is none, the last lane moves there. The
few robots that are left at the end go on one after the other.
"""

import numpy as np
from numba import njit

from barn_sim.body.drive import add_command, turn_wheels
from barn_sim.body.friction import (
    SWEEPS,
    TOLERANCE,
    Motion,
    apply_impulse,
    clip,
    sweep_friction,
)
from barn_sim.body.rigid_body import move_body
from barn_sim.body.state import IMPULSE, Record, Records
from barn_sim.body.tires import begin_tires
from barn_sim.motion.ticks import NO_REFERENCES, advance, finish_tick, is_free
from barn_worlds.base.arrays import Floats, Integers

LANES = 32
# So few robots are faster one after the other.
_FEW = 3
# Numbers of a vector instruction.
_VECTOR = 8

# Rows of LANES numbers for each robot, in an array of one dimension, so that the compiler
# knows how far apart they are: the motion, the largest change of an impulse in a sweep,
# and the number of sweeps.
_LARGEST = 5
_SWEEPS = 6
_ROWS = 7
# Rows for each wheel: the columns of the robot's record that begin with the impulse, then
# the speed of the rim along x and y.
_ARM = 2
_LIMIT = 5
_LEVERS = 6
_STEP = 12
_RIM = 13
_WHEEL_ROWS = 15


@njit(cache=True)
def advance_all(
    robots: Records,
    pending: Floats,
    settings: Records,
    segments: Floats,
    cylinders: Integers,
    noise: Floats,
    ticks: int,
    indices: Integers,
    commands: Floats,
    latency_ns: int,
    left: Integers,
) -> None:
    """Send commands to robots and advance each as long as no obstacle is near.

    Args:
        robots: Records (n,) of robots.
        pending: Commands on their way (n, capacity, 3), with room for one more.
        settings: The fleet's settings (1,).
        segments: Axes (n, m, 4) of the cylinders in each robot's world, m.
        cylinders: How many of the m rows each world has (n,).
        noise: Noise of the odometry's next updates (n, k, 2).
        ticks: Largest number of ticks.
        indices: Rows of the robots that advance.
        commands: Speed (m/s) and yaw rate (rad/s) for each robot (n, 2).
        latency_ns: Time until a command takes effect.
        left: Filled in (n,): ticks that are left, since something is near.
    """
    for index in indices:
        arrival_ns = robots[index].stamp_ns + latency_ns
        linear = commands[index, 0]
        angular = commands[index, 1]
        add_command(robots, pending, index, arrival_ns, linear, angular)
        left[index] = ticks
    rows = np.zeros(_ROWS * LANES)
    wheels = np.zeros(settings[0].grips * _WHEEL_ROWS * LANES)
    lanes = np.zeros(LANES, np.int64)
    done = np.zeros(LANES, np.int64)
    _advance_lanes(
        robots,
        pending,
        settings,
        segments,
        cylinders,
        noise,
        indices,
        left,
        rows,
        wheels,
        lanes,
        done,
    )


@njit(cache=True, **NO_REFERENCES)
def _advance_lanes(
    robots: Records,
    pending: Floats,
    settings: Records,
    segments: Floats,
    cylinders: Integers,
    noise: Floats,
    indices: Integers,
    left: Integers,
    rows: Floats,
    wheels: Floats,
    lanes: Integers,
    done: Integers,
) -> None:
    """Advance robots in lanes; lanes (LANES,): the robot in each lane."""
    fixed: Record = settings[0]
    state = (robots, pending, settings, segments, cylinders)
    used = 0
    waiting = 0
    is_full = True
    while is_full and used < LANES:
        is_full, waiting = _fill_lane(
            *state, indices, waiting, rows, wheels, lanes, used
        )
        used += is_full

    while used > _FEW:
        while _sweep(rows, wheels, done, fixed.grips, fixed.inverse_mass, used) == 0:
            pass
        for lane in range(used - 1, -1, -1):
            if not done[lane]:
                continue
            index = lanes[lane]
            motion = _leave_lane(robots[index], fixed, rows, wheels, lane)
            move_body(robots[index], fixed, motion)
            finish_tick(robots[index], fixed, noise[index])
            left[index] -= 1

            # The same robot goes on, or one that waits, or the one in the last lane.
            is_full = left[index] > 0 and _begin_tick(*state, index, rows, wheels, lane)
            if not is_full:
                is_full, waiting = _fill_lane(
                    *state, indices, waiting, rows, wheels, lanes, lane
                )
            if not is_full:
                used -= 1
                lanes[lane] = lanes[used]
                _move_lane(rows, wheels, used, lane, fixed.grips)

    for lane in range(used):
        index = lanes[lane]
        near = segments[index, : cylinders[index]]
        _finish_sweeps(robots[index], fixed, noise[index], rows, wheels, lane)
        left[index] = advance(
            robots, pending, settings, index, near, noise, left[index] - 1
        )


@njit(cache=True, **NO_REFERENCES)
def _finish_sweeps(
    robot: Record, fixed: Record, noise: Floats, rows: Floats, wheels: Floats, lane: int
) -> None:
    """Complete the tick of a robot in a lane by itself."""
    sweeps = SWEEPS - int(rows[_SWEEPS * LANES + lane])
    left_x = wheels[_RIM * LANES + lane]
    left_y = wheels[(_RIM + 1) * LANES + lane]
    right_x = wheels[(_WHEEL_ROWS + _RIM) * LANES + lane]
    right_y = wheels[(_WHEEL_ROWS + _RIM + 1) * LANES + lane]
    motion = _leave_lane(robot, fixed, rows, wheels, lane)
    motion = sweep_friction(
        motion,
        (left_x, right_x, left_y, right_y),
        robot.wheels[: fixed.grips],
        fixed.inverse_mass,
        sweeps,
    )
    move_body(robot, fixed, motion)
    finish_tick(robot, fixed, noise)


@njit(cache=True, **NO_REFERENCES)
def _fill_lane(
    robots: Records,
    pending: Floats,
    settings: Records,
    segments: Floats,
    cylinders: Integers,
    indices: Integers,
    waiting: int,
    rows: Floats,
    wheels: Floats,
    lanes: Integers,
    lane: int,
) -> tuple[bool, int]:
    """Put the next robot that is free into a lane; return whether, and who waits."""
    while waiting < len(indices):
        index = indices[waiting]
        waiting += 1
        if _begin_tick(
            robots, pending, settings, segments, cylinders, index, rows, wheels, lane
        ):
            lanes[lane] = index
            return True, waiting
    return False, waiting


@njit(cache=True, **NO_REFERENCES)
def _begin_tick(
    robots: Records,
    pending: Floats,
    settings: Records,
    segments: Floats,
    cylinders: Integers,
    index: int,
    rows: Floats,
    wheels: Floats,
    lane: int,
) -> bool:
    """Put a robot into a lane, up to the first sweep, if no obstacle is near."""
    robot: Record = robots[index]
    fixed: Record = settings[0]
    if not is_free(robot, fixed, segments[index, : cylinders[index]]):
        return False
    turn_wheels(robot, pending, index, fixed, robot.stamp_ns)
    motion, rims = begin_tires(robot, fixed)
    for row in range(5):
        rows[row * LANES + lane] = motion[row]
    rows[_SWEEPS * LANES + lane] = 0.0
    for i in range(fixed.grips):
        columns = robot.wheels[i]
        wheel = wheels[i * _WHEEL_ROWS * LANES + lane :]
        for row in range(_RIM):
            wheel[row * LANES] = columns[IMPULSE + row]
        wheel[_RIM * LANES] = rims[i % 2]
        wheel[(_RIM + 1) * LANES] = rims[2 + i % 2]
    return True


@njit(cache=True, forceinline=True, **NO_REFERENCES)
def _leave_lane(
    robot: Record, fixed: Record, rows: Floats, wheels: Floats, lane: int
) -> Motion:
    """Copy the impulses of a lane to the robot's record, and return the motion."""
    for i in range(fixed.grips):
        first = i * _WHEEL_ROWS * LANES + lane
        robot.wheels[i, IMPULSE] = wheels[first]
        robot.wheels[i, IMPULSE + 1] = wheels[first + LANES]
    return (
        rows[lane],
        rows[LANES + lane],
        rows[2 * LANES + lane],
        rows[3 * LANES + lane],
        rows[4 * LANES + lane],
    )


@njit(cache=True, **NO_REFERENCES)
def _move_lane(
    rows: Floats, wheels: Floats, source: int, target: int, grips: int
) -> None:
    for row in range(_ROWS):
        rows[row * LANES + target] = rows[row * LANES + source]
    for row in range(grips * _WHEEL_ROWS):
        wheels[row * LANES + target] = wheels[row * LANES + source]


@njit(cache=True, error_model="numpy", forceinline=True, **NO_REFERENCES)
def _sweep(
    rows: Floats,
    wheels: Floats,
    done: Integers,
    grips: int,
    inverse_mass: float,
    used: int,
) -> int:
    """Do a sweep in the lanes in use; fill in which are done, return how many."""
    # Whole vectors; nobody reads the numbers in the lanes beyond.
    width = (used + _VECTOR - 1) // _VECTOR * _VECTOR
    for k in range(width):
        rows[_LARGEST * LANES + k] = 0.0
    for i in range(grips):
        wheel = wheels[i * _WHEEL_ROWS * LANES : (i + 1) * _WHEEL_ROWS * LANES]
        _sweep_wheel(rows, wheel, inverse_mass, width)
    for k in range(width):
        rows[_SWEEPS * LANES + k] += 1.0
        has_converged = rows[_LARGEST * LANES + k] < TOLERANCE
        is_last = rows[_SWEEPS * LANES + k] >= SWEEPS
        done[k] = 1 if has_converged | is_last else 0
    count = 0
    for k in range(used):
        count += done[k]
    return count


@njit(cache=True, error_model="numpy", forceinline=True, **NO_REFERENCES)
def _sweep_wheel(rows: Floats, wheel: Floats, inverse_mass: float, width: int) -> None:
    """Do as `sweep_friction` for one wheel of the robots in all lanes."""
    for k in range(width):
        vx = rows[k]
        vy = rows[LANES + k]
        wx = rows[2 * LANES + k]
        wy = rows[3 * LANES + k]
        wz = rows[4 * LANES + k]
        x = wheel[_ARM * LANES + k]
        y = wheel[(_ARM + 1) * LANES + k]
        z = wheel[(_ARM + 2) * LANES + k]
        slip_x = vx + wy * z - wz * y - wheel[_RIM * LANES + k]
        slip_y = vy + wz * x - wx * z - wheel[(_RIM + 1) * LANES + k]

        old_x = wheel[k]
        old_y = wheel[LANES + k]
        step = wheel[_STEP * LANES + k]
        limit = wheel[_LIMIT * LANES + k]
        new_x, new_y = clip(old_x - step * slip_x, old_y - step * slip_y, limit)
        wheel[k] = new_x
        wheel[LANES + k] = new_y
        change_x = new_x - old_x
        change_y = new_y - old_y

        levers = (
            wheel[_LEVERS * LANES + k],
            wheel[(_LEVERS + 1) * LANES + k],
            wheel[(_LEVERS + 2) * LANES + k],
            wheel[(_LEVERS + 3) * LANES + k],
            wheel[(_LEVERS + 4) * LANES + k],
            wheel[(_LEVERS + 5) * LANES + k],
        )
        motion = apply_impulse(
            (vx, vy, wx, wy, wz), levers, inverse_mass, change_x, change_y
        )
        rows[k] = motion[0]
        rows[LANES + k] = motion[1]
        rows[2 * LANES + k] = motion[2]
        rows[3 * LANES + k] = motion[3]
        rows[4 * LANES + k] = motion[4]

        # Selects, which become vector instructions, unlike `max`.
        size_x = abs(change_x)
        size_y = abs(change_y)
        change = size_y if size_y > size_x else size_x
        largest = rows[_LARGEST * LANES + k]
        rows[_LARGEST * LANES + k] = change if change > largest else largest
