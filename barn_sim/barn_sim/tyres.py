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

Casters carry load and have no friction. The front wheels of a car roll freely at their angles, so theirs is sideways
alone. Its rear wheels are driven through an ideal differential: their mean speed is given, and they push alike.
"""

import math
from typing import Any

import numpy as np
from numba import njit, types
from numba.extending import intrinsic

from barn_sim.config import PhysicsConfig
from barn_sim.model import RobotModel
from barn_worlds.arrays import Floats
from barn_worlds.errors import ConfigError

Triple = tuple[float, float, float]
Quaternion = tuple[float, float, float, float]

_SWEEPS = 100
_SURELY = 1.0 - 1e-12  # more than squares are rounded by
_TOLERANCE = 1e-8  # of an impulse, in N s: 1e-9 m/s of the Jackal
_HALVINGS = 50  # of an interval in which a number is sought
_STABLE = 1.9  # of the 2 at which an explicit integration begins to grow


class Tyres:
    """Wheels and casters of a robot on level ground at z = 0; wheels (n, 5) and numbers (12,): see `act_on_body`.

    A caster counts as a ball of the wheels' radius. Raises ConfigError if the body is too light for the physics step.
    """

    def __init__(self, model: RobotModel, config: PhysicsConfig) -> None:
        self._hubs = np.concatenate([model.wheels, model.casters]) - model.centre_of_mass
        self._radius = model.wheel_radius_m
        self._deflection_m = config.tyre_deflection_m
        share = model.mass_kg / len(self._hubs)
        stiffness = share * config.gravity_m_s2 / config.tyre_deflection_m
        damping = 2.0 * config.tyre_damping_ratio * math.sqrt(stiffness * share)
        ground = [config.tick_s, model.mass_kg, config.wheel_friction, stiffness, damping, model.wheel_radius_m]
        self.numbers = np.concatenate([ground, 1.0 / model.inertia, model.centre_of_mass])
        self.wheels = np.zeros((len(self._hubs), 5))  # hub, then the last impulse
        self.wheels[:, :3] = self._hubs
        self._require_stable(model, config.tick_s, stiffness, damping)

    def _require_stable(self, model: RobotModel, tick_s: float, stiffness: float, damping: float) -> None:
        """Raise ConfigError if heaving, rolling or pitching would grow from tick to tick."""
        x, y = self._hubs[:, 0], self._hubs[:, 1]
        sinks = np.column_stack([np.ones(len(x)), y, -x])  # of each contact with height, roll and pitch
        inertia = np.array([model.mass_kg, model.inertia[0], model.inertia[1]])
        modes = np.linalg.eigvals((sinks.T @ sinks) / inertia[:, None]).real.max()
        growth = modes * tick_s * (damping + 0.5 * stiffness * tick_s)
        if growth > _STABLE:
            raise ConfigError(
                f"robot {model.name}: chassis.inertia_kg_m2 is too small for a body on tyres in physics steps of"
                f" {tick_s:g} s (physics.tick_s): it would shake ever more"
            )

    def rest(self) -> Triple:
        """Return height of the centre of mass, roll and pitch at which the robot stands still (small angles)."""
        x, y = self._hubs[:, 0], self._hubs[:, 1]
        # deflection of a tyre is -(height - reach) - y roll + x pitch; loads carry the weight and have no moment
        system = np.array(
            [
                [-len(x), -y.sum(), x.sum()],
                [-y.sum(), -(y * y).sum(), (x * y).sum()],
                [-x.sum(), -(x * y).sum(), (x * x).sum()],
            ]
        )
        weight = np.array([len(x) * self._deflection_m, 0.0, 0.0])
        lowered, roll, pitch = np.linalg.solve(system, weight).tolist()
        return float(self._radius - self._hubs[0, 2] + lowered), roll, pitch


def _fused(_context, a, b, c):  # type: ignore[no-untyped-def]
    return types.float64(a, b, c), lambda _, builder, __, values: builder.fma(*values)


# fused(a, b, c): a * b + c, rounded once, as in the matrix products of BLAS; the same on every processor.
fused: Any = intrinsic(_fused)


@njit(cache=True)
def rotation(q: Quaternion) -> Floats:
    """Return the matrix (3, 3) of a unit quaternion (x, y, z, w)."""
    x, y, z, w = q
    matrix = np.empty((3, 3))
    matrix[0, 0], matrix[0, 1], matrix[0, 2] = 1 - 2 * (y * y + z * z), 2 * (x * y - w * z), 2 * (x * z + w * y)
    matrix[1, 0], matrix[1, 1], matrix[1, 2] = 2 * (x * y + w * z), 1 - 2 * (x * x + z * z), 2 * (y * z - w * x)
    matrix[2, 0], matrix[2, 1], matrix[2, 2] = 2 * (x * z - w * y), 2 * (y * z + w * x), 1 - 2 * (x * x + y * y)
    return matrix


@njit(cache=True)
def offset_of_centre(arm: Floats, attitude: Quaternion) -> Triple:
    """Return the vector `arm` (3,), given in base_link, in the world frame."""
    cx, cy, cz = arm[0], arm[1], arm[2]
    x, y, z, w = attitude
    tx, ty, tz = 2.0 * (y * cz - z * cy), 2.0 * (z * cx - x * cz), 2.0 * (x * cy - y * cx)
    return cx + w * tx + y * tz - z * ty, cy + w * ty + z * tx - x * tz, cz + w * tz + x * ty - y * tx


@njit(cache=True)
def place(position: Triple, attitude: Quaternion, arm: Floats) -> Triple:
    """Return x, y, yaw of base_link; `arm` (3,) leads from there to the centre of mass."""
    offset = offset_of_centre(arm, attitude)
    x, y, z, w = attitude
    yaw = math.atan2(2.0 * (w * z + x * y), 1.0 - 2.0 * (y * y + z * z))
    return position[0] - offset[0], position[1] - offset[1], yaw


@njit(cache=True)
def act_on_body(
    position: Triple,
    attitude: Quaternion,
    velocity: Triple,
    spin: Triple,
    left: float,
    right: float,
    wheels: Floats,
    numbers: Floats,
    grips: int,
    angles: tuple[float, float],
    steered: bool,
) -> tuple[Triple, Triple]:
    """Return force in N and torque in N m about the centre of mass, world frame.

    position, attitude, velocity, spin: of the centre of mass in the world frame, before the tick; left, right: speed of
    the wheel rims in m/s. wheels (n, 5): hub in m and impulse of the last solution in N s, which is replaced; the first
    `grips` are wheels, left and right in turn, the others casters. numbers (12,): tick, mass, friction, stiffness,
    damping, radius, inverse inertia, centre of mass. steered: whether it is a car, the front wheels at `angles`, rad.
    """
    tick, mass, friction = numbers[0], numbers[1], numbers[2]
    hubs, impulses = wheels[:, :3], wheels[:, 3:]
    turn = rotation(attitude)
    inverse = world_inertia(turn, numbers[6:9])
    arms, loads = wheel_loads(position[2], turn, velocity[2], spin, hubs, numbers[5], numbers[3], numbers[4])
    fx = fy = fz = tx = ty = tz = 0.0
    for i in range(len(wheels)):
        fz += loads[i]
        tx += arms[i, 1] * loads[i]
        ty -= arms[i, 0] * loads[i]
    motion = np.empty(5)  # vx, vy and spin after the step, without friction
    motion[0], motion[1] = velocity[0], velocity[1]
    for k in range(3):
        motion[2 + k] = spin[k] + tick * _product(inverse[k], tx, ty, tz)
    for i in range(len(wheels)):
        loads[i] = friction * tick * loads[i]
    if steered:
        solve_steered(motion, 0.5 * (left + right), angles, arms, loads, turn, inverse, 1.0 / mass, impulses)
    else:
        arms_of, limits, kept = arms[:grips], loads[:grips], impulses[:grips]
        solve_friction(motion, left, right, arms_of, limits, turn, inverse, 1.0 / mass, kept)
    for i in range(len(wheels)):
        x, y = impulses[i, 0] / tick, impulses[i, 1] / tick
        fx += x
        fy += y
        tx -= arms[i, 2] * y
        ty += arms[i, 2] * x
        tz += arms[i, 0] * y - arms[i, 1] * x
    return (fx, fy, fz), (tx, ty, tz)


@njit(cache=True)
def world_inertia(turn: Floats, inverse_inertia: Floats) -> Floats:
    """Return the inverse inertia (3, 3) in the world frame from that about the axes of the body (3,)."""
    inverse = np.empty((3, 3))
    for i in range(3):
        a, b, c = turn[i, 0] * inverse_inertia[0], turn[i, 1] * inverse_inertia[1], turn[i, 2] * inverse_inertia[2]
        for j in range(3):
            inverse[i, j] = fused(c, turn[j, 2], fused(b, turn[j, 1], a * turn[j, 0]))
    return inverse


@njit(cache=True)
def _product(row: Floats, x: float, y: float, z: float) -> float:
    """Return the product of a row (3,) of a matrix and a vector, in the order of BLAS."""
    result: float = fused(row[2], z, fused(row[0], x, row[1] * y))
    return result


@njit(cache=True)
def wheel_loads(
    height: float,
    turn: Floats,
    sinking: float,
    spin: Triple,
    hubs: Floats,
    radius: float,
    stiffness: float,
    damping: float,
) -> tuple[Floats, Floats]:
    """Return arms (n, 3) from the centre of mass to each wheel's lowest point and the loads (n,) in N there.

    height, sinking: of the centre of mass, m and m/s; turn: rotation (3, 3) of the body.
    """
    count = len(hubs)
    arms, loads = np.empty((count, 3)), np.empty(count)
    axle = turn[0, 1], turn[1, 1], turn[2, 1]
    level = math.sqrt(max(1.0 - axle[2] * axle[2], 1e-12))
    for i in range(count):
        for k in range(3):
            arms[i, k] = _product(turn[k], hubs[i, 0], hubs[i, 1], hubs[i, 2])
        arms[i, 0] += radius * axle[2] * axle[0] / level
        arms[i, 1] += radius * axle[2] * axle[1] / level
        arms[i, 2] -= radius * level
        depth = -(height + arms[i, 2])
        rising = sinking + spin[0] * arms[i, 1] - spin[1] * arms[i, 0]
        loads[i] = max(stiffness * depth - damping * rising, 0.0) if depth > 0.0 else 0.0
    return arms, loads


@njit(cache=True)
def solve_friction(
    motion: Floats,
    left: float,
    right: float,
    arms: Floats,
    limits: Floats,
    turn: Floats,
    inverse: Floats,
    inverse_mass: float,
    impulses: Floats,
) -> None:
    """Find the friction impulses (n, 2) of the wheels and add their effect to `motion` (vx, vy, wx, wy, wz).

    limits (n,): largest impulse of each wheel, N s; `impulses` is the start of the iteration, then its result.
    """
    count = len(arms)
    length = max(math.hypot(turn[1, 1], -turn[0, 1]), 1e-12)
    rolling_x, rolling_y = turn[1, 1] / length, -turn[0, 1] / length
    lever = np.empty((count, 3, 2))  # change of spin per impulse
    step = np.empty(count)
    for i in range(count):
        step[i] = _prepare(arms[i], inverse, inverse_mass, lever[i])
        _clip(impulses[i], limits[i])
        _apply(motion, lever[i], inverse_mass, impulses[i, 0], impulses[i, 1])
    for _ in range(_SWEEPS):
        largest = 0.0
        for i in range(count):
            rim = left if i % 2 == 0 else right
            x, y, z = arms[i, 0], arms[i, 1], arms[i, 2]
            slip_x = motion[0] + motion[3] * z - motion[4] * y - rim * rolling_x
            slip_y = motion[1] + motion[4] * x - motion[2] * z - rim * rolling_y
            old_x, old_y = impulses[i, 0], impulses[i, 1]
            impulses[i, 0] -= step[i] * slip_x
            impulses[i, 1] -= step[i] * slip_y
            _clip(impulses[i], limits[i])
            change_x, change_y = impulses[i, 0] - old_x, impulses[i, 1] - old_y
            _apply(motion, lever[i], inverse_mass, change_x, change_y)
            largest = max(largest, abs(change_x), abs(change_y))
        if largest < _TOLERANCE:
            break


@njit(cache=True)
def _prepare(arm: Floats, inverse: Floats, inverse_mass: float, lever: Floats) -> float:
    """Fill `lever` (3, 2) and return the step: the inverse of the largest eigenvalue of the contact's 2 x 2 matrix."""
    x, y, z = arm[0], arm[1], arm[2]
    for k in range(3):
        lever[k, 0] = inverse[k, 1] * z - inverse[k, 2] * y
        lever[k, 1] = inverse[k, 2] * x - inverse[k, 0] * z
    a = inverse_mass + lever[1, 0] * z - lever[2, 0] * y
    b = lever[1, 1] * z - lever[2, 1] * y
    c = inverse_mass + lever[2, 1] * x - lever[0, 1] * z
    largest: float = 0.5 * (a + c) + math.hypot(0.5 * (a - c), b)
    return 1.0 / largest


