"""Many robots advanced in compiled code, each as `barn_sim.motion.ticks.advance` does.

In the iteration for friction each step waits for the one before, and it takes a few
sweeps for most robots but a hundred for some. So sweeps are done for several robots at
once, each in a lane of vector instructions. A robot keeps its lane until it has no tick
left, then the next one takes the lane. When there is none, the last lane moves there.
The few robots that are left at the end go on one after the other.
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
from barn_sim.body.rigid_body import begin_tires, move_body
from barn_sim.body.state import Fleet, Record, record_type
from barn_sim.body.vectors import fill
from barn_sim.motion.ticks import NO_REFERENCES, advance, finish_tick, is_free
from barn_worlds.base.arrays import Floats, Integers, kernel

LANES = 32
# So few robots are faster one after the other.
_FEW = 3
# Numbers of a vector instruction.
_VECTOR = 8

# A number for each lane. Records of such rows have fixed places in memory, which the
# compiler needs for vector instructions.
_ROW = (np.float64, LANES)
# A wheel of the robot in each lane, see `barn_sim.body.state.WHEEL`.
_WHEEL = record_type(
    [
        ("impulse_x", *_ROW),
        ("impulse_y", *_ROW),
        ("arm_x", *_ROW),
        ("arm_y", *_ROW),
        ("arm_z", *_ROW),
        ("limit", *_ROW),
        ("levers", np.float64, (6, LANES)),
        ("step", *_ROW),
        ("keep", *_ROW),
        ("rim_x", *_ROW),
        ("rim_y", *_ROW),
    ]
)
# The robot in each lane: its row in the fleet, its motion, the largest change of an
# impulse in a sweep, the number of sweeps, and whether the iteration is done.
_LANES = record_type(
    [
        ("index", np.int64, LANES),
        ("motion", np.float64, (5, LANES)),
        ("largest", *_ROW),
        ("sweeps", np.int64, LANES),
        ("done", np.int64, LANES),
        ("wheels", _WHEEL, 4),
    ]
)
# Everything about the lanes is rows of numbers of eight bytes.
_ROWS = _LANES.itemsize // (8 * LANES)


@kernel
def advance_all(
    fleet: Fleet,
    segments: Floats,
    cylinders: Integers,
    ticks: int,
    indices: Integers,
    commands: Floats,
    latency_ns: int,
    left: Integers,
) -> None:
    """Queue commands and advance robots; write the ticks that each has left to `left`.

    Args:
        fleet: Robots with room for one more command each.
        segments: Axes (n, m, 4) of the cylinders in each robot's world, m.
        cylinders: How many of the m rows each world has (n,).
        ticks: Largest number of ticks.
        indices: Rows of the robots that advance.
        commands: Speed (m/s) and yaw rate (rad/s) for each robot (n, 2).
        latency_ns: Time until a command takes effect.
        left: Filled in (n,): ticks that are left, since something is near.
    """
    for index in indices:
        arrival_ns = fleet.robots[index].stamp_ns + latency_ns
        linear = commands[index, 0]
        add_command(fleet, index, arrival_ns, linear, commands[index, 1])
        left[index] = ticks
    numbers = np.zeros((_ROWS, LANES))
    lanes = numbers.reshape(numbers.size).view(_LANES)
    _advance_lanes(fleet, segments, cylinders, indices, left, lanes[0], numbers)


@njit(cache=True, **NO_REFERENCES)
def _advance_lanes(
    fleet: Fleet,
    segments: Floats,
    cylinders: Integers,
    indices: Integers,
    left: Integers,
    lanes: Record,
    numbers: Floats,
) -> None:
    """Advance robots until each is near an obstacle or `left`, counted down, is 0."""
    robots, _, settings, noise = fleet
    fixed: Record = settings[0]
    state = (fleet, segments, cylinders)
    used = 0
    waiting = 0
    is_full = True
    while is_full and used < LANES:
        is_full, waiting = _fill_lane(*state, indices, waiting, lanes, used)
        used += is_full

    while used > _FEW:
        while _sweep(lanes, fixed, used) == 0:
            pass
        for lane in range(used - 1, -1, -1):
            if not lanes.done[lane]:
                continue
            index = lanes.index[lane]
            motion = _leave_lane(robots[index], fixed, lanes, lane)
            move_body(robots[index], fixed, motion)
            finish_tick(robots[index], fixed, noise[index])
            left[index] -= 1

            # The same robot goes on, or one that waits, or the one in the last lane.
            is_full = left[index] > 0 and _begin_tick(*state, index, lanes, lane)
            if not is_full:
                is_full, waiting = _fill_lane(*state, indices, waiting, lanes, lane)
            if not is_full:
                used -= 1
                # Bit by bit, so that the rows with whole numbers move as well.
                for row in range(_ROWS):
                    numbers[row, lane] = numbers[row, used]

    for lane in range(used):
        index = lanes.index[lane]
        near = segments[index, : cylinders[index]]
        _finish_sweeps(robots[index], fixed, noise[index], lanes, lane)
        left[index] = advance(fleet, index, near, left[index] - 1)


@njit(cache=True, **NO_REFERENCES)
def _fill_lane(
    fleet: Fleet,
    segments: Floats,
    cylinders: Integers,
    indices: Integers,
    waiting: int,
    lanes: Record,
    lane: int,
) -> tuple[bool, int]:
    """Put the next free robot into a lane; return success and the next row to try."""
    while waiting < len(indices):
        index = indices[waiting]
        waiting += 1
        if _begin_tick(fleet, segments, cylinders, index, lanes, lane):
            return True, waiting
    return False, waiting


@njit(cache=True, **NO_REFERENCES)
def _begin_tick(
    fleet: Fleet,
    segments: Floats,
    cylinders: Integers,
    index: int,
    lanes: Record,
    lane: int,
) -> bool:
    """Begin a robot's tick in a lane, before sweeps; False if an obstacle is near."""
    robot: Record = fleet.robots[index]
    fixed: Record = fleet.settings[0]
    if not is_free(robot, fixed, segments[index, : cylinders[index]]):
        return False
    turn_wheels(robot, fleet.pending[index], fixed)
    motion, rims = begin_tires(robot, fixed)
    lanes.index[lane] = index
    lanes.sweeps[lane] = 0
    fill(lanes.motion[:, lane], motion)
    for i in range(fixed.grips):
        wheel: Record = robot.wheels[i]
        row: Record = lanes.wheels[i]
        row.impulse_x[lane] = wheel.impulse_x
        row.impulse_y[lane] = wheel.impulse_y
        row.arm_x[lane] = wheel.arm_x
        row.arm_y[lane] = wheel.arm_y
        row.arm_z[lane] = wheel.arm_z
        row.limit[lane] = wheel.limit
        row.step[lane] = wheel.step
        row.keep[lane] = wheel.keep
        row.rim_x[lane] = rims[i % 2]
        row.rim_y[lane] = rims[2 + i % 2]
        for k in range(6):
            row.levers[k, lane] = wheel.levers[k]
    return True


