"""Forces of the ground on the wheels.

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
    Vector,
    dot,
    quaternion,
    rotation,
    transform,
    vector,
)
from barn_sim.config import PhysicsConfig
from barn_worlds.base.errors import ConfigError
from barn_worlds.base.kernel import inline_kernel, kernel

# Growth per tick, of the 2 at which an explicit integration becomes unstable.
_STABLE = 1.9
_LEVEL = 1e-12


class Tires:
    """Springs and dampers under the wheels and casters of a robot."""

    def __init__(self, model: RobotModel, config: PhysicsConfig):
        """Choose springs that give way as configured under the robot's weight.

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
                f"robot {model.name}: chassis.inertia_kg_m2 is too small for a body on"
                f" tires in physics steps of {tick_s:g} s (physics.tick_s): it would"
                " shake ever more"
            )


tires_of = cache(Tires)


@inline_kernel
def begin_tires(robot: Record, fixed: Record) -> tuple[Motion, Rims]:
    """Set the wheels' loads of a tick; return what the friction solver starts from.

    Args:
        robot: Record of the robot, with the rim speeds of the tick.
        fixed: Record of the settings.

    Returns:
        Velocity and spin with the friction of the last tick, and speeds of the rims.
    """
    turn = rotation(quaternion(robot.attitude))
    inverse = world_inertia(turn, vector(fixed.inverse_inertia))
    torque = load_wheels(robot, fixed, turn)
    # Loads act at once; gravity and gyroscopic torque follow when the body moves.
    wx, wy, wz = transform(inverse, torque)
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
