"""Many robots advanced abreast in compiled code, each as `barn_sim.ticks` does by itself, to the last bit.

Most of a tick is the iteration for friction, in which every operation waits for the one before. Here it is done for
several robots at once, each in a lane of vector instructions. A lane whose robot is done takes up the next tick, or the
next robot, while the others go on.
"""

import math
from typing import Any

import numpy as np
from numba import njit

from barn_sim.drive import add_command, turn_wheels
from barn_sim.friction import HUGE, NOTHING, SWEEPS, TINY, TOLERANCE, begin_friction, sweep_friction
from barn_sim.motion import Triple, fill, quaternion, triple
from barn_sim.state import Records
from barn_sim.ticks import Push, advance, end_free_tick
from barn_sim.tyres import forces, stand
from barn_worlds.arrays import Floats, Integers

LANES = 16
# Rows of a lane: the motion, how fast rims go, as in `sweep_friction`, what the loads do, and what a sweep has found.
_MOTION, _RIMS, _CARRIED, _START, _LARGEST, _BY_ITSELF = 0, 5, 9, 12, 17, 18
_ROWS = 19
# Rows of each wheel: columns of ROBOT.wheels from the third on: impulse, arm, limit, levers, step, surely.
_IMPULSE, _ARM, _LIMIT, _LEVERS, _STEP, _SURELY, _RIM = 0, 2, 5, 6, 12, 13, 14
_WHEEL_ROWS = 16


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
    """Do as `barn_sim.ticks.advance` for the robots `indices`; fill in ticks left (n,) and pushes (n, 4, 3).

    commands (n, 2): given now, there must be room for them. segments (n, m, 4): those of each robot's world, the first
    `cylinders` (n,) of a row. Cars, whose wheels are not alike, advance one by one.
    """
    fixed: Any = settings[0]
    if fixed.wheelbase_m > 0.0:
        for index in indices:
            _command(robots, pending, index, commands, latency_ns)
            near = segments[index, : cylinders[index]]
            left[index], push = advance(robots, pending, settings, index, near, noise, ticks)
            _fill(pushes[index], push)
        return
    lanes, wheels = np.zeros(_ROWS * LANES), np.ones(fixed.grips * _WHEEL_ROWS * LANES)
    holds, sweeps = np.full(LANES, -1), np.zeros(LANES, np.int64)  # which robot a lane holds, and sweeps of its tick
    following, busy = 0, 0
    for lane in range(LANES):
        following = _take_up(
            lane, following, indices, robots, pending, settings, commands, latency_ns, ticks, left, holds, sweeps,
            lanes, wheels,
        )  # fmt: skip
        busy += holds[lane] >= 0
    while busy:
        _sweep(lanes, wheels, fixed.grips, 1.0 / fixed.ground[1])
        for lane in range(LANES):
            index = holds[lane]
            if index < 0:
                continue
            sweeps[lane] += 1
            alone = lanes[_BY_ITSELF * LANES + lane] > 0.0
            if lanes[_LARGEST * LANES + lane] >= TOLERANCE and sweeps[lane] < SWEEPS and not alone:
                continue
            force, torque = _solved(robots[index], fixed, lane, alone, lanes, wheels)
            robot: Any = robots[index]
            push = (robot.x, robot.y, robot.yaw), triple(robot.position), force, torque
            near = segments[index, : cylinders[index]]
            if not end_free_tick(robots, settings, index, near, noise, push):
                _fill(pushes[index], push)
            else:
                left[index] -= 1
                if left[index] > 0:
                    _begin_tick(robots, pending, settings, index, lane, lanes, wheels)
                    sweeps[lane] = 0
                    continue
            following = _take_up(
                lane, following, indices, robots, pending, settings, commands, latency_ns, ticks, left, holds, sweeps,
                lanes, wheels,
            )  # fmt: skip
            busy -= holds[lane] < 0


@njit(cache=True)
def _fill(rows: Floats, push: Push) -> None:
    for k in range(4):
        fill(rows[k], push[k])


@njit(cache=True)
def _command(robots: Records, pending: Floats, index: int, commands: Floats, latency_ns: int) -> None:
    robot: Any = robots[index]
    add_command(robots, pending, index, robot.stamp_ns + latency_ns, commands[index, 0], commands[index, 1])


@njit(cache=True)
def _take_up(
    lane: int,
    following: int,
    indices: Integers,
    robots: Records,
    pending: Floats,
    settings: Records,
    commands: Floats,
    latency_ns: int,
    ticks: int,
    left: Integers,
    holds: Integers,
    sweeps: Integers,
    lanes: Floats,
    wheels: Floats,
) -> int:
    """Let a lane hold the next of the robots, or none if there is none; return the place of the one after it."""
    holds[lane] = -1
    if following == len(indices):
        return following
    index = indices[following]
    _command(robots, pending, index, commands, latency_ns)
    holds[lane], left[index], sweeps[lane] = index, ticks, 0
    _begin_tick(robots, pending, settings, index, lane, lanes, wheels)
    return following + 1


