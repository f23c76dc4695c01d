"""Physics ticks of robots in compiled code: everything that is not PyBullet, and free motion without it.

A tick begins with a push: the drive sets the wheels, the ground acts on them. Then the body moves. Where no obstacle is
near it touches nothing, and `free_motion` moves it with the same bits as Bullet does. Otherwise Bullet moves it,
and the state follows; `way_back` has what it takes to bring the body there.
"""

import math
from typing import Any

from numba import njit

from barn_sim.body import free_motion as free
from barn_sim.body.drive import turn_wheels
from barn_sim.body.free_motion import (
    Quaternion,
    Triple,
    attitude_of,
    basis_of,
    fill,
    quaternion,
    triple,
    turned,
)
from barn_sim.body.friction import Motion, Rims, begin_friction, sweep_friction
from barn_sim.body.state import Record, Records
from barn_sim.body.tires import forces, offset_of_centre, place, stand
from barn_sim.contact.cylinders import nearest_gap
from barn_sim.sensors.odometry import integrate_wheels, read_odometry, renew_noise, wrap
from barn_worlds.base.arrays import Floats, Integers

Push = tuple[
    Triple, Triple, Triple, Triple
]  # pose of base_link, centre of mass (m), force (N), torque (N m)
State = tuple[
    Triple, Quaternion, Triple, Triple
]  # position, heading or attitude, velocity, spin

STILL, LEVEL = (0.0, 0.0, 0.0), (0.0, 0.0, 0.0, 1.0)
_MORE = 1.1
# Of kernels that neither make nor keep arrays: numba need not count references to them, a third of a tick's time.
BARE: dict[str, Any] = {"_nrt": False}


