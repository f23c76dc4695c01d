"""Forces of the ground on the wheels.

Bullet's own wheels and friction cannot be used for skid steering. Its iteration over the two friction directions of a
contact ends with forces in proportion to the effective masses, and a driven wheel has a much smaller effective mass
along its rolling direction than sideways. With Bullet's defaults a command of 1 rad/s in place gives 0.1 to 1 rad/s,
depending on the heading. So the contact is computed here: each wheel touches the ground at its lowest point, with a
stiff spring for the load and an exact solution of Coulomb friction.

Friction is an impulse per wheel in the ground plane, inside the circle of radius friction x load. Either the wheel
does not slip, or the impulse is on the circle and opposes the slip (maximum dissipation). The solver is block
Gauss-Seidel with one step size per wheel; one per direction would not have this fixed point (Acary and Brogliato 2008,
ch. 13).
The wheels' speed is given: the motors (20 N m and more at the wheel) are far stronger than friction (2.2 N m).

Casters carry load and have no friction.
"""

import math
from typing import Any

import numpy as np
from numba import njit, types
from numba.extending import intrinsic

from barn_sim.body.free_motion import Matrix, Quaternion, Triple, times, triple
from barn_sim.body.friction import Motion
from barn_sim.body.model import RobotModel
from barn_sim.body.state import Record
from barn_sim.config import PhysicsConfig
from barn_worlds.base.arrays import Floats
from barn_worlds.base.errors import ConfigError

_STABLE = 1.9  # of the 2 at which an explicit integration begins to grow


class Tires:
    """Wheels and casters of a robot on level ground at z = 0; wheels (n, 5): hub and impulse, see `stand`.

    A caster counts as a ball of the wheels' radius. Raises ConfigError if the body is too light for the physics step.
    stiffness (N/m) and damping (N s/m): of a tyre. rest: height of the centre of mass, roll and pitch at which the
    robot stands still (small angles).
    """

    def __init__(self, model: RobotModel, config: PhysicsConfig) -> None:
        hubs = np.concatenate([model.wheels, model.casters]) - model.center_of_mass
        share = model.mass_kg / len(hubs)
        self.stiffness = share * config.gravity_m_s2 / config.tyre_deflection_m
        self.damping = (
            2.0 * config.tyre_damping_ratio * math.sqrt(self.stiffness * share)
        )
        self.wheels = np.zeros((len(hubs), 5))
        self.wheels[:, :3] = hubs
        self._require_stable(model, config.tick_s)
        x, y = hubs[:, 0], hubs[:, 1]
        # deflection of a tyre is -(height - reach) - y roll + x pitch; loads carry the weight and have no moment
        heave = [-len(x), -y.sum(), x.sum()]
        system = np.array(
            [
                heave,
                [-y.sum(), -(y * y).sum(), (x * y).sum()],
                [-x.sum(), -(x * y).sum(), (x * x).sum()],
            ]
        )
        weight = np.array([len(x) * config.tyre_deflection_m, 0.0, 0.0])
        lowered, roll, pitch = np.linalg.solve(system, weight).tolist()
        self.rest: Triple = (
            float(model.wheel_radius_m - hubs[0, 2] + lowered),
            roll,
            pitch,
        )

    def _require_stable(self, model: RobotModel, tick_s: float) -> None:
        """Raise ConfigError if heaving, rolling or pitching would grow from tick to tick."""
        x, y = self.wheels[:, 0], self.wheels[:, 1]
        sinks = np.column_stack(
            [np.ones(len(x)), y, -x]
        )  # of each contact with height, roll and pitch
        inertia = np.array([model.mass_kg, model.inertia[0], model.inertia[1]])
        modes = np.linalg.eigvals((sinks.T @ sinks) / inertia[:, None]).real.max()
        growth = modes * tick_s * (self.damping + 0.5 * self.stiffness * tick_s)
        if growth > _STABLE:
            raise ConfigError(
                f"robot {model.name}: chassis.inertia_kg_m2 is too small for a body on tyres in physics steps of"
                f" {tick_s:g} s (physics.tick_s): it would shake ever more"
            )


def _fused(_context, a, b, c):  # type: ignore[no-untyped-def]
    return types.float64(a, b, c), lambda _, builder, __, values: builder.fma(*values)


# fused(a, b, c): a * b + c, rounded once, as in the matrix products of BLAS; the same on every processor.
fused: Any = intrinsic(_fused)


@njit(cache=True, error_model="numpy")
def rotation(q: Quaternion) -> Matrix:
    """Return the matrix of a unit quaternion (x, y, z, w)."""
    x, y, z, w = q
    return (
        (1 - 2 * (y * y + z * z), 2 * (x * y - w * z), 2 * (x * z + w * y)),
        (2 * (x * y + w * z), 1 - 2 * (x * x + z * z), 2 * (y * z - w * x)),
        (2 * (x * z - w * y), 2 * (y * z + w * x), 1 - 2 * (x * x + y * y)),
    )


@njit(cache=True, error_model="numpy")
def offset_of_centre(arm: Triple, attitude: Quaternion) -> Triple:
    """Return the vector `arm`, given in base_link, in the world frame."""
    cx, cy, cz = arm[0], arm[1], arm[2]
    x, y, z, w = attitude
    tx, ty, tz = (
        2.0 * (y * cz - z * cy),
        2.0 * (z * cx - x * cz),
        2.0 * (x * cy - y * cx),
    )
    return (
        cx + w * tx + y * tz - z * ty,
        cy + w * ty + z * tx - x * tz,
        cz + w * tz + x * ty - y * tx,
    )


