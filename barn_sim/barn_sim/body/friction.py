"""Coulomb friction of wheels whose rim speeds are given.

`barn_sim.body.rigid_body` explains the problem. Friction is an impulse per wheel in the
ground plane, inside the circle of radius friction x load. Either the wheel does not
slip, or the impulse is on the circle and opposes the slip (maximum dissipation). A
rubber tire slips before that, in proportion to the impulse; this is an option. The
solver is block Gauss-Seidel with one step size per wheel; one per direction would not
have this fixed point (Acary and Brogliato 2008, ch. 13).
"""

import math

from numba import njit

from barn_sim.body.state import Record, Records
from barn_sim.body.vectors import Matrix, Vector, fill
from barn_worlds.base.arrays import Floats, inline_kernel, kernel

SWEEPS = 100
# Change of an impulse that ends the iteration, N s: 1e-9 m/s of the Jackal.
TOLERANCE = 1e-8
_SHORTEST = 1e-12

Levers = tuple[float, float, float, float, float, float]
# Velocity along x and y (m/s) and spin about x, y and z (rad/s) of the body.
Motion = tuple[float, float, float, float, float]
# Speeds of the rims in m/s: along x left and right, along y left and right.
Rims = tuple[float, float, float, float]


@inline_kernel
def begin_friction(
    motion: Motion,
    left: float,
    right: float,
    wheels: Records,
    turn: Matrix,
    inverse: Matrix,
    inverse_mass: float,
    full_slip_mps: float,
) -> tuple[Motion, Rims]:
    """Set wheels' levers and steps; return motion after last impulses, and rim speeds.

    Args:
        motion: Velocity and spin at the end of the tick without friction.
        left: Rim speed of the left wheels, m/s.
        right: Rim speed of the right wheels, m/s.
        wheels: Records (n,) with arms and limits, left and right in turn. Levers,
            steps and impulses are filled in.
        turn: Rotation of the body.
        inverse: Inverse inertia in the world frame.
        inverse_mass: Of the body, 1/kg.
        full_slip_mps: Slip at which all friction acts; below, friction is proportional
            to the slip. With 0 a wheel that can hold does not slip at all.

    Returns:
        The motion with the effect of the impulses, and the speeds of the rims.
    """
    # The wheels roll across their axle, which is the y axis of the body.
    length = math.sqrt(turn[1][1] * turn[1][1] + turn[0][1] * turn[0][1])
    length = max(length, _SHORTEST)
    rolling_x = turn[1][1] / length
    rolling_y = -turn[0][1] / length

    for i in range(len(wheels)):
        wheel: Record = wheels[i]
        arm = (wheel.arm_x, wheel.arm_y, wheel.arm_z)
        wheel.step, levers = contact_response(arm, inverse, inverse_mass)
        fill(wheel.levers, levers)
        # The load may have fallen since the last tick, and with it the circle of
        # friction.
        x, y = clip(wheel.impulse_x, wheel.impulse_y, wheel.limit)
        wheel.impulse_x = x
        wheel.impulse_y = y
        motion = apply_impulse(motion, levers, inverse_mass, x, y)

        # A tire that slips by s under the impulse p has s = softness * p. That term
        # joins the diagonal of the contact's matrix, so the step shrinks with it.
        softness = 0.0
        if wheel.limit > 0.0:
            softness = full_slip_mps / wheel.limit
        wheel.step /= 1.0 + wheel.step * softness
        wheel.keep = 1.0 - wheel.step * softness
    rims = (left * rolling_x, right * rolling_x, left * rolling_y, right * rolling_y)
    return motion, rims