@njit(cache=True)
def _begin_tick(
    robots: Records, pending: Floats, settings: Records, index: int, lane: int, lanes: Floats, wheels: Floats
) -> None:
    """Set the wheels of a robot for a tick, and fill in a lane with its friction."""
    robot: Any = robots[index]
    fixed: Any = settings[0]
    turn_wheels(robot, pending[index], fixed, robot.stamp_ns)
    contacts, grips = robot.wheels[: fixed.contacts], fixed.grips
    motion, turn, inverse, carried = stand(
        triple(robot.position), quaternion(robot.attitude), triple(robot.velocity), triple(robot.spin), contacts,
        fixed.ground,
    )  # fmt: skip
    motion, rims = begin_friction(
        motion, robot.left_m_s, robot.right_m_s, contacts[:grips, 5:8], contacts[:grips, 8], turn, inverse,
        1.0 / fixed.ground[1], contacts[:grips, 3:5], contacts[:, 9:],
    )  # fmt: skip
    for k in range(5):
        lanes[(_MOTION + k) * LANES + lane] = lanes[(_START + k) * LANES + lane] = motion[k]
    for k in range(4):
        lanes[(_RIMS + k) * LANES + lane] = rims[k]
    for k in range(3):
        lanes[(_CARRIED + k) * LANES + lane] = carried[k]
    lanes[_BY_ITSELF * LANES + lane] = 0.0
    for i in range(grips):
        for k in range(_RIM):
            wheels[(i * _WHEEL_ROWS + k) * LANES + lane] = contacts[i, 3 + k]
        for k in range(2):
            wheels[(i * _WHEEL_ROWS + _RIM + k) * LANES + lane] = rims[2 * k + i % 2]


@njit(cache=True)
def _solved(robot: Any, fixed: Any, lane: int, alone: bool, lanes: Floats, wheels: Floats) -> tuple[Triple, Triple]:
    """Return force and torque on the robot of a lane; alone: its friction has to be solved by itself."""
    contacts, grips = robot.wheels[: fixed.contacts], fixed.grips
    if alone:
        row = lanes[lane::LANES]
        motion = row[_START], row[_START + 1], row[_START + 2], row[_START + 3], row[_START + 4]
        rims = row[_RIMS], row[_RIMS + 1], row[_RIMS + 2], row[_RIMS + 3]
        arms, limits, impulses = contacts[:grips, 5:8], contacts[:grips, 8], contacts[:grips, 3:5]
        sweep_friction(motion, rims, arms, limits, 1.0 / fixed.ground[1], impulses, contacts[:, 9:])
    else:
        for i in range(grips):
            for k in range(2):
                contacts[i, 3 + k] = wheels[(i * _WHEEL_ROWS + _IMPULSE + k) * LANES + lane]
    at = _CARRIED * LANES + lane
    return forces((lanes[at], lanes[at + LANES], lanes[at + 2 * LANES]), contacts, fixed.ground[0])


@njit(cache=True, error_model="numpy")
def _sweep(lanes: Floats, wheels: Floats, grips: int, inverse_mass: float) -> None:
    """Do a sweep of `sweep_friction` in every lane, without a branch; `_clipped` and `hypot` with all they can do.

    Where lengths are so small or large that `hypot` does something else, `_BY_ITSELF` is set.
    """
    for k in range(LANES):
        lanes[_LARGEST * LANES + k] = 0.0
    for i in range(grips):
        wheel = wheels[i * _WHEEL_ROWS * LANES : (i + 1) * _WHEEL_ROWS * LANES]
        for k in range(LANES):
            x, y, z = wheel[_ARM * LANES + k], wheel[(_ARM + 1) * LANES + k], wheel[(_ARM + 2) * LANES + k]
            wx, wy, wz = lanes[2 * LANES + k], lanes[3 * LANES + k], lanes[4 * LANES + k]
            slip_x = lanes[k] + wy * z - wz * y - wheel[_RIM * LANES + k]
            slip_y = lanes[LANES + k] + wz * x - wx * z - wheel[(_RIM + 1) * LANES + k]
            step, limit = wheel[_STEP * LANES + k], wheel[_LIMIT * LANES + k]
            old_x, old_y = wheel[k], wheel[LANES + k]
            new_x, new_y = old_x - step * slip_x, old_y - step * slip_y
            allowed = new_x * new_x + new_y * new_y < wheel[_SURELY * LANES + k]
            across, along = abs(new_x), abs(new_y)
            low = across if across < along else along
            high = along if across < along else across
            length = math.sqrt(high * high + low * low)
            flat = length > 2.0 * low
            beyond = length - (high if flat else low)
            steep_error = high * (2.0 * beyond - high) + (beyond - 2.0 * (high - low)) * beyond
            flat_error = 2.0 * beyond * (high - 2.0 * low) + ((4.0 * beyond - low) * low + beyond * beyond)
            length = length - (flat_error if flat else steep_error) / (2.0 * length)
            length = high + low if low <= high * NOTHING else length
            scale = limit / length
            scale = scale if length > limit else 1.0
            scale = 1.0 if allowed else scale
            usual = low >= TINY
            usual = usual if high <= HUGE else False
            usual = True if allowed else usual
            lanes[_BY_ITSELF * LANES + k] = lanes[_BY_ITSELF * LANES + k] if usual else 1.0
            new_x, new_y = new_x * scale, new_y * scale
            change_x, change_y = new_x - old_x, new_y - old_y
            wheel[k], wheel[LANES + k] = new_x, new_y
            lanes[k] += inverse_mass * change_x
            lanes[LANES + k] += inverse_mass * change_y
            lanes[2 * LANES + k] = wx + (wheel[6 * LANES + k] * change_x + wheel[7 * LANES + k] * change_y)
            lanes[3 * LANES + k] = wy + (wheel[8 * LANES + k] * change_x + wheel[9 * LANES + k] * change_y)
            lanes[4 * LANES + k] = wz + (wheel[10 * LANES + k] * change_x + wheel[11 * LANES + k] * change_y)
            changed = abs(change_x)
            changed = abs(change_y) if abs(change_y) > changed else changed
            largest = lanes[_LARGEST * LANES + k]
            lanes[_LARGEST * LANES + k] = changed if changed > largest else largest
