"""Physics ticks of robots in compiled code: everything that is not PyBullet, and free motion without it.

A tick begins with a push: the drive sets the wheels, the ground acts on them. Then the body moves. Where no obstacle is
near it touches nothing, and `barn_sim.motion` moves it with the same bits as Bullet does. Otherwise Bullet moves it,
and the state follows.
"""

import math
from typing import Any

from numba import njit

from barn_sim.drive import add_command, turn_wheels
from barn_sim.estimates import integrate_wheels, observed_odometry, renew_noise, wrap
from barn_sim.motion import Matrix, Quaternion, Triple, attitude_of, basis_of, spun, still_turning, turned, world_tensor
from barn_sim.nearness import nearest_gap
from barn_sim.state import Records
from barn_sim.steered import front_angles
from barn_sim.tyres import act_on_body, offset_of_centre, place
from barn_worlds.arrays import Floats, Integers

Push = tuple[Triple, Triple, Triple, Triple]
Placed = tuple[Triple, Quaternion, Triple, Triple]
Bounds = tuple[float, float, float, float]

STILL = 0.0, 0.0, 0.0
_CONTACT_M = 0.02  # by which Bullet enlarges the bounds of a body
_MARGIN_M = 0.05  # by which it enlarges them once more for a new box


@njit(cache=True)
def advance(
    robots: Records,
    pending: Floats,
    settings: Records,
    index: int,
    segments: Floats,
    noise: Floats,
    ticks: int,
) -> tuple[int, Push]:
    """Advance a robot by so many ticks, as long as it is free; return the ticks left and how the next one begins.

    segments (m, 4): axes of the cylinders seen from above. noise (n, k, 2): see `Fleet`. If ticks are left, the first
    has begun: Bullet is to move the body under the push: pose of base_link, centre of mass (m), force (N), torque.
    """
    robot: Any = robots[index]
    fixed: Any = settings[0]
    for left in range(ticks, 0, -1):
        turn_wheels(robot, pending[index], fixed, robot.stamp_ns)
        pushed = _push(robot, fixed)
        if robot.in_bullet or not clear_of_movers(robot, fixed) or not _clear(robot, fixed, segments):
            return left, pushed
        _move(robot, fixed, pushed[2], pushed[3])
        _measure(robot, fixed, noise[index])
    return 0, (STILL, STILL, STILL, STILL)


@njit(cache=True)
def free_tick(
    robots: Records, settings: Records, index: int, segments: Floats, noise: Floats, force: Triple, torque: Triple
) -> bool:
    """End a tick that has begun without Bullet, if no cylinder is near and no mover, as was just found; tell whether.

    force (N), torque (N m): of the push.
    """
    robot: Any = robots[index]
    fixed: Any = settings[0]
    if robot.in_bullet or robot.movers_clearance_m <= 0.0 or not _clear(robot, fixed, segments):
        return False
    _move(robot, fixed, force, torque)
    _measure(robot, fixed, noise[index])
    return True


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
    """Do as `advance` for the robots `indices`; fill in ticks left (n,) and pushes (n, 4, 3).

    commands (n, 2): given now, there must be room for them. segments (n, m, 4): those of each robot's world, the first
    `cylinders` (n,) of a row.
    """
    for index in indices:
        arrival_ns = robots[index].stamp_ns + latency_ns
        add_command(robots, pending, index, arrival_ns, commands[index, 0], commands[index, 1])
        near = segments[index, : cylinders[index]]
        left[index], push = advance(robots, pending, settings, index, near, noise, ticks)
        for k in range(4):
            _set(pushes[index, k], push[k])


@njit(cache=True)
def read_all(
    robots: Records,
    indices: Integers,
    stamps_ns: Integers,
    truths: Floats,
    odometry: Floats,
    velocities: Floats,
) -> None:
    """Fill the rows `indices` of stamps (n,), true and measured poses (n, 3) and measured velocities (n, 2)."""
    for index in indices:
        robot: Any = robots[index]
        x, y, yaw, speed, turn = observed_odometry(robot, robot.yaw, robot.spin[2])
        stamps_ns[index] = robot.stamp_ns
        _set(truths[index], (robot.x, robot.y, through_quaternion(robot.yaw)))
        _set(odometry[index], (x, y, through_quaternion(yaw)))
        velocities[index, 0], velocities[index, 1] = speed, turn


@njit(cache=True)
def through_quaternion(yaw: float) -> float:
    """Return a yaw as it comes out of a message, as `Pose2D.through_quaternion` does."""
    return wrap(2.0 * math.atan2(math.sin(0.5 * yaw), math.cos(0.5 * yaw)))