@kernel
def sweep_friction(
    motion: Motion, rims: Rims, wheels: Records, inverse_mass: float, sweeps: int
) -> Motion:
    """Iterate friction impulses in place, at most `sweeps` times; return the motion.

    Args:
        motion: Velocity and spin with the effect of the impulses so far.
        rims: Speeds of the rims.
        wheels: Records (n,) as `begin_friction` leaves them; impulses are improved.
        inverse_mass: Of the body, 1/kg.
        sweeps: Largest number of sweeps.

    Returns:
        Velocity and spin at the end of the tick.
    """
    for _ in range(sweeps):
        largest = 0.0
        for i in range(len(wheels)):
            wheel: Record = wheels[i]
            vx, vy, wx, wy, wz = motion
            # Slip is the velocity of the contact point minus that of the rim: v + w x
            # arm - rim.
            slip_x = vx + wy * wheel.arm_z - wz * wheel.arm_y - rims[i % 2]
            slip_y = vy + wz * wheel.arm_x - wx * wheel.arm_z - rims[2 + i % 2]
            x = wheel.keep * wheel.impulse_x - wheel.step * slip_x
            y = wheel.keep * wheel.impulse_y - wheel.step * slip_y
            x, y = clip(x, y, wheel.limit)
            change_x = x - wheel.impulse_x
            change_y = y - wheel.impulse_y
            wheel.impulse_x = x
            wheel.impulse_y = y
            motion = apply_impulse(
                motion, wheel.levers, inverse_mass, change_x, change_y
            )
            # Each wheel sees the impulses of those before it in the same sweep
            # (Gauss-Seidel).
            largest = max(largest, abs(change_x), abs(change_y))
        if largest < TOLERANCE:
            break
    return motion


@inline_kernel
def contact_response(
    arm: Vector, inverse: Matrix, inverse_mass: float
) -> tuple[float, Levers]:
    """Return the solver's step (kg) at a contact, and its levers on the body's spin.

    Args:
        arm: From the center of mass to the contact, m.
        inverse: Inverse inertia in the world frame.
        inverse_mass: Of the body, 1/kg.

    Returns:
        The step of the solver, which is the inverse of the largest eigenvalue of the
        contact's 2 x 2 matrix, and the levers: change of the spin about x, y and z per
        impulse along x and along y in turn.
    """
    x, y, z = arm
    (xx, xy, xz), (yx, yy, yz), (zx, zy, zz) = inverse
    levers = (
        xy * z - xz * y,
        xz * x - xx * z,
        yy * z - yz * y,
        yz * x - yx * z,
        zy * z - zz * y,
        zz * x - zx * z,
    )
    # The contact's matrix [[a, b], [b, c]] maps an impulse to the change of slip.
    a = inverse_mass + levers[2] * z - levers[4] * y
    b = levers[3] * z - levers[5] * y
    c = inverse_mass + levers[5] * x - levers[1] * z
    half = 0.5 * (a - c)
    largest: float = 0.5 * (a + c) + math.sqrt(half * half + b * b)
    return 1.0 / largest, levers


@njit(cache=True, inline="always")
def apply_impulse(
    motion: Motion, levers: Levers | Floats, inverse_mass: float, x: float, y: float
) -> Motion:
    """Return velocity and spin of the body after an impulse at a contact.

    Args:
        motion: Velocity and spin of the body before.
        levers: Of the contact, see `contact_response`.
        inverse_mass: Of the body, 1/kg.
        x: Impulse along x, N s.
        y: Impulse along y, N s.
    """
    vx, vy, wx, wy, wz = motion
    return (
        vx + inverse_mass * x,
        vy + inverse_mass * y,
        wx + (levers[0] * x + levers[1] * y),
        wy + (levers[2] * x + levers[3] * y),
        wz + (levers[4] * x + levers[5] * y),
    )


@njit(cache=True, error_model="numpy", inline="always")
def clip(x: float, y: float, limit: float) -> tuple[float, float]:
    """Return an impulse (x, y) shortened to at most a limit, its direction kept.

    Without a branch, so that `barn_sim.motion.lanes` computes several at once.

    Args:
        x: Impulse along x, N s.
        y: Impulse along y, N s.
        limit: Largest length, N s.
    """
    squared = x * x + y * y
    scale = limit / math.sqrt(squared) if squared > limit * limit else 1.0
    return x * scale, y * scale