@njit(cache=True, error_model="numpy")
def place(position: Triple, attitude: Quaternion, arm: Floats) -> Triple:
    """Return x, y, yaw of base_link; `arm` (3,) leads from there to the centre of mass."""
    offset = offset_of_centre(triple(arm), attitude)
    x, y, z, w = attitude
    yaw = math.atan2(2.0 * (w * z + x * y), 1.0 - 2.0 * (y * y + z * z))
    return position[0] - offset[0], position[1] - offset[1], yaw


@njit(cache=True, error_model="numpy", forceinline=True)
def stand(
    position: Triple,
    attitude: Quaternion,
    velocity: Triple,
    spin: Triple,
    wheels: Floats,
    fixed: Record,
) -> tuple[Motion, Matrix, Matrix, Triple]:
    """Begin a tick of a body on its wheels: fill in where they touch the ground, and the limits of their friction.

    position, attitude, velocity, spin: of the centre of mass in the world frame. wheels (n, 17): hub in m, impulse of
    the last solution in N s, arm from the centre of mass to the ground in m, limit of the impulse, and room for
    `friction`; the first `grips` are wheels, left and right in turn, the others casters. fixed: a record of SETTINGS.

    Returns vx, vy and spin after the tick without friction, rotation and inverse inertia in the world frame, and what
    the loads do: force along z, torque about x and y.
    """
    tick, arms, loads = fixed.tick_s, wheels[:, 5:8], wheels[:, 8]
    turn = rotation(attitude)
    inverse = world_inertia(turn, triple(fixed.inverse_inertia))
    wheel_loads(
        position[2], turn, velocity[2], spin, wheels[:, :3], fixed.wheel_radius_m, fixed.stiffness, fixed.damping, arms,
        loads,
    )  # fmt: skip
    fz = tx = ty = 0.0
    for i in range(len(wheels)):
        fz += loads[i]
        tx += arms[i, 1] * loads[i]
        ty -= arms[i, 0] * loads[i]
        loads[i] = fixed.friction * tick * loads[i]
    twist = tx, ty, 0.0
    wx, wy, wz = (
        _product(inverse[0], twist),
        _product(inverse[1], twist),
        _product(inverse[2], twist),
    )
    spins = spin[0] + tick * wx, spin[1] + tick * wy, spin[2] + tick * wz
    return (velocity[0], velocity[1], *spins), turn, inverse, (fz, tx, ty)


@njit(cache=True, error_model="numpy", forceinline=True)
def forces(carried: Triple, wheels: Floats, tick: float) -> tuple[Triple, Triple]:
    """Return force (N) and torque (N m) about the centre of mass, of what the loads do and the wheels' impulses."""
    fx = fy = tz = 0.0
    fz, tx, ty = carried
    for i in range(len(wheels)):
        x, y = wheels[i, 3] / tick, wheels[i, 4] / tick
        fx += x
        fy += y
        tx -= wheels[i, 7] * y
        ty += wheels[i, 7] * x
        tz += wheels[i, 5] * y - wheels[i, 6] * x
    return (fx, fy, fz), (tx, ty, tz)


@njit(cache=True, error_model="numpy")
def world_inertia(turn: Matrix, inverse_inertia: Triple) -> Matrix:
    """Return the inverse inertia in the world frame from that about the axes of the body."""
    x, y, z = (
        times(turn[0], inverse_inertia),
        times(turn[1], inverse_inertia),
        times(turn[2], inverse_inertia),
    )
    return (
        (_row_product(x, turn[0]), _row_product(x, turn[1]), _row_product(x, turn[2])),
        (_row_product(y, turn[0]), _row_product(y, turn[1]), _row_product(y, turn[2])),
        (_row_product(z, turn[0]), _row_product(z, turn[1]), _row_product(z, turn[2])),
    )


@njit(cache=True, error_model="numpy")
def _row_product(scaled: Triple, row: Triple) -> float:
    """Return the product of two rows, in the order of BLAS for matrices."""
    result: float = fused(
        scaled[2], row[2], fused(scaled[1], row[1], scaled[0] * row[0])
    )
    return result


@njit(cache=True, error_model="numpy")
def _product(row: Triple, vector: Triple) -> float:
    """Return the product of a row of a matrix and a vector, in the order of BLAS."""
    result: float = fused(
        row[2], vector[2], fused(row[0], vector[0], row[1] * vector[1])
    )
    return result


@njit(cache=True, error_model="numpy", forceinline=True)
def wheel_loads(
    height: float, turn: Matrix, sinking: float, spin: Triple, hubs: Floats, radius: float, stiffness: float,
    damping: float, arms: Floats, loads: Floats,
) -> None:  # fmt: skip
    """Fill in arms (n, 3) from the centre of mass to each wheel's lowest point, and the loads (n,) in N there.

    height, sinking: of the centre of mass, m and m/s; turn: rotation of the body; hubs (n, 3).
    """
    axle_x, axle_y, axle_z = turn[0][1], turn[1][1], turn[2][1]
    level = math.sqrt(max(1.0 - axle_z * axle_z, 1e-12))
    below = (
        radius * axle_z * axle_x / level,
        radius * axle_z * axle_y / level,
        -(radius * level),
    )
    for i in range(len(hubs)):
        hub, arm = triple(hubs[i]), arms[i]
        for k in range(3):
            arm[k] = _product(turn[k], hub) + below[k]
        depth = -(height + arm[2])
        rising = sinking + spin[0] * arm[1] - spin[1] * arm[0]
        loads[i] = (
            max(stiffness * depth - damping * rising, 0.0) if depth > 0.0 else 0.0
        )