@njit(cache=True)
def follow(
    robots: Records,
    settings: Records,
    index: int,
    position: Triple,
    attitude: Quaternion,
    velocity: Triple,
    spin: Triple,
    noise: Floats,
) -> Triple:
    """Take over what Bullet made of a tick, and end it; return x, y, yaw of base_link."""
    robot: Any = robots[index]
    fixed: Any = settings[0]
    _box(robot, fixed)
    heading = turned(_quaternion(robot.attitude), spin, fixed.tick_s)
    # Bullet does something else with a body that is deep within another, then its heading cannot be known
    robot.known = robot.known and attitude_of(basis_of(heading)) == attitude
    _set(robot.position, position)
    _set(robot.heading, heading)
    _set(robot.attitude, attitude)
    _set(robot.velocity, velocity)
    _set(robot.spin, spin)
    _set(robot.heading_left, heading)
    robot.away, robot.begun = 0, True
    _measure(robot, fixed, noise[index])
    return robot.x, robot.y, robot.yaw


@njit(cache=True)
def push(robots: Records, settings: Records, index: int, left_m_s: float, right_m_s: float) -> Push:
    """Set the rim speeds of a robot; return how a tick begins."""
    robot: Any = robots[index]
    robot.left_m_s, robot.right_m_s = left_m_s, right_m_s
    return _push(robot, settings[0])


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
    inverse, tick = _triple(fixed.inverse_inertia), fixed.tick_s
    heading, velocity, spin = _quaternion(robot.heading), _triple(robot.velocity), _triple(robot.spin)
    box = (
        _triple(robot.boxed_position), _quaternion(robot.boxed_heading), _triple(robot.boxed_velocity),
        _triple(robot.boxed_spin),
    )  # fmt: skip
    # headings on the way, since each leaves its inertia
    attitude = attitude_of(basis_of(box[1]))
    left = world_tensor(basis_of(_quaternion(robot.heading_left)), inverse)
    on_the_way = turned(attitude, spun(left, attitude, box[3], STILL, inverse, tick), tick)
    for _ in range(between):
        on_the_way = turned(attitude_of(basis_of(on_the_way)), STILL, tick)
    _, torque = still_turning(_quaternion(robot.attitude_before), spin, heading, on_the_way, inverse, tick)
    start = _triple(robot.position_before), _quaternion(robot.heading_before), velocity, spin
    return robot.away, box, start, torque, (_triple(robot.position), heading, velocity, spin)


@njit(cache=True)
def box_now(robots: Records, settings: Records, index: int) -> tuple[int, bool]:
    """Return the ticks since the box of a robot was made, and whether the next tick makes a new one."""
    robot: Any = robots[index]
    return robot.boxed, not _inside(_needed(robot, settings[0]), robot.box)


@njit(cache=True)
def place_at_rest(robots: Records, settings: Records, index: int) -> None:
    """Complete the state of a robot at rest, of which position and heading are known."""
    robot: Any = robots[index]
    _set(robot.attitude, attitude_of(basis_of(_quaternion(robot.heading))))
    _place(robot, settings[0])


@njit(cache=True)
def motion(robots: Records, settings: Records, index: int) -> tuple[float, float, float, float, float]:
    """Return x, y, yaw, forward speed and yaw rate of base_link."""
    robot: Any = robots[index]
    return robot.x, robot.y, robot.yaw, forward_speed(robot, settings[0]), robot.spin[2]


@njit(cache=True)
def wheels(robots: Records, index: int) -> tuple[float, float, float, float]:
    """Return angles (rad) and rim speeds (m/s) of the wheels: left, right, left, right."""
    robot: Any = robots[index]
    return robot.left_rad, robot.right_rad, robot.left_m_s, robot.right_m_s


@njit(cache=True)
def front_wheels(robots: Records, settings: Records, index: int) -> tuple[float, float, float, float, float, float]:
    """Return of the front wheels of a car, left and right: angles (rad), rim speeds (m/s) and steering angles (rad)."""
    robot: Any = robots[index]
    speeds, angles = _front_speeds(robot, settings[0]), _front_angles(robot, settings[0])
    return robot.front_left_rad, robot.front_right_rad, speeds[0], speeds[1], angles[0], angles[1]


