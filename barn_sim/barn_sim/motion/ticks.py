"""Physics ticks of robots in compiled code.

A tick has two halves. First the drive turns the wheels and the ground acts on the
tires. Then the body moves: as a free body (`barn_sim.body.rigid_body`) where no
obstacle is near, else in PyBullet, under the same forces.
"""

import math
from typing import Any

from numba import njit

from barn_sim.body.drive import turn_wheels
from barn_sim.body.friction import SWEEPS, Motion, sweep_friction
from barn_sim.body.rigid_body import begin_tires, move_body, place_base, tire_forces
from barn_sim.body.state import Fleet, Record, Records
from barn_sim.body.vectors import (
    BodyState,
    Vector,
    cross,
    fill,
    quaternion,
    rotation,
    transform,
    vector,
)
from barn_sim.contact.cylinders import nearest_gap
from barn_sim.sensors.odometry import integrate_wheels, read_odometry, renew_noise, wrap
from barn_worlds.base.arrays import Floats, Integers, inline_kernel, kernel

# For kernels that neither create nor store arrays: numba need not count references to
# them, which takes a third of a tick.
NO_REFERENCES: dict[str, Any] = {"_nrt": False}


@njit(cache=True, **NO_REFERENCES)
def advance(fleet: Fleet, index: int, segments: Floats, ticks: int) -> int:
    """Advance a free robot until an obstacle is near; return how many ticks are left.

    Args:
        fleet: Robots of which one advances.
        index: Row of the robot.
        segments: Axes (m, 4) of the cylinders in its world, seen from above, m.
        ticks: Largest number of ticks.

    Returns:
        The number of ticks that are left; the next one needs PyBullet, or a look at the
        moving obstacles.
    """
    robot: Record = fleet.robots[index]
    fixed: Record = fleet.settings[0]
    for left in range(ticks, 0, -1):
        if not is_free(robot, fixed, segments):
            return left
        turn_wheels(robot, fleet.pending[index], fixed)
        move_body(robot, fixed, solve_tires(robot, fixed))
        finish_tick(robot, fixed, fleet.noise[index])
    return 0


@kernel
def push_body(fleet: Fleet, index: int) -> tuple[Vector, Vector, Vector, Vector]:
    """Turn wheels and solve friction; return pose, center, force, torque for PyBullet.

    Args:
        fleet: Robots with their commands.
        index: Row of the robot.

    Returns:
        x, y (m) and yaw (rad) of base_link, position of the center of mass (m), force
        there (N) and torque (N m).
    """
    robot: Record = fleet.robots[index]
    fixed: Record = fleet.settings[0]
    turn_wheels(robot, fleet.pending[index], fixed)
    solve_tires(robot, fixed)
    force, torque = tire_forces(robot, fixed)
    return (robot.x, robot.y, robot.yaw), vector(robot.position), force, torque


@kernel
def follow_body(
    fleet: Fleet, index: int, state: BodyState
) -> tuple[float, float, float]:
    """Complete a tick with the body's state in PyBullet; return pose of base_link.

    Args:
        fleet: Robots with the noise of their odometry.
        index: Row of the robot.
        state: Position, attitude, velocity and spin after the tick.

    Returns:
        x, y (m) and yaw (rad) of base_link.
    """
    robot: Record = fleet.robots[index]
    position, attitude, velocity, spin = state
    fill(robot.position, position)
    fill(robot.attitude, attitude)
    fill(robot.velocity, velocity)
    fill(robot.spin, spin)
    finish_tick(robot, fleet.settings[0], fleet.noise[index])
    return robot.x, robot.y, robot.yaw


@kernel
def body_state(robots: Records, index: int) -> BodyState:
    """Return position, quaternion, velocity and spin of a robot's center of mass.

    Args:
        robots: Records (n,) of robots.
        index: Row of the robot.
    """
    robot: Record = robots[index]
    return (
        vector(robot.position),
        quaternion(robot.attitude),
        vector(robot.velocity),
        vector(robot.spin),
    )


@kernel
def solve_tires(robot: Record, fixed: Record) -> Motion:
    """Solve the wheels' friction in place; return the body's motion, do not apply it.

    Args:
        robot: Record of the robot.
        fixed: Record of the settings.

    Returns:
        Velocity along x and y and spin under the forces of the ground.
    """
    # Impulses of the last tick are the first guess: a robot that drives steadily
    # converges within a few sweeps.
    motion, rims = begin_tires(robot, fixed)
    wheels = robot.wheels[: fixed.grips]
    return sweep_friction(motion, rims, wheels, fixed.inverse_mass, SWEEPS)