@njit(cache=True)
def _apply(motion: Floats, lever: Floats, inverse_mass: float, x: float, y: float) -> None:
    motion[0] += inverse_mass * x
    motion[1] += inverse_mass * y
    for k in range(3):
        motion[2 + k] += lever[k, 0] * x + lever[k, 1] * y


@njit(cache=True)
def _clip(impulse: Floats, limit: float) -> None:
    if impulse[0] * impulse[0] + impulse[1] * impulse[1] < _SURELY * limit * limit:
        return
    length = math.hypot(impulse[0], impulse[1])
    if length > limit:
        impulse[0] *= limit / length
        impulse[1] *= limit / length


@njit(cache=True)
def front_angles(steering: float, wheelbase: float, half_track: float) -> tuple[float, float]:
    """Return the angles of the left and the right front wheel of a car, whose axles meet where it turns about."""
    bend = math.tan(steering)
    aside = bend * half_track / wheelbase
    return math.atan2(bend, 1.0 - aside), math.atan2(bend, 1.0 + aside)


@njit(cache=True)
def solve_steered(
    motion: Floats,
    speed: float,
    angles: tuple[float, float],
    arms: Floats,
    limits: Floats,
    turn: Floats,
    inverse: Floats,
    inverse_mass: float,
    impulses: Floats,
) -> None:
    """Do as `solve_friction` for a car: two front wheels at angles (rad) that roll freely, two driven rear wheels.

    speed: mean of the rim speeds of the rear wheels, m/s. Unknowns are a sideways impulse for each wheel and one along
    the rolling direction that the rear wheels share by halves, over the square root of 2 so that its unit has length 1.
    """
    length = max(math.hypot(turn[1, 1], -turn[0, 1]), 1e-12)
    along_x, along_y = turn[1, 1] / length, -turn[0, 1] / length
    lever = np.empty((4, 3, 2))
    across = np.empty((4, 2))
    trace = 0.0
    step = np.empty(4)
    sideways = np.empty(4)
    half = math.sqrt(0.5)
    for i in range(4):
        _prepare(arms[i], inverse, inverse_mass, lever[i])
        angle = angles[i] if i < 2 else 0.0
        c, s = math.cos(angle), math.sin(angle)
        across[i, 0], across[i, 1] = -along_y * c - along_x * s, along_x * c - along_y * s
        response = _answer(lever[i], arms[i], inverse_mass, across[i, 0], across[i, 1])
        step[i] = 1.0 / response
        if i >= 2:
            trace += response + _answer(lever[i], arms[i], inverse_mass, along_x, along_y)
        sideways[i] = impulses[i, 0] * across[i, 0] + impulses[i, 1] * across[i, 1]
        if i < 2:
            sideways[i] = max(-limits[i], min(limits[i], sideways[i]))
    driven = half * ((impulses[2, 0] + impulses[3, 0]) * along_x + (impulses[2, 1] + impulses[3, 1]) * along_y)
    driven, sideways[2], sideways[3] = through_differential(driven, sideways[2], sideways[3], limits[2], limits[3])
    for i in range(4):
        shared = half * driven if i >= 2 else 0.0
        impulses[i, 0] = sideways[i] * across[i, 0] + shared * along_x
        impulses[i, 1] = sideways[i] * across[i, 1] + shared * along_y
        _apply(motion, lever[i], inverse_mass, impulses[i, 0], impulses[i, 1])
    for _ in range(_SWEEPS):
        largest = 0.0
        for i in range(2):
            x, y = _slip(motion, arms[i])
            wanted = sideways[i] - step[i] * (x * across[i, 0] + y * across[i, 1])
            change = max(-limits[i], min(limits[i], wanted)) - sideways[i]
            sideways[i] += change
            _apply(motion, lever[i], inverse_mass, change * across[i, 0], change * across[i, 1])
            largest = max(largest, abs(change))
        left_x, left_y = _slip(motion, arms[2])
        right_x, right_y = _slip(motion, arms[3])
        slip = half * ((left_x + right_x) * along_x + (left_y + right_y) * along_y - 2.0 * speed)
        next_driven, next_left, next_right = through_differential(
            driven - slip / trace,
            sideways[2] - (left_x * across[2, 0] + left_y * across[2, 1]) / trace,
            sideways[3] - (right_x * across[3, 0] + right_y * across[3, 1]) / trace,
            limits[2],
            limits[3],
        )
        shared = half * (next_driven - driven)
        for i, change in ((2, next_left - sideways[2]), (3, next_right - sideways[3])):
            change_x, change_y = change * across[i, 0] + shared * along_x, change * across[i, 1] + shared * along_y
            _apply(motion, lever[i], inverse_mass, change_x, change_y)
            largest = max(largest, abs(change_x), abs(change_y))
        driven, sideways[2], sideways[3] = next_driven, next_left, next_right
        if largest < _TOLERANCE:
            break
    for i in range(4):
        shared = half * driven if i >= 2 else 0.0
        impulses[i, 0] = sideways[i] * across[i, 0] + shared * along_x
        impulses[i, 1] = sideways[i] * across[i, 1] + shared * along_y