@njit(cache=True)
def forward_speed(robot: Any, fixed: Any) -> float:
    """Return the forward speed of base_link."""
    x, y, z = offset_of_centre(fixed.centre, _quaternion(robot.attitude))
    velocity, spin = robot.velocity, robot.spin
    vx = velocity[0] - (spin[1] * z - spin[2] * y)
    vy = velocity[1] - (spin[2] * x - spin[0] * z)
    speed: float = vx * math.cos(robot.yaw) + vy * math.sin(robot.yaw)
    return speed


@njit(cache=True)
def _push(robot: Any, fixed: Any) -> Push:
    position = _triple(robot.position)
    steered = fixed.wheelbase_m > 0.0
    angles = _front_angles(robot, fixed) if steered else (0.0, 0.0)
    force, torque = act_on_body(
        position, _quaternion(robot.attitude), _triple(robot.velocity), _triple(robot.spin),
        robot.left_m_s, robot.right_m_s, robot.wheels[: fixed.contacts], fixed.ground, fixed.grips, angles, steered,
    )  # fmt: skip
    return (robot.x, robot.y, robot.yaw), position, force, torque


@njit(cache=True)
def _front_angles(robot: Any, fixed: Any) -> tuple[float, float]:
    return front_angles(robot.steering_rad, fixed.wheelbase_m, fixed.half_separation_m)


@njit(cache=True)
def _front_speeds(robot: Any, fixed: Any) -> tuple[float, float]:
    """Return the rim speeds of the front wheels of a car."""
    left, right = _front_angles(robot, fixed)
    aside = math.tan(robot.steering_rad) * robot.axle_m_s  # of the front axle
    return (
        robot.left_m_s * math.cos(left) + aside * math.sin(left),
        robot.right_m_s * math.cos(right) + aside * math.sin(right),
    )


@njit(cache=True)
def _place(robot: Any, fixed: Any) -> None:
    robot.x, robot.y, robot.yaw = place(_triple(robot.position), _quaternion(robot.attitude), fixed.centre)


@njit(cache=True)
def _move(robot: Any, fixed: Any, force: Triple, torque: Triple) -> None:
    """Move the body for a tick as Bullet does; see `barn_sim.motion`."""
    _box(robot, fixed)
    tick, inverse_mass = fixed.tick_s, fixed.inverse_mass
    heading, attitude, spin = _quaternion(robot.heading), _quaternion(robot.attitude), _triple(robot.spin)
    inverse = _triple(fixed.inverse_inertia)
    stored = inverse if robot.begun else _triple(fixed.first_inverse_inertia)
    spin = spun(world_tensor(basis_of(heading), stored), attitude, spin, torque, inverse, tick)
    if not robot.begun:
        _set(robot.first_push[0], _triple(robot.position))
        _set(robot.first_push[1], force)
        _set(robot.first_push[2], torque)
    _set(robot.position_before, _triple(robot.position))
    _set(robot.heading_before, heading)
    _set(robot.attitude_before, attitude)
    for k in range(3):
        pull = force[k] - fixed.weight if k == 2 else force[k]
        robot.velocity[k] += pull * inverse_mass * tick
        robot.position[k] += robot.velocity[k] * tick
    heading = turned(attitude, spin, tick)
    _set(robot.spin, spin)
    _set(robot.heading, heading)
    _set(robot.attitude, attitude_of(basis_of(heading)))
    if robot.begun:
        robot.away += 1
        return
    robot.begun = True  # Bullet will repeat this tick, if it ever has to move the body
    _set(robot.heading_left, heading)


@njit(cache=True)
def _box(robot: Any, fixed: Any) -> None:
    """Follow the box that Bullet keeps, at the beginning of a tick (btDbvtBroadphase::setAabb)."""
    needed = _needed(robot, fixed)
    robot.boxed += 1
    if _inside(needed, robot.box):
        return
    low_x, low_y, high_x, high_y = needed
    _set(robot.box, (low_x - _MARGIN_M, low_y - _MARGIN_M, high_x + _MARGIN_M, high_y + _MARGIN_M))
    robot.boxed = 1
    _set(robot.boxed_position, _triple(robot.position))
    _set(robot.boxed_heading, _quaternion(robot.heading))
    _set(robot.boxed_velocity, _triple(robot.velocity))
    _set(robot.boxed_spin, _triple(robot.spin))


