"""Many robots advanced abreast in compiled code, each as `barn_sim.motion.ticks` does by itself, to the last bit.

Each robot has a lane in a group of lanes, which begin and end ticks together in vector instructions. In between comes
the iteration for friction. It takes a few sweeps for most robots but a hundred for some, so it has lanes of its own:
one that is done takes up the next robot while the others go on. What is rare is left to `barn_sim.motion.ticks`.
"""

import math

import numpy as np
from numba import njit

from barn_sim.body.drive import add_command, turn_wheels
from barn_sim.motion import lanes, layout
from barn_sim.motion.free_motion import fill, triple
from barn_sim.motion.layout import LANES, load, store, three
from barn_sim.motion.state import Record, Records
from barn_sim.motion.sweeps import free_lanes, release, sweep, take_up
from barn_sim.motion.ticks import Push, advance, count_tick, end_free_tick, push_on
from barn_worlds.base.arrays import Floats, Integers

_ABSENT, _BETWEEN, _BEGUN, _SOLVED = 0, 1, 2, 3  # of the robot of a lane: where it is in a tick
_ALONE = 3  # so many robots are faster one after the other
_ENOUGH, _FEW = LANES // 2, 2  # robots for which a group ends a tick; lanes in use with which it ends any


@njit(cache=True, nogil=True)
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
    pushes: Floats,
) -> None:
    """Do as `barn_sim.motion.ticks.advance` for the robots `indices`; fill in ticks left (n,) and pushes (n, 4, 3).

    commands (n, 2): given now, there must be room for them. segments (n, m, 4): those of each robot's world, the first
    `cylinders` (n,) of a row.
    """
    for index in indices:
        robot: Record = robots[index]
        add_command(robots, pending, index, robot.stamp_ns + latency_ns, commands[index, 0], commands[index, 1])
        left[index] = ticks
    if len(indices) <= _ALONE:
        for index in indices:
            near = segments[index, : cylinders[index]]
            left[index], push = advance(robots, pending, settings, index, near, noise, ticks)
            _fill(pushes[index], push)
        return
    _advance_abreast(robots, pending, settings, segments, cylinders, noise, indices, left, pushes)