@njit(cache=True)
def through_differential(
    driven: float, left: float, right: float, left_limit: float, right_limit: float
) -> tuple[float, float, float]:
    """Return the nearest impulses that the friction of both rear wheels allows.

    driven: along the rolling direction, of which each wheel has 1 / sqrt(2). left, right: sideways.
    """
    squared = 0.5 * driven * driven
    if squared + left * left <= left_limit * left_limit and squared + right * right <= right_limit * right_limit:
        return driven, left, right
    low, high = 0.0, min(abs(driven), math.sqrt(2.0) * min(left_limit, right_limit))
    for _ in range(_HALVINGS):
        middle = 0.5 * (low + high)
        gain = middle - abs(driven)  # half of the derivative of the squared distance
        for aside, limit in ((abs(left), left_limit), (abs(right), right_limit)):
            room = math.sqrt(max(limit * limit - 0.5 * middle * middle, 0.0))
            if aside > room:
                gain += (aside - room) * 0.5 * middle / max(room, 1e-300)
        if gain > 0.0:
            high = middle
        else:
            low = middle
    rooms = (
        math.sqrt(max(left_limit * left_limit - 0.5 * low * low, 0.0)),
        math.sqrt(max(right_limit * right_limit - 0.5 * low * low, 0.0)),
    )
    return math.copysign(low, driven), max(-rooms[0], min(rooms[0], left)), max(-rooms[1], min(rooms[1], right))


@njit(cache=True)
def _slip(motion: Floats, arm: Floats) -> tuple[float, float]:
    """Return the velocity of the body where a wheel touches the ground."""
    x, y, z = arm[0], arm[1], arm[2]
    return motion[0] + motion[3] * z - motion[4] * y, motion[1] + motion[4] * x - motion[2] * z


@njit(cache=True)
def _answer(lever: Floats, arm: Floats, inverse_mass: float, x: float, y: float) -> float:
    """Return the velocity of a contact along a unit vector x, y per impulse along it."""
    spin_x, spin_y = lever[0, 0] * x + lever[0, 1] * y, lever[1, 0] * x + lever[1, 1] * y
    spin_z = lever[2, 0] * x + lever[2, 1] * y
    along_x = inverse_mass * x + spin_y * arm[2] - spin_z * arm[1]
    along_y = inverse_mass * y + spin_z * arm[0] - spin_x * arm[2]
    result: float = x * along_x + y * along_y
    return result
