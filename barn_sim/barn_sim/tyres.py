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
"""

import math

import numpy as np
from numba import njit

from barn_sim.config import PhysicsConfig
from barn_sim.model import RobotModel
from barn_worlds.arrays import Floats

Triple = tuple[float, float, float]
Quaternion = tuple[float, float, float, float]

_SWEEPS = 100
_TOLERANCE = 1e-8  # of an impulse, in N s: 1e-9 m/s of the robot


class Tyres:
    """Four wheels of a robot on level ground at z = 0."""

    def __init__(self, model: RobotModel, config: PhysicsConfig) -> None:
        self._hubs = model.wheels - model.centre_of_mass
        self._radius = model.wheel_radius_m
        self._inverse_inertia = np.diag(1.0 / model.inertia)
        self._deflection_m = config.tyre_deflection_m
        share = model.mass_kg / len(model.wheels)
        stiffness = share * config.gravity_m_s2 / config.tyre_deflection_m
        damping = 2.0 * config.tyre_damping_ratio * math.sqrt(stiffness * share)
        self._numbers = np.array([config.tick_s, model.mass_kg, config.wheel_friction, stiffness, damping])
        self._impulses = np.zeros((len(model.wheels), 2))
        self._force = np.zeros(3)
        self._torque = np.zeros(3)

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

    def act(
        self, position: Triple, orientation: Quaternion, velocity: Triple, spin: Triple, left: float, right: float
    ) -> tuple[Floats, Floats]:
        """Return force (3,) in N and torque (3,) in N m about the centre of mass, both in the world frame.

        position, orientation (x, y, z, w), velocity, spin: of the centre of mass in the world frame, before the step;
        left, right: speed of the wheel rims in m/s. The next call overwrites the arrays.
        """
        wheels = (self._hubs, self._radius, self._inverse_inertia, self._numbers, self._impulses)
        ground_forces(position, orientation, velocity, spin, left, right, *wheels, self._force, self._torque)
        return self._force, self._torque


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
def ground_forces(
    position: Triple,
    orientation: Quaternion,
    velocity: Triple,
    spin: Triple,
    left: float,
    right: float,
    hubs: Floats,
    radius: float,
    inverse_inertia: Floats,
    numbers: Floats,
    impulses: Floats,
    force: Floats,
    torque: Floats,
) -> None:
    """Fill `force` and `torque` (3,); see `Tyres.act`. `impulses` (4, 2) N s: the last solution, then the new one."""
    tick, mass, friction, stiffness, damping = numbers
    turn = rotation(orientation)
    inverse = turn @ inverse_inertia @ turn.T
    arms, loads = wheel_loads(position[2], turn, velocity[2], spin, hubs, radius, stiffness, damping)
    force[:] = 0.0
    torque[:] = 0.0
    for i in range(len(hubs)):
        force[2] += loads[i]
        torque[0] += arms[i, 1] * loads[i]
        torque[1] -= arms[i, 0] * loads[i]
    motion = np.empty(5)  # vx, vy and spin after the step, without friction
    motion[0], motion[1] = velocity[0], velocity[1]
    motion[2:] = np.array(spin) + tick * (inverse @ torque)
    solve_friction(motion, left, right, arms, friction * tick * loads, turn, inverse, 1.0 / mass, impulses)
    for i in range(len(hubs)):
        fx, fy = impulses[i, 0] / tick, impulses[i, 1] / tick
        force[0] += fx
        force[1] += fy
        torque[0] -= arms[i, 2] * fy
        torque[1] += arms[i, 2] * fx
        torque[2] += arms[i, 0] * fy - arms[i, 1] * fx


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
    axle = turn[:, 1]
    level = math.sqrt(max(1.0 - axle[2] * axle[2], 1e-12))
    for i in range(count):
        arms[i] = turn @ hubs[i]
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
    rolling = np.array([turn[1, 1], -turn[0, 1]])
    rolling /= max(math.hypot(rolling[0], rolling[1]), 1e-12)
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
            x, y, z = arms[i]
            slip_x = motion[0] + motion[3] * z - motion[4] * y - rim * rolling[0]
            slip_y = motion[1] + motion[4] * x - motion[2] * z - rim * rolling[1]
            old_x, old_y = impulses[i]
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
    x, y, z = arm
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
    length = math.hypot(impulse[0], impulse[1])
    if length > limit:
        impulse *= limit / length