@njit(cache=True)
def _needed(robot: Any, fixed: Any) -> Bounds:
    """Return the bounds of the body now and a tick later at its present velocity, as Bullet enlarges them."""
    position, velocity, tick = _triple(robot.position), _triple(robot.velocity), fixed.tick_s
    there = position[0] + velocity[0] * tick, position[1] + velocity[1] * tick, position[2]
    heading = turned(_quaternion(robot.attitude), _triple(robot.spin), tick)
    now = _bounds(position, basis_of(_quaternion(robot.heading)), fixed.bounds)
    then = _bounds(there, basis_of(heading), fixed.bounds)
    low_x, low_y = min(now[0], then[0]) - _CONTACT_M, min(now[1], then[1]) - _CONTACT_M
    return low_x, low_y, max(now[2], then[2]) + _CONTACT_M, max(now[3], then[3]) + _CONTACT_M


@njit(cache=True)
def _inside(bounds: Bounds, box: Floats) -> bool:
    return bool(box[0] <= bounds[0] and box[1] <= bounds[1] and bounds[2] <= box[2] and bounds[3] <= box[3])


@njit(cache=True)
def _bounds(position: Triple, basis: Matrix, bounds: Floats) -> Bounds:
    """Return x_min, y_min, x_max, y_max of a box of corners `bounds` (2, 3) in the frame of a body."""
    x, y, half_x, half_y = position[0], position[1], 0.0, 0.0
    for k in range(3):
        middle, half = 0.5 * (bounds[0, k] + bounds[1, k]), 0.5 * (bounds[1, k] - bounds[0, k])
        x += basis[0][k] * middle
        y += basis[1][k] * middle
        half_x += abs(basis[0][k]) * half
        half_y += abs(basis[1][k]) * half
    return x - half_x, y - half_y, x + half_x, y + half_y


@njit(cache=True)
def _measure(robot: Any, fixed: Any, noise: Floats) -> None:
    """End a tick: place the robot, turn its wheels, let its odometry know."""
    _place(robot, fixed)
    integrate_wheels(robot, fixed.tick_s, robot.left_m_s, robot.right_m_s, robot.yaw)
    robot.left_rad += robot.left_m_s * fixed.per_metre
    robot.right_rad += robot.right_m_s * fixed.per_metre
    if fixed.wheelbase_m > 0.0:
        left, right = _front_speeds(robot, fixed)
        robot.front_left_rad += left * fixed.per_metre
        robot.front_right_rad += right * fixed.per_metre
    robot.stamp_ns += fixed.tick_ns
    if robot.stamp_ns % fixed.odometry_ns == 0:
        renew_noise(robot, fixed, noise[robot.stamp_ns // fixed.odometry_ns - robot.noise_from])


@njit(cache=True)
def _clear(robot: Any, fixed: Any, segments: Floats) -> bool:
    """Tell whether no cylinder is near; distances are computed only once the robot may have covered the last one."""
    extent = fixed.extent
    if _moved(robot, extent, robot.looked_from) < robot.clearance_m:
        return True
    robot.looked_from[0], robot.looked_from[1], robot.looked_from[2] = robot.x, robot.y, robot.yaw
    robot.clearance_m = nearest_gap(segments, robot.x, robot.y, robot.yaw, extent) - robot.near_m
    return bool(robot.clearance_m > 0.0)


@njit(cache=True)
def clear_of_movers(robot: Any, fixed: Any) -> bool:
    """Tell whether nothing that moves, nor a wall, can be near by what was seen of them last."""
    if robot.movers_clearance_m == math.inf:
        return True
    if robot.stamp_ns >= robot.movers_until_ns:
        return False
    passed = 1e-9 * (robot.stamp_ns - robot.movers_looked_ns)
    covered = _moved(robot, fixed.extent, robot.movers_looked_from) + robot.movers_speed_m_s * passed
    return bool(covered < robot.movers_clearance_m)


@njit(cache=True)
def _moved(robot: Any, extent: Floats, pose: Floats) -> float:
    """Return how far any point of the robot may have gone since it was at a pose."""
    turn = abs(wrap(robot.yaw - pose[2]))
    moved = math.hypot(pose[0] - robot.x, pose[1] - robot.y)
    reach = math.hypot(max(abs(extent[0]), abs(extent[2])), max(abs(extent[1]), abs(extent[3])))
    return moved + turn * reach


@njit(cache=True)
def _triple(values: Floats) -> Triple:
    return values[0], values[1], values[2]


@njit(cache=True)
def _quaternion(values: Floats) -> Quaternion:
    return values[0], values[1], values[2], values[3]


@njit(cache=True)
def _set(values: Floats, given: tuple[float, ...]) -> None:
    for k in range(len(values)):
        values[k] = given[k]