@inline_kernel
def finish_tick(robot: Record, fixed: Record, noise: Floats) -> None:
    """Update base_link, odometry, wheel angles and time after the body has moved.

    Args:
        robot: Record of the robot, whose body has moved.
        fixed: Record of the settings.
        noise: Noise of the odometry's next updates (k, 2).
    """
    # The order is that of cause and effect: odometry reads the new pose, and the noise
    # of an update belongs to the time after the tick.
    place_base(robot, fixed)
    integrate_wheels(robot, fixed.tick_s)
    # Rim speed over radius is the rate at which a wheel turns.
    turn_per_speed = fixed.tick_s / fixed.wheel_radius_m
    robot.left_rad += robot.left_m_s * turn_per_speed
    robot.right_rad += robot.right_m_s * turn_per_speed
    robot.stamp_ns += fixed.tick_ns
    # An update draws its noise whether or not anybody reads it, so that how often
    # somebody reads changes nothing.
    if robot.stamp_ns % fixed.odometry_ns == 0:
        update = robot.stamp_ns // fixed.odometry_ns
        renew_noise(robot, fixed, noise[update - robot.noise_from])


@inline_kernel
def is_free(robot: Record, fixed: Record, segments: Floats) -> bool:
    """Tell whether no obstacle can be touched in the next tick; False in a contact.

    Args:
        robot: Record of the robot.
        fixed: Record of the settings.
        segments: Axes (m, 4) of the cylinders in its world, seen from above, m.
    """
    # The cheapest tests come first: distances to cylinders take the longest.
    if robot.in_contact or not _is_clear_of_movers(robot, fixed):
        return False
    return _is_clear(robot, fixed, segments)


@inline_kernel
def _is_clear(robot: Record, fixed: Record, segments: Floats) -> bool:
    """Tell whether no cylinder is near; measures only if the last gap is used up."""
    # No point of the robot can have come nearer than it has moved since the last look.
    if _distance_from(robot, fixed, robot.looked_from) < robot.clearance_m:
        return True
    fill(robot.looked_from, (robot.x, robot.y, robot.yaw))
    gap = nearest_gap(segments, robot.x, robot.y, robot.yaw, fixed.extent)
    robot.clearance_m = gap - robot.near_m
    return bool(robot.clearance_m > 0.0)


@kernel
def _is_clear_of_movers(robot: Record, fixed: Record) -> bool:
    """Tell whether no wall or mover can be near by the last look at them."""
    if robot.movers_clearance_m == math.inf:
        return True
    if robot.stamp_ns >= robot.movers_until_ns:
        return False
    # Both sides may have closed in: the robot by its own motion, a mover at its top
    # speed.
    elapsed_s = 1e-9 * (robot.stamp_ns - robot.movers_looked_ns)
    distance = _distance_from(robot, fixed, robot.movers_looked_from)
    approach = distance + robot.movers_speed_m_s * elapsed_s
    return bool(approach < robot.movers_clearance_m)


@kernel
def _distance_from(robot: Record, fixed: Record, pose: Floats) -> float:
    """Return how far (m) any point of the robot may have gone since a pose."""
    dx = pose[0] - robot.x
    dy = pose[1] - robot.y
    turn = abs(wrap(robot.yaw - pose[2]))
    # A turn moves the farthest corner by at most angle times its distance from
    # base_link.
    return float(math.sqrt(dx * dx + dy * dy) + turn * fixed.reach_m)


@kernel
def read_all(
    robots: Records,
    indices: Integers,
    stamps_ns: Integers,
    truths: Floats,
    odometry: Floats,
    velocities: Floats,
) -> None:
    """Write time, true pose, odometry and velocity of robots `indices` to the arrays.

    Args:
        robots: Records (n,) of robots.
        indices: Rows to read.
        stamps_ns: Filled in (n,): times since the start.
        truths: Filled in (n, 3): true poses of base_link, m and rad.
        odometry: Filled in (n, 3): poses in the odom frame, m and rad.
        velocities: Filled in (n, 2): forward speed and yaw rate of the odometry.
    """
    for index in indices:
        robot: Record = robots[index]
        x, y, yaw, speed, yaw_rate = read_odometry(robots, index)
        stamps_ns[index] = robot.stamp_ns
        fill(truths[index], (robot.x, robot.y, _through_quaternion(robot.yaw)))
        fill(odometry[index], (x, y, _through_quaternion(yaw)))
        velocities[index, 0] = speed
        velocities[index, 1] = yaw_rate


@kernel
def _through_quaternion(yaw: float) -> float:
    """Return a yaw (rad) as a message holds it, as `Pose2D.through_quaternion` does."""
    return wrap(2.0 * math.atan2(math.sin(0.5 * yaw), math.cos(0.5 * yaw)))


@kernel
def base_motion(fleet: Fleet, index: int) -> tuple[float, float, float, float, float]:
    """Return true pose, forward speed and yaw rate of base_link.

    Args:
        fleet: Robots and their settings.
        index: Row of the robot.

    Returns:
        x, y (m), yaw (rad), forward speed (m/s) and yaw rate (rad/s).
    """
    robot: Record = fleet.robots[index]
    center = vector(fleet.settings[0].center)
    # The body's velocity is that of the center of mass; base_link adds what the spin
    # does to the lever between both.
    offset = transform(rotation(quaternion(robot.attitude)), center)
    lever_x, lever_y, _ = cross(vector(robot.spin), offset)
    vx = robot.velocity[0] - lever_x
    vy = robot.velocity[1] - lever_y
    speed = vx * math.cos(robot.yaw) + vy * math.sin(robot.yaw)
    return robot.x, robot.y, robot.yaw, speed, robot.spin[2]