@njit(cache=True, **BARE)
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
    has begun: Bullet is to move the body under the push.
    """
    robot: Record = robots[index]
    fixed: Record = settings[0]
    for left in range(ticks, 0, -1):
        turn_wheels(robot, pending, index, fixed, robot.stamp_ns)
        pushed = push_on(robot, fixed)
        if not (
            clear_of_movers(robot, fixed)
            and end_if_clear(robot, fixed, segments, noise[index], pushed)
        ):
            return left, pushed
    return 0, (STILL, STILL, STILL, STILL)


@njit(cache=True)
def free_tick(
    robots: Records,
    settings: Records,
    index: int,
    segments: Floats,
    noise: Floats,
    pushed: Push,
) -> bool:
    """End a tick that has begun with a push without Bullet, if nothing is near; no mover is, as was just found."""
    robot: Record = robots[index]
    return robot.movers_clearance_m > 0.0 and end_if_clear(
        robot, settings[0], segments, noise[index], pushed
    )


@njit(cache=True, error_model="numpy", forceinline=True)
def end_if_clear(
    robot: Record, fixed: Record, segments: Floats, noise: Floats, pushed: Push
) -> bool:
    """End a tick that has begun with a push without Bullet, if no cylinder is near; tell whether."""
    if robot.in_bullet:
        return False
    covered = _covered(robot, fixed, pushed[2], pushed[3])
    # distances are computed only once the robot may have covered the last one
    if not _moved(robot, fixed, robot.looked_from) + covered < robot.clearance_m:
        fill(robot.looked_from, (robot.x, robot.y, robot.yaw))
        gap = nearest_gap(segments, robot.x, robot.y, robot.yaw, fixed.extent)
        robot.clearance_m = gap - robot.near_m
        if not covered < robot.clearance_m:
            return False
    _move(robot, fixed, pushed[2], pushed[3])
    _measure(robot, fixed, noise)
    return True


@njit(cache=True)
def follow(
    robots: Records, settings: Records, index: int, moved: State, noise: Floats
) -> Triple:
    """Take over what Bullet made of a tick, and end it; return x, y, yaw of base_link."""
    robot: Record = robots[index]
    fixed: Record = settings[0]
    position, attitude, velocity, spin = moved
    heading = turned(quaternion(robot.attitude), spin, fixed.tick_s)
    # Bullet does something else with a body that is deep within another, then its heading cannot be known
    robot.known = robot.known and attitude_of(basis_of(heading)) == attitude
    fill(robot.position, position)
    fill(robot.heading, heading)
    fill(robot.attitude, attitude)
    fill(robot.velocity, velocity)
    fill(robot.spin, spin)
    robot.away = 0
    _measure(robot, fixed, noise[index])
    return robot.x, robot.y, robot.yaw


@njit(cache=True)
def way_back(
    robots: Records, settings: Records, index: int, level: bool
) -> tuple[State, Triple, State]:
    """Return how to bring a body in Bullet, with all that Bullet stores of it, to where the robot has gone without it.

    level: whether Bullet has left it level and still in the tick before; else where the robot was then. Returns state
    of the body at the start of the last tick, which makes its inertia, the torque in it, and its state afterwards.
    """
    robot: Record = robots[index]
    fixed: Record = settings[0]
    heading, velocity, spin = (
        quaternion(robot.heading),
        triple(robot.velocity),
        triple(robot.spin),
    )
    before = quaternion(robot.heading_before)
    _, torque = free.still_turning(
        quaternion(robot.attitude_before), spin, heading, LEVEL if level else before, triple(fixed.inverse_inertia),
        fixed.tick_s,
    )  # fmt: skip
    start = triple(robot.position_before), before, velocity, spin
    return start, torque, (triple(robot.position), heading, velocity, spin)


@njit(cache=True)
def place_at_rest(robots: Records, settings: Records, index: int) -> None:
    """Complete the state of a robot at rest, of which position and heading are known."""
    robot: Record = robots[index]
    fill(robot.attitude, attitude_of(basis_of(quaternion(robot.heading))))
    robot.x, robot.y, robot.yaw = place(
        triple(robot.position), quaternion(robot.attitude), settings[0].centre
    )


@njit(cache=True)
def push_on(robot: Record, fixed: Record) -> Push:
    """Return how a tick begins for a record, of which the rim speeds are set."""
    motion, rims, carried = begin_push(robot, fixed)
    wheels = robot.wheels[: fixed.contacts]
    grip = wheels[: fixed.grips]
    sweep_friction(
        motion,
        rims,
        grip[:, 5:8],
        grip[:, 8],
        fixed.inverse_mass,
        grip[:, 3:5],
        grip[:, 9:],
    )
    force, torque = forces(carried, wheels, fixed.tick_s)
    return (robot.x, robot.y, robot.yaw), triple(robot.position), force, torque


@njit(cache=True, error_model="numpy", forceinline=True)
def begin_push(robot: Record, fixed: Record) -> tuple[Motion, Rims, Triple]:
    """Do as `push_on` up to the iteration for friction; return motion and rims for it, and what the loads do."""
    wheels = robot.wheels[: fixed.contacts]
    motion, turn, inverse, carried = stand(
        triple(robot.position),
        quaternion(robot.attitude),
        triple(robot.velocity),
        triple(robot.spin),
        wheels,
        fixed,
    )
    grip = wheels[: fixed.grips]
    motion, rims = begin_friction(
        motion, robot.left_m_s, robot.right_m_s, grip[:, 5:8], grip[:, 8], turn, inverse, fixed.inverse_mass,
        grip[:, 3:5], grip[:, 9:],
    )  # fmt: skip
    return motion, rims, carried


@njit(cache=True, error_model="numpy", forceinline=True)
def _move(robot: Record, fixed: Record, force: Triple, torque: Triple) -> None:
    """Move the body for a tick as Bullet does; see `barn_sim.body.free_motion`."""
    tick, inverse_mass = fixed.tick_s, fixed.inverse_mass
    heading, attitude, spin = (
        quaternion(robot.heading),
        quaternion(robot.attitude),
        triple(robot.spin),
    )
    inverse = triple(fixed.inverse_inertia)
    stored = inverse if robot.stamp_ns > 0 else triple(fixed.first_inverse_inertia)
    spin = free.spun(
        free.world_tensor(basis_of(heading), stored),
        attitude,
        spin,
        torque,
        inverse,
        tick,
    )
    fill(robot.position_before, triple(robot.position))
    fill(robot.heading_before, heading)
    fill(robot.attitude_before, attitude)
    for k in range(3):
        pull = force[k] - fixed.weight if k == 2 else force[k]
        robot.velocity[k] += pull * inverse_mass * tick
        robot.position[k] += robot.velocity[k] * tick
    heading = turned(attitude, spin, tick)
    fill(robot.spin, spin)
    fill(robot.heading, heading)
    fill(robot.attitude, attitude_of(basis_of(heading)))
    robot.away += 1


@njit(cache=True, error_model="numpy", forceinline=True)
def _measure(robot: Record, fixed: Record, noise: Floats) -> None:
    """End a tick: place the robot, turn its wheels, let its odometry know."""
    robot.x, robot.y, robot.yaw = place(
        triple(robot.position), quaternion(robot.attitude), fixed.centre
    )
    integrate_wheels(robot, fixed.tick_s)
    robot.left_rad += robot.left_m_s * fixed.per_metre
    robot.right_rad += robot.right_m_s * fixed.per_metre
    robot.stamp_ns += fixed.tick_ns
    if robot.stamp_ns % fixed.odometry_ns == 0:
        renew_noise(
            robot, fixed, noise[robot.stamp_ns // fixed.odometry_ns - robot.noise_from]
        )


@njit(cache=True, error_model="numpy", forceinline=True)
def _covered(robot: Record, fixed: Record, force: Triple, torque: Triple) -> float:
    """Return more than any point of the robot covers in a free tick that begins with this push."""
    tick, centre, inverse = fixed.tick_s, fixed.centre, fixed.inverse_inertia
    x = robot.velocity[0] + force[0] * fixed.inverse_mass * tick
    y = robot.velocity[1] + force[1] * fixed.inverse_mass * tick
    twist = (abs(torque[0]) + abs(torque[1])) * max(inverse[0], inverse[1]) + abs(
        torque[2]
    ) * inverse[2]
    spin = abs(robot.spin[0]) + abs(robot.spin[1]) + abs(robot.spin[2]) + twist * tick
    reach = fixed.reach_m + abs(centre[0]) + abs(centre[1]) + abs(centre[2])
    return float(_MORE * tick * (math.sqrt(x * x + y * y) + spin * reach))


@njit(cache=True)
def clear_of_movers(robot: Record, fixed: Record) -> bool:
    """Tell whether nothing that moves, nor a wall, can be near by what was seen of them last."""
    if robot.movers_clearance_m == math.inf:
        return True
    if robot.stamp_ns >= robot.movers_until_ns:
        return False
    passed = 1e-9 * (robot.stamp_ns - robot.movers_looked_ns)
    covered = (
        _moved(robot, fixed, robot.movers_looked_from) + robot.movers_speed_m_s * passed
    )
    return bool(covered < robot.movers_clearance_m)


@njit(cache=True)
def _moved(robot: Record, fixed: Record, pose: Floats) -> float:
    """Return how far any point of the robot may have gone since it was at a pose."""
    x, y = pose[0] - robot.x, pose[1] - robot.y
    return float(
        math.sqrt(x * x + y * y) + abs(wrap(robot.yaw - pose[2])) * fixed.reach_m
    )


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
        robot: Record = robots[index]
        x, y, yaw, speed, turn = read_odometry(robots, index)
        stamps_ns[index] = robot.stamp_ns
        fill(truths[index], (robot.x, robot.y, through_quaternion(robot.yaw)))
        fill(odometry[index], (x, y, through_quaternion(yaw)))
        velocities[index, 0], velocities[index, 1] = speed, turn


@njit(cache=True)
def through_quaternion(yaw: float) -> float:
    """Return a yaw as it comes out of a message, as `Pose2D.through_quaternion` does."""
    return wrap(2.0 * math.atan2(math.sin(0.5 * yaw), math.cos(0.5 * yaw)))


@njit(cache=True)
def motion_of(
    robots: Records, settings: Records, index: int
) -> tuple[float, float, float, float, float]:
    """Return x, y, yaw, forward speed and yaw rate of base_link."""
    robot: Record = robots[index]
    x, y, z = offset_of_centre(triple(settings[0].centre), quaternion(robot.attitude))
    velocity, spin = robot.velocity, robot.spin
    vx = velocity[0] - (spin[1] * z - spin[2] * y)
    vy = velocity[1] - (spin[2] * x - spin[0] * z)
    return (
        robot.x,
        robot.y,
        robot.yaw,
        vx * math.cos(robot.yaw) + vy * math.sin(robot.yaw),
        spin[2],
    )
