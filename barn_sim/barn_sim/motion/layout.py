"""Robots in lanes of vector instructions: rows of numbers, each for LANES robots, and how a robot comes in and out.

Rows lie one after the other in an array of one dimension, so that the compiler knows how far apart they are.
"""

import math

from numba import njit

from barn_sim.motion.free_motion import Matrix, Quaternion, Triple, fill, quaternion, triple
from barn_sim.motion.state import Record
from barn_worlds.base.arrays import Floats

LANES = 16
# Rows of a group of lanes. First what is kept from tick to tick,
POSITION, HEADING, ATTITUDE, VELOCITY, SPIN, POSE, RIMS = 0, 3, 7, 11, 14, 17, 20
POSITION_BEFORE, HEADING_BEFORE, ATTITUDE_BEFORE, LOOKED_FROM, CLEARANCE, FREE = 22, 25, 29, 33, 36, 37
# then what `begin` of `barn_sim.motion.lanes` finds,
MOTION, CARRIED, TURN, INVERSE, USUAL = 38, 43, 46, 55, 64
# what `act` finds: the push, whether nothing can be near, and how the body turns,
FORCE, TORQUE, CLEAR, SPIN_AFTER, RATE, HALF = 65, 68, 71, 72, 75, 76
# and what `move` needs and finds.
MOVES, SINE, COSINE, YAW_SINE, YAW_COSINE, ROWS = 77, 78, 79, 80, 81, 82
# Rows of each wheel: the impulse that was solved, and what `barn_sim.motion.abreast` needs to solve the next.
SOLVED, IMPULSE, ARM, LIMIT, LEVERS, STEP, SURE, RIM, WHEEL_ROWS = 0, 2, 4, 7, 8, 14, 15, 16, 18


@njit(cache=True, forceinline=True)
def three(rows: Floats, row: int, k: int) -> Triple:
    """Return three rows of a lane."""
    return rows[row * LANES + k], rows[(row + 1) * LANES + k], rows[(row + 2) * LANES + k]


@njit(cache=True, forceinline=True)
def four(rows: Floats, row: int, k: int) -> Quaternion:
    """Return four rows of a lane."""
    return (
        rows[row * LANES + k], rows[(row + 1) * LANES + k], rows[(row + 2) * LANES + k], rows[(row + 3) * LANES + k],
    )  # fmt: skip


@njit(cache=True, forceinline=True)
def put_three(rows: Floats, row: int, k: int, values: Triple) -> None:
    """Fill in three rows of a lane."""
    at = row * LANES + k
    rows[at], rows[at + LANES], rows[at + 2 * LANES] = values


@njit(cache=True, forceinline=True)
def put_four(rows: Floats, row: int, k: int, values: Quaternion) -> None:
    """Fill in four rows of a lane."""
    put_three(rows, row, k, values[:3])
    rows[(row + 3) * LANES + k] = values[3]


@njit(cache=True, forceinline=True)
def matrix(rows: Floats, row: int, k: int) -> Matrix:
    """Return nine rows of a lane."""
    return three(rows, row, k), three(rows, row + 3, k), three(rows, row + 6, k)


@njit(cache=True, forceinline=True)
def put_matrix(rows: Floats, row: int, k: int, values: Matrix) -> None:
    """Fill in nine rows of a lane."""
    put_three(rows, row, k, values[0])
    put_three(rows, row + 3, k, values[1])
    put_three(rows, row + 6, k, values[2])


@njit(cache=True, forceinline=True)
def replace_three(rows: Floats, row: int, k: int, values: Triple, replaced: bool) -> None:
    """Fill in three rows of a lane, or leave them as they are."""
    old = three(rows, row, k)
    put_three(
        rows, row, k,
        (values[0] if replaced else old[0], values[1] if replaced else old[1], values[2] if replaced else old[2]),
    )  # fmt: skip


@njit(cache=True, forceinline=True)
def replace_four(rows: Floats, row: int, k: int, values: Quaternion, replaced: bool) -> None:
    """Fill in four rows of a lane, or leave them as they are."""
    replace_three(rows, row, k, values[:3], replaced)
    at = (row + 3) * LANES + k
    rows[at] = values[3] if replaced else rows[at]


@njit(cache=True)
def load(robot: Record, rows: Floats, wheels: Floats, k: int, contacts: int) -> None:
    """Take a robot up into a lane."""
    put_three(rows, POSITION, k, triple(robot.position))
    put_four(rows, HEADING, k, quaternion(robot.heading))
    put_four(rows, ATTITUDE, k, quaternion(robot.attitude))
    put_three(rows, VELOCITY, k, triple(robot.velocity))
    put_three(rows, SPIN, k, triple(robot.spin))
    put_three(rows, POSE, k, (robot.x, robot.y, robot.yaw))
    put_three(rows, POSITION_BEFORE, k, triple(robot.position_before))
    put_four(rows, HEADING_BEFORE, k, quaternion(robot.heading_before))
    put_four(rows, ATTITUDE_BEFORE, k, quaternion(robot.attitude_before))
    put_three(rows, LOOKED_FROM, k, triple(robot.looked_from))
    rows[CLEARANCE * LANES + k] = robot.clearance_m
    free = robot.stamp_ns > 0 and not robot.in_bullet and robot.movers_clearance_m == math.inf
    rows[FREE * LANES + k] = 1.0 if free else 0.0
    for i in range(contacts):
        at = (i * WHEEL_ROWS + SOLVED) * LANES + k
        wheels[at], wheels[at + LANES] = robot.wheels[i, 3], robot.wheels[i, 4]


@njit(cache=True)
def store(robot: Record, rows: Floats, wheels: Floats, k: int, contacts: int) -> None:
    """Write back what has changed of a robot in a lane, but for where base_link is."""
    fill(robot.position, three(rows, POSITION, k))
    fill(robot.heading, four(rows, HEADING, k))
    fill(robot.attitude, four(rows, ATTITUDE, k))
    fill(robot.velocity, three(rows, VELOCITY, k))
    fill(robot.spin, three(rows, SPIN, k))
    fill(robot.position_before, three(rows, POSITION_BEFORE, k))
    fill(robot.heading_before, four(rows, HEADING_BEFORE, k))
    fill(robot.attitude_before, four(rows, ATTITUDE_BEFORE, k))
    for i in range(contacts):
        at = (i * WHEEL_ROWS + SOLVED) * LANES + k
        robot.wheels[i, 3], robot.wheels[i, 4] = wheels[at], wheels[at + LANES]