@njit(cache=True)
def _advance_abreast(
    robots: Records,
    pending: Floats,
    settings: Records,
    segments: Floats,
    cylinders: Integers,
    noise: Floats,
    indices: Integers,
    left: Integers,
    pushes: Floats,
) -> None:
    """Do as `advance_all`, given the commands.

    When no robot waits for a lane for friction, the group with most solved ends its tick and begins the next.
    """
    fixed: Record = settings[0]
    going, many, grips = len(indices), (len(indices) + LANES - 1) // LANES, fixed.grips
    rows, wheels = np.zeros((many, layout.ROWS * LANES)), np.ones((many, fixed.contacts * layout.WHEEL_ROWS * LANES))
    stages, solved = np.full(many * LANES, _ABSENT), np.zeros(many, np.int64)
    waiting, first, last = np.empty(many * LANES, np.int64), 0, 0  # places of robots whose tick has begun
    for place in range(going):
        load(robots[indices[place]], rows[place // LANES], wheels[place // LANES], place % LANES, fixed.contacts)
        stages[place] = _BETWEEN
    for group in range(many):
        last = _begin(robots, pending, settings, indices, group, rows, wheels, stages, solved, waiting, last)
    motions, impulses, holds, done = free_lanes(grips)
    used = 0
    while True:
        group = _fullest(solved)
        if going <= _ALONE and solved[group] == 0:
            break
        if first == last and solved[group] >= (1 if used <= _FEW else _ENOUGH):
            going -= _end(
                robots, settings, segments, cylinders, noise, indices, left, pushes, group, rows, wheels, stages
            )
            solved[group], first = 0, 0
            last = _begin(robots, pending, settings, indices, group, rows, wheels, stages, solved, waiting, 0)
        if first < last and used < LANES:
            used -= first
            first = take_up(motions, impulses, holds, waiting, first, last, rows, wheels, grips)
            used += first
        if sweep(motions, impulses, done, grips, fixed.inverse_mass):
            used -= _release(motions, impulses, holds, done, rows, wheels, stages, solved, grips)
    for place in range(len(indices)):
        if stages[place] != _ABSENT:
            _finish(
                robots, pending, settings, segments, cylinders, noise, indices[place], left, pushes,
                rows[place // LANES], wheels[place // LANES], place % LANES,
            )  # fmt: skip


@njit(cache=True)
def _finish(
    robots: Records, pending: Floats, settings: Records, segments: Floats, cylinders: Integers, noise: Floats,
    index: int, left: Integers, pushes: Floats, rows: Floats, wheels: Floats, k: int,
) -> None:  # fmt: skip
    """Advance one of the last robots, which has begun a tick, by itself."""
    near = segments[index, : cylinders[index]]
    rows[layout.USUAL * LANES + k] = 0.0
    if _end_by_itself(robots, settings, index, near, noise, pushes[index], rows, wheels, k):
        left[index], push = advance(robots, pending, settings, index, near, noise, left[index] - 1)
        _fill(pushes[index], push)


@njit(cache=True, forceinline=True)
def _fullest(solved: Integers) -> int:
    """Return the group with most robots whose friction is solved."""
    fullest = 0
    for group in range(len(solved)):
        if solved[group] > solved[fullest]:
            fullest = group
    return fullest


@njit(cache=True)
def _release(
    motions: Floats, impulses: Floats, holds: Integers, done: Integers, rows: Floats, wheels: Floats, stages: Integers,
    solved: Integers, grips: int,
) -> int:  # fmt: skip
    """Release robots whose friction is solved; return how many."""
    count = 0
    for lane in range(LANES):
        if done[lane]:
            place = holds[lane]
            if not release(motions, impulses, holds, lane, wheels, grips):
                rows[place // LANES, layout.USUAL * LANES + place % LANES] = 0.0
            stages[place] = _SOLVED
            solved[place // LANES] += 1
            count += 1
    return count


@njit(cache=True)
def _fill(rows: Floats, push: Push) -> None:
    for k in range(4):
        fill(rows[k], push[k])


@njit(cache=True)
def _begin(
    robots: Records, pending: Floats, settings: Records, indices: Integers, group: int, groups: Floats,
    contacts: Floats, all_stages: Integers, solved: Integers, waiting: Integers, last: int,
) -> int:  # fmt: skip
    """Begin a tick for robots of a group that are between ticks; let them wait behind `last`, return the new one."""
    fixed: Record = settings[0]
    first: Record = robots[indices[0]]
    rows, wheels, stages = groups[group], contacts[group], all_stages[group * LANES : (group + 1) * LANES]
    for k in range(LANES):
        if stages[k] == _BETWEEN:
            index = indices[group * LANES + k]
            robot: Record = robots[index]
            turn_wheels(robot, pending, index, fixed, robot.stamp_ns)
            rows[layout.RIMS * LANES + k], rows[(layout.RIMS + 1) * LANES + k] = robot.left_m_s, robot.right_m_s
    lanes.begin(rows, wheels, first.wheels[: fixed.contacts, :3], fixed)
    for k in range(LANES):
        if stages[k] == _BETWEEN:
            if rows[layout.USUAL * LANES + k] > 0.0:
                stages[k] = _BEGUN
                waiting[last] = group * LANES + k
                last += 1
            else:
                stages[k] = _SOLVED
                solved[group] += 1
    return last


@njit(cache=True)
def _end(
    robots: Records, settings: Records, segments: Floats, cylinders: Integers, noise: Floats, indices: Integers,
    left: Integers, pushes: Floats, group: int, groups: Floats, contacts: Floats, all_stages: Integers,
) -> int:  # fmt: skip
    """End the tick of those robots of a group whose friction is solved; return how many have no tick left."""
    fixed: Record = settings[0]
    rows, wheels, stages = groups[group], contacts[group], all_stages[group * LANES : (group + 1) * LANES]
    finished = 0
    lanes.act(rows, wheels, fixed.contacts, fixed)
    for k in range(LANES):
        rows[layout.MOVES * LANES + k] = 0.0
        if stages[k] != _SOLVED:
            continue
        index = indices[group * LANES + k]
        if rows[layout.CLEAR * LANES + k] * rows[layout.USUAL * LANES + k] > 0.0:
            half = rows[layout.HALF * LANES + k]
            rows[layout.SINE * LANES + k], rows[layout.COSINE * LANES + k] = math.sin(half), math.cos(half)
            rows[layout.MOVES * LANES + k] = 1.0
            continue
        stages[k] = _ABSENT
        near = segments[index, : cylinders[index]]
        if _end_by_itself(robots, settings, index, near, noise, pushes[index], rows, wheels, k):
            left[index] -= 1
            stages[k] = _BETWEEN if left[index] > 0 else _ABSENT
        finished += stages[k] == _ABSENT
    lanes.move(rows, fixed)
    for k in range(LANES):
        if rows[layout.MOVES * LANES + k] > 0.0:
            index = indices[group * LANES + k]
            robot: Record = robots[index]
            yaw = math.atan2(rows[layout.YAW_SINE * LANES + k], rows[layout.YAW_COSINE * LANES + k])
            robot.away += 1
            robot.x, robot.y, _ = three(rows, layout.POSE, k)
            robot.yaw = rows[(layout.POSE + 2) * LANES + k] = yaw
            count_tick(robot, fixed, noise, index)
            left[index] -= 1
            stages[k] = _BETWEEN
            if left[index] == 0:
                stages[k] = _ABSENT
                finished += 1
                store(robot, rows, wheels, k, fixed.contacts)
    return finished


@njit(cache=True)
def _end_by_itself(
    robots: Records, settings: Records, index: int, near: Floats, noise: Floats, pushes: Floats, rows: Floats,
    wheels: Floats, k: int,
) -> bool:  # fmt: skip
    """End the tick of a robot as if it were alone, if it is free, else fill in its push; tell whether."""
    fixed: Record = settings[0]
    robot: Record = robots[index]
    store(robot, rows, wheels, k, fixed.contacts)
    if rows[layout.USUAL * LANES + k] > 0.0:
        force, torque = three(rows, layout.FORCE, k), three(rows, layout.TORQUE, k)
        push = (robot.x, robot.y, robot.yaw), triple(robot.position), force, torque
    else:
        push = push_on(robot, fixed)
    if not end_free_tick(robots, settings, index, near, noise, push):
        _fill(pushes, push)
        return False
    load(robot, rows, wheels, k, fixed.contacts)
    return True
