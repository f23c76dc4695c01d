"""Motion of the body that touches only the ground, and the ground's forces on its wheels.

The scheme is Bullet's, so that a body can change between both: semi-implicit Euler with
a gyroscopic torque from one Newton step of implicit Euler, and the exponential map for
the attitude. Both agree to a nanometer over seconds; last digits differ.

Bullet's own wheels and friction cannot be used for skid steering. Its iteration over
the two friction directions of a contact ends with forces in proportion to the effective
masses, and a driven wheel has a much smaller effective mass along its rolling direction
than sideways. With Bullet's defaults a command of 1 rad/s in place gives 0.1 to 1
rad/s, depending on the heading. So the contact is computed here: each wheel touches the
ground at its lowest point, with a stiff spring for the load and an exact solution of
Coulomb friction (`barn_sim.body.friction`). The wheels' speed is given: the motors (20
N m and more at the wheel) are far stronger than friction (2.2 N m).

Casters carry load and have no friction. A caster counts as a ball of the wheels'
radius.
"""

import math
from functools import cache

import numpy as np

from barn_sim.body.friction import Motion, Rims, begin_friction
from barn_sim.body.model import RobotModel
from barn_sim.body.state import Record
from barn_sim.body.vectors import (
    Matrix,
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
from barn_sim.config import PhysicsConfig
from barn_worlds.base.arrays import inline_kernel, kernel
from barn_worlds.base.errors import ConfigError

# Slower spins than this turn the body by less than rounding.
_STILL_RAD_S = 1e-12

# Growth per tick, of the 2 at which an explicit integration becomes unstable.
_STABLE = 1.9
_LEVEL = 1e-12


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


class Tires:
    """Springs and dampers under the wheels and casters of a robot."""

    def __init__(self, model: RobotModel, config: PhysicsConfig):
        """Choose springs by the configured deflection; ConfigError if unstable.

        Args:
            model: The robot.
            config: Deflection and damping of the tires, gravity and tick.

        Raises:
            ConfigError: If the body is too light for the physics step.
        """
        contacts = np.concatenate([model.wheels, model.casters])
        share_kg = model.mass_kg / len(contacts)
        self.stiffness = share_kg * config.gravity_m_s2 / config.tyre_deflection_m
        """Of each tire, N/m."""
        critical = 2.0 * math.sqrt(self.stiffness * share_kg)
        self.damping = config.tyre_damping_ratio * critical
        """Of each tire, N s/m."""
        self.hubs = contacts - model.center_of_mass
        """Wheels and casters (n, 3) relative to the center of mass, m."""
        self._require_stable(model, config.tick_s)

        # The deflection of a tire is -(height - reach) - y roll + x pitch for small
        # angles. Loads carry the weight and have no moment.
        x = self.hubs[:, 0]
        y = self.hubs[:, 1]
        count = float(len(x))
        equilibrium = np.array(
            [
                [-count, -y.sum(), x.sum()],
                [-y.sum(), -(y * y).sum(), (x * y).sum()],
                [-x.sum(), -(x * y).sum(), (x * x).sum()],
            ]
        )
        weight = np.array([count * config.tyre_deflection_m, 0.0, 0.0])
        lift, roll, pitch = np.linalg.solve(equilibrium, weight).tolist()
        height = float(model.wheel_radius_m - self.hubs[0, 2] + lift)
        self.rest = (height, roll, pitch)
        """Height of the center of mass (m), roll and pitch (rad) of a robot at rest."""

    def _require_stable(self, model: RobotModel, tick_s: float) -> None:
        """Raise ConfigError if the springs are too stiff for this physics step."""
        x = self.hubs[:, 0]
        y = self.hubs[:, 1]
        # How far each contact sinks with height, roll and pitch.
        sinking = np.column_stack([np.ones(len(x)), y, -x])
        inertia = np.array([model.mass_kg, model.inertia[0], model.inertia[1]])
        stiffest = np.linalg.eigvals(
            (sinking.T @ sinking) / inertia[:, None]
        ).real.max()
        growth = stiffest * tick_s * (self.damping + 0.5 * self.stiffness * tick_s)
        if growth > _STABLE:
            raise ConfigError(
                f"robot {model.name}: chassis.inertia_kg_m2 is too small for a body on tires in physics steps of"
                f" {tick_s:g} s (physics.tick_s): it would vibrate with growing amplitude"
            )


tires_of = cache(Tires)


@inline_kernel
def begin_tires(robot: Record, fixed: Record) -> tuple[Motion, Rims]:
    """Set the wheels' loads; return motion after the last tick's friction, rim speeds.

    Args:
        robot: Record of the robot, with the rim speeds of the tick.
        fixed: Record of the settings.

    Returns:
        Velocity and spin with the friction of the last tick, and speeds of the rims.
    """
    turn = rotation(quaternion(robot.attitude))
    inverse = world_inertia(turn, vector(fixed.inverse_inertia))
    # Loads act at once; gravity and gyroscopic torque follow when the body moves.
    wx, wy, wz = transform(inverse, load_wheels(robot, fixed, turn))
    motion = (
        robot.velocity[0],
        robot.velocity[1],
        robot.spin[0] + fixed.tick_s * wx,
        robot.spin[1] + fixed.tick_s * wy,
        robot.spin[2] + fixed.tick_s * wz,
    )
    return begin_friction(
        motion,
        robot.left_m_s,
        robot.right_m_s,
        robot.wheels[: fixed.grips],
        turn,
        inverse,
        fixed.inverse_mass,
        fixed.slip_mps,
    )


@inline_kernel
def load_wheels(robot: Record, fixed: Record, turn: Matrix) -> Vector:
    """Set arm (m), load (N) and friction limit (N s) of each wheel; return the torque.

    Args:
        robot: Record of the robot.
        fixed: Record of the settings.
        turn: Rotation of the body.

    Returns:
        Torque of the loads about the center of mass, N m.
    """
    # From a hub to the lowest point of the wheel, which is tilted with its axle.
    axle_x = turn[0][1]
    axle_y = turn[1][1]
    axle_z = turn[2][1]
    level = math.sqrt(max(1.0 - axle_z * axle_z, _LEVEL))
    radius = fixed.wheel_radius_m
    below = (
        radius * axle_z * axle_x / level,
        radius * axle_z * axle_y / level,
        -(radius * level),
    )

    torque_x = 0.0
    torque_y = 0.0
    for i in range(fixed.contacts):
        wheel: Record = robot.wheels[i]
        hub = vector(wheel.hub)
        x = dot(turn[0], hub) + below[0]
        y = dot(turn[1], hub) + below[1]
        z = dot(turn[2], hub) + below[2]
        # The ground is the plane z = 0.
        depth = -(robot.position[2] + z)
        rising = robot.velocity[2] + robot.spin[0] * y - robot.spin[1] * x
        load = 0.0
        if depth > 0.0:
            # A damper that pulled the wheel down would glue it to the ground.
            load = max(fixed.stiffness * depth - fixed.damping * rising, 0.0)
        torque_x += y * load
        torque_y -= x * load
        wheel.arm_x = x
        wheel.arm_y = y
        wheel.arm_z = z
        wheel.load = load
        # As an impulse: force of friction times the duration of the tick.
        wheel.limit = fixed.friction * fixed.tick_s * load
    return torque_x, torque_y, 0.0


@kernel
def tire_forces(robot: Record, fixed: Record) -> tuple[Vector, Vector]:
    """Return the ground's force (N) and torque (N m) on the body, from solved impulses.

    Args:
        robot: Record of the robot, with loads and solved impulses of its wheels.
        fixed: Record of the settings.

    Returns:
        Force (N), and torque about the center of mass (N m), in the world frame.
    """
    fx = fy = fz = 0.0
    tx = ty = tz = 0.0
    for i in range(fixed.contacts):
        wheel: Record = robot.wheels[i]
        x = wheel.impulse_x / fixed.tick_s
        y = wheel.impulse_y / fixed.tick_s
        z = wheel.load
        fx += x
        fy += y
        fz += z
        tx += wheel.arm_y * z - wheel.arm_z * y
        ty += wheel.arm_z * x - wheel.arm_x * z
        tz += wheel.arm_x * y - wheel.arm_y * x
    return (fx, fy, fz), (tx, ty, tz)


@kernel
def world_inertia(turn: Matrix, inverse_inertia: Vector) -> Matrix:
    """Return the inverse inertia matrix in the world frame, 1/(kg m2).

    Args:
        turn: Rotation of the body.
        inverse_inertia: Inverse moments about the axes of the body, 1/(kg m2).
    """
    # turn diag(inverse_inertia) turn^T, which is symmetric.
    ix, iy, iz = inverse_inertia
    (xx, xy, xz), (yx, yy, yz), (zx, zy, zz) = turn
    return (
        transform(turn, (xx * ix, xy * iy, xz * iz)),
        transform(turn, (yx * ix, yy * iy, yz * iz)),
        transform(turn, (zx * ix, zy * iy, zz * iz)),
    )
