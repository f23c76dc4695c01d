"""Motion of the body while it touches nothing but the ground.

The scheme is Bullet's, so that a body can change between both: semi-implicit Euler with
a gyroscopic torque from one Newton step of implicit Euler, and the exponential map for
the attitude. Both agree to a nanometer over seconds; last digits differ.
"""

import math

from barn_sim.body.friction import Motion
from barn_sim.body.state import Record
from barn_sim.body.vectors import (
    Quaternion,
    Vector,
    cross,
    dot,
    fill,
    multiply,
    quaternion,
    rotation,
    transform,
    transpose,
    vector,
)
from barn_worlds.base.kernel import inline_kernel, kernel

# Slower spins than this turn the body by less than rounding.
_STILL_RAD_S = 1e-12


@inline_kernel
def move_body(robot: Record, fixed: Record, motion: Motion) -> None:
    """Advance attitude, spin, velocity and position of a free body by one tick.

    Args:
        robot: Record of the robot, with loads of the tick.
        fixed: Record of the settings.
        motion: Velocity along x and y and spin under all forces of the tick but gravity
            and the gyroscopic torque.
    """
    tick_s = fixed.tick_s
    lift = 0.0
    for i in range(fixed.contacts):
        lift += robot.wheels[i].load

    vx, vy, wx, wy, wz = motion
    attitude = quaternion(robot.attitude)
    turn = gyroscopic_change(
        attitude, vector(robot.spin), vector(fixed.inertia), tick_s
    )
    spin = (wx + turn[0], wy + turn[1], wz + turn[2])
    fill(robot.spin, spin)
    fill(robot.attitude, rotate(attitude, spin, tick_s))

    robot.velocity[0] = vx
    robot.velocity[1] = vy
    # Semi-implicit Euler: the new velocity moves the body, as in Bullet.
    robot.velocity[2] += (lift * fixed.inverse_mass - fixed.gravity_m_s2) * tick_s
    for k in range(3):
        robot.position[k] += robot.velocity[k] * tick_s


@kernel
def rotate(attitude: Quaternion, spin: Vector, tick_s: float) -> Quaternion:
    """Return the attitude (unit quaternion) after a tick with a constant spin.

    Args:
        attitude: Unit quaternion before.
        spin: In the world frame, rad/s.
        tick_s: Duration of the tick.
    """
    rate = math.sqrt(dot(spin, spin))
    scale = 0.5 * tick_s
    # The limit of sin(x / 2) / x for slow spins, without a division by zero.
    if rate > _STILL_RAD_S:
        scale = math.sin(0.5 * rate * tick_s) / rate
    turn = (
        spin[0] * scale,
        spin[1] * scale,
        spin[2] * scale,
        math.cos(0.5 * rate * tick_s),
    )
    x, y, z, w = multiply(turn, attitude)
    # Rounding would let the quaternion grow over thousands of ticks.
    length = math.sqrt(x * x + y * y + z * z + w * w)
    return x / length, y / length, z / length, w / length


@kernel
def gyroscopic_change(
    attitude: Quaternion, spin: Vector, inertia: Vector, tick_s: float
) -> Vector:
    """Return the change of spin (rad/s, world frame) in a tick without any torque.

    In the body frame Euler's equations are I w' + w x I w = 0. An explicit step would
    gain energy, so this is the first Newton step of implicit Euler from the spin
    before.

    Args:
        attitude: Unit quaternion of the body.
        spin: In the world frame, rad/s.
        inertia: Moments about the axes of the body, kg m2.
        tick_s: Duration of the tick.
    """
    turn = rotation(attitude)
    x, y, z = transform(transpose(turn), spin)
    ix, iy, iz = inertia
    momentum = (ix * x, iy * y, iz * z)
    px, py, pz = momentum
    torque = cross((x, y, z), momentum)
    residual = (torque[0] * tick_s, torque[1] * tick_s, torque[2] * tick_s)

    # Columns of the Jacobian I + (skew(w) I - skew(I w)) tick; Cramer's rule.
    first = (ix, (z * ix - pz) * tick_s, (py - y * ix) * tick_s)
    second = ((pz - z * iy) * tick_s, iy, (x * iy - px) * tick_s)
    third = ((y * iz - py) * tick_s, (px - x * iz) * tick_s, iz)
    determinant = dot(first, cross(second, third))
    step = (
        -dot(residual, cross(second, third)) / determinant,
        -dot(first, cross(residual, third)) / determinant,
        -dot(first, cross(second, residual)) / determinant,
    )
    return transform(turn, step)


@kernel
def place_base(robot: Record, fixed: Record) -> None:
    """Set x, y and yaw of base_link in a record, from its center of mass and attitude.

    Args:
        robot: Record of the robot.
        fixed: Record of the settings.
    """
    attitude = quaternion(robot.attitude)
    offset = transform(rotation(attitude), vector(fixed.center))
    x, y, z, w = attitude
    robot.x = robot.position[0] - offset[0]
    robot.y = robot.position[1] - offset[1]
    robot.yaw = math.atan2(2.0 * (w * z + x * y), 1.0 - 2.0 * (y * y + z * z))
