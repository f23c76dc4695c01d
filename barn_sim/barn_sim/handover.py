"""What Bullet stores of a body that `barn_sim.ticks` moves without it, and how the body comes back to Bullet.

Bullet keeps a box around each body, enlarged, and makes a new one when the body leaves it.
"""

from typing import Any

from numba import njit

from barn_sim.motion import (
    Matrix,
    Quaternion,
    Triple,
    attitude_of,
    basis_of,
    fill,
    quaternion,
    spun,
    still_turning,
    triple,
    turned,
    world_tensor,
)
from barn_sim.state import Records

Placed = tuple[Triple, Quaternion, Triple, Triple]
Bounds = tuple[float, float, float, float]
Shape = tuple[Triple, Triple]

_STILL = 0.0, 0.0, 0.0
_CONTACT_M = 0.02  # by which Bullet enlarges the bounds of a body
_MARGIN_M = 0.05  # by which it enlarges them once more for a new box
_ROUNDING_M = 1e-9  # more than sums in this module are rounded by


@njit(cache=True)
def come_back(
    robots: Records, settings: Records, index: int, between: int
) -> tuple[int, Placed, Placed, Triple, Placed]:
    """Return how to bring a body in Bullet, with all that Bullet stores of it, to where the robot has gone without it.

    between: ticks at rest after that in which its box was made. Returns the ticks since Bullet moved the body;
    where the body starts that tick; where it starts the last tick, which makes its inertia, and
    the torque in it; and where it then has to be. Places are position, heading, velocity and spin.
    """
    robot: Any = robots[index]
    fixed: Any = settings[0]
    inverse, tick = triple(fixed.inverse_inertia), fixed.tick_s
    heading, velocity, spin = quaternion(robot.heading), triple(robot.velocity), triple(robot.spin)
    box = (
        triple(robot.boxed_position), quaternion(robot.boxed_heading), triple(robot.boxed_velocity),
        triple(robot.boxed_spin),
    )  # fmt: skip
    # headings on the way, since each leaves its inertia
    attitude = attitude_of(basis_of(box[1]))
    left = world_tensor(basis_of(quaternion(robot.heading_left)), inverse)
    on_the_way = turned(attitude, spun(left, attitude, box[3], _STILL, inverse, tick), tick)
    for _ in range(between):
        on_the_way = turned(attitude_of(basis_of(on_the_way)), _STILL, tick)
    _, torque = still_turning(quaternion(robot.attitude_before), spin, heading, on_the_way, inverse, tick)
    start = triple(robot.position_before), quaternion(robot.heading_before), velocity, spin
    return robot.away, box, start, torque, (triple(robot.position), heading, velocity, spin)


@njit(cache=True)
def box_now(robots: Records, settings: Records, index: int) -> tuple[int, bool]:
    """Return the ticks since the box of a robot was made, and whether the next tick makes a new one."""
    robot: Any = robots[index]
    return robot.boxed, not _inside(_needed(robot, settings[0]), quaternion(robot.box))


@njit(cache=True)
def keep_box(robot: Any, fixed: Any) -> None:
    """Follow the box that Bullet keeps, at the beginning of a tick (btDbvtBroadphase::setAabb)."""
    position, velocity, spin = triple(robot.position), triple(robot.velocity), triple(robot.spin)
    box, basis = quaternion(robot.box), basis_of(quaternion(robot.heading))
    robot.boxed += 1
    if surely_inside(position, basis, velocity, spin, fixed.tick_s, shape_of(fixed), box):
        return
    needed = _needed(robot, fixed)
    if _inside(needed, box):
        return
    low_x, low_y, high_x, high_y = needed
    fill(robot.box, (low_x - _MARGIN_M, low_y - _MARGIN_M, high_x + _MARGIN_M, high_y + _MARGIN_M))
    robot.boxed = 1
    fill(robot.boxed_position, position)
    fill(robot.boxed_heading, quaternion(robot.heading))
    fill(robot.boxed_velocity, velocity)
    fill(robot.boxed_spin, spin)


@njit(cache=True, error_model="numpy")
def surely_inside(
    position: Triple, basis: Matrix, velocity: Triple, spin: Triple, tick: float, shape: Shape, box: Bounds
) -> bool:
    """Tell whether a body need not leave its box, however it turns at its spin; false where that takes a closer look.

    shape: as `shape_of` returns it.
    """
    middle, half = shape
    reach = abs(middle[0]) + abs(middle[1]) + abs(middle[2]) + half[0] + half[1] + half[2]
    more = _CONTACT_M + _ROUNDING_M + (abs(spin[0]) + abs(spin[1]) + abs(spin[2])) * tick * reach
    x, y = velocity[0] * tick, velocity[1] * tick
    low_x, low_y, high_x, high_y = _bounds(position, basis, shape)
    left, below = box[0] <= min(low_x, low_x + x) - more, box[1] <= min(low_y, low_y + y) - more
    return left & below & (max(high_x, high_x + x) + more <= box[2]) & (max(high_y, high_y + y) + more <= box[3])


@njit(cache=True)
def shape_of(fixed: Any) -> Shape:
    """Return the middle of the bounds of a body, in its own frame, and half of how far they extend."""
    low, high = triple(fixed.bounds[0]), triple(fixed.bounds[1])
    return (
        (0.5 * (low[0] + high[0]), 0.5 * (low[1] + high[1]), 0.5 * (low[2] + high[2])),
        (0.5 * (high[0] - low[0]), 0.5 * (high[1] - low[1]), 0.5 * (high[2] - low[2])),
    )


@njit(cache=True)
def _needed(robot: Any, fixed: Any) -> Bounds:
    """Return the bounds of the body now and a tick later at its present velocity, as Bullet enlarges them."""
    position, velocity, tick = triple(robot.position), triple(robot.velocity), fixed.tick_s
    there = position[0] + velocity[0] * tick, position[1] + velocity[1] * tick, position[2]
    heading = turned(quaternion(robot.attitude), triple(robot.spin), tick)
    now = _bounds(position, basis_of(quaternion(robot.heading)), shape_of(fixed))
    then = _bounds(there, basis_of(heading), shape_of(fixed))
    low_x, low_y = min(now[0], then[0]) - _CONTACT_M, min(now[1], then[1]) - _CONTACT_M
    return low_x, low_y, max(now[2], then[2]) + _CONTACT_M, max(now[3], then[3]) + _CONTACT_M


@njit(cache=True)
def _inside(bounds: Bounds, box: Bounds) -> bool:
    return bool(box[0] <= bounds[0] and box[1] <= bounds[1] and bounds[2] <= box[2] and bounds[3] <= box[3])


@njit(cache=True, error_model="numpy")
def _bounds(position: Triple, basis: Matrix, shape: Shape) -> Bounds:
    """Return x_min, y_min, x_max, y_max of a box about the axes of a body."""
    (across, along, _), (middle, half) = basis, shape
    x = position[0] + across[0] * middle[0] + across[1] * middle[1] + across[2] * middle[2]
    y = position[1] + along[0] * middle[0] + along[1] * middle[1] + along[2] * middle[2]
    half_x = abs(across[0]) * half[0] + abs(across[1]) * half[1] + abs(across[2]) * half[2]
    half_y = abs(along[0]) * half[0] + abs(along[1]) * half[1] + abs(along[2]) * half[2]
    return x - half_x, y - half_y, x + half_x, y + half_y