@njit(forceinline=True, cache=True, **NO_REFERENCES)
def _leave_lane(robot: Record, fixed: Record, lanes: Record, lane: int) -> Motion:
    """Copy the impulses of a lane to the robot's record; return the lane's motion."""
    for i in range(fixed.grips):
        robot.wheels[i].impulse_x = lanes.wheels[i].impulse_x[lane]
        robot.wheels[i].impulse_y = lanes.wheels[i].impulse_y[lane]
    motion = lanes.motion
    return (
        motion[0, lane],
        motion[1, lane],
        motion[2, lane],
        motion[3, lane],
        motion[4, lane],
    )


@njit(cache=True, **NO_REFERENCES)
def _finish_sweeps(
    robot: Record, fixed: Record, noise: Floats, lanes: Record, lane: int
) -> None:
    """Finish a tick out of the lane: friction sweeps left, motion and odometry."""
    left: Record = lanes.wheels[0]
    right: Record = lanes.wheels[1]
    rims = (left.rim_x[lane], right.rim_x[lane], left.rim_y[lane], right.rim_y[lane])
    motion = _leave_lane(robot, fixed, lanes, lane)
    grips = robot.wheels[: fixed.grips]
    sweeps = SWEEPS - lanes.sweeps[lane]
    motion = sweep_friction(motion, rims, grips, fixed.inverse_mass, sweeps)
    move_body(robot, fixed, motion)
    finish_tick(robot, fixed, noise)


@njit(error_model="numpy", forceinline=True, cache=True, **NO_REFERENCES)
def _sweep(lanes: Record, fixed: Record, used: int) -> int:
    """Do a friction sweep in the lanes in use, mark which are done; return how many."""
    # Whole vectors; nobody reads the numbers in the lanes beyond.
    width = (used + _VECTOR - 1) // _VECTOR * _VECTOR
    for k in range(width):
        lanes.largest[k] = 0.0
    for i in range(fixed.grips):
        _sweep_wheel(lanes, lanes.wheels[i], fixed.inverse_mass, width)
    for k in range(width):
        lanes.sweeps[k] += 1
        has_converged = lanes.largest[k] < TOLERANCE
        lanes.done[k] = has_converged | (lanes.sweeps[k] >= SWEEPS)
    count = 0
    for k in range(used):
        count += lanes.done[k]
    return count


@njit(error_model="numpy", forceinline=True, cache=True, **NO_REFERENCES)
def _sweep_wheel(lanes: Record, wheel: Record, inverse_mass: float, width: int) -> None:
    """Improve the impulses of one wheel in all lanes, as `sweep_friction` does."""
    rows = lanes.motion
    levers = wheel.levers
    for k in range(width):
        motion = (rows[0, k], rows[1, k], rows[2, k], rows[3, k], rows[4, k])
        vx, vy, wx, wy, wz = motion
        slip_x = vx + wy * wheel.arm_z[k] - wz * wheel.arm_y[k] - wheel.rim_x[k]
        slip_y = vy + wz * wheel.arm_x[k] - wx * wheel.arm_z[k] - wheel.rim_y[k]
        x = wheel.keep[k] * wheel.impulse_x[k] - wheel.step[k] * slip_x
        y = wheel.keep[k] * wheel.impulse_y[k] - wheel.step[k] * slip_y
        x, y = clip(x, y, wheel.limit[k])
        change_x = x - wheel.impulse_x[k]
        change_y = y - wheel.impulse_y[k]
        wheel.impulse_x[k] = x
        wheel.impulse_y[k] = y
        motion = apply_impulse(motion, levers[:, k], inverse_mass, change_x, change_y)
        fill(rows[:, k], motion)

        # Selects, which become vector instructions, unlike `max`.
        size_x = abs(change_x)
        size_y = abs(change_y)
        change = size_y if size_y > size_x else size_x
        lanes.largest[k] = change if change > lanes.largest[k] else lanes.largest[k]
