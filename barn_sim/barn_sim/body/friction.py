"""Coulomb friction of wheels whose rim speeds are given; `barn_sim.body.tires` says what is solved, and why here."""

import math

from numba import njit

from barn_sim.body.free_motion import Matrix, Triple
from barn_worlds.base.arrays import Floats

SWEEPS = 100
TOLERANCE = 1e-8  # of an impulse, in N s: 1e-9 m/s of the Jackal
_SURELY = 1.0 - 1e-12  # more than squares are rounded by
_TINY, _HUGE, _NOTHING = 2.0**-459, 2.0**511, 2.0**-54  # of `hypot`

Levers = tuple[float, float, float, float, float, float]
Rims = tuple[float, float, float, float]
Motion = tuple[float, float, float, float, float]


@njit(cache=True, error_model="numpy", forceinline=True)
def begin_friction(
    motion: Motion, left: float, right: float, arms: Floats, limits: Floats, turn: Matrix, inverse: Matrix,
    inverse_mass: float, impulses: Floats, work: Floats,
) -> tuple[Motion, Rims]:  # fmt: skip
    """Begin to find the friction impulses (n, 2) of the wheels, from those of the last tick, which are replaced.

    limits (n,): largest impulse of each wheel, N s. Returns the motion with the effect of the impulses, and how fast
    the rims go: along x left, right, along y left, right. Fills in rows of `work` (n, 8): levers and the step, as
    `levers_of` has them, and the square of a length surely allowed.
    """
    length = max(hypot(turn[1][1], -turn[0][1]), 1e-12)
    rolling_x, rolling_y = turn[1][1] / length, -turn[0][1] / length
    for i in range(len(arms)):
        row, arm = work[i], (arms[i, 0], arms[i, 1], arms[i, 2])
        row[6], levers = levers_of(arm, inverse, inverse_mass)
        row[0], row[1], row[2], row[3], row[4], row[5] = levers
        row[7] = _SURELY * limits[i] * limits[i]
        x, y = _clipped(impulses[i, 0], impulses[i, 1], limits[i], row[7])
        impulses[i, 0], impulses[i, 1] = x, y
        motion = after(motion, row, inverse_mass, x, y)
    return motion, (
        left * rolling_x,
        right * rolling_x,
        left * rolling_y,
        right * rolling_y,
    )


@njit(cache=True, error_model="numpy")
def sweep_friction(
    motion: Motion,
    rims: Rims,
    arms: Floats,
    limits: Floats,
    inverse_mass: float,
    impulses: Floats,
    work: Floats,
) -> Motion:
    """Improve the impulses until they hardly change any more; return the motion."""
    vx, vy, wx, wy, wz = motion
    for _ in range(SWEEPS):
        largest = 0.0
        for i in range(len(arms)):
            row, x, y, z = work[i], arms[i, 0], arms[i, 1], arms[i, 2]
            slip_x = vx + wy * z - wz * y - rims[i % 2]
            slip_y = vy + wz * x - wx * z - rims[2 + i % 2]
            old_x, old_y = impulses[i, 0], impulses[i, 1]
            new_x, new_y = _clipped(
                old_x - row[6] * slip_x, old_y - row[6] * slip_y, limits[i], row[7]
            )
            impulses[i, 0], impulses[i, 1] = new_x, new_y
            change_x, change_y = new_x - old_x, new_y - old_y
            vx, vy, wx, wy, wz = after(
                (vx, vy, wx, wy, wz), row, inverse_mass, change_x, change_y
            )
            largest = max(largest, abs(change_x), abs(change_y))
        if largest < TOLERANCE:
            break
    return vx, vy, wx, wy, wz


@njit(cache=True, error_model="numpy", forceinline=True)
def levers_of(
    arm: Triple, inverse: Matrix, inverse_mass: float
) -> tuple[float, Levers]:
    """Return step and levers of a wheel.

    The step is the inverse of the largest eigenvalue of the contact's 2 x 2 matrix. Levers are the change of spin
    about x, y and z per impulse along x and along y in turn.
    """
    x, y, z = arm
    (xx, xy, xz), (yx, yy, yz), (zx, zy, zz) = inverse
    levers = (
        xy * z - xz * y, xz * x - xx * z, yy * z - yz * y, yz * x - yx * z, zy * z - zz * y, zz * x - zx * z,
    )  # fmt: skip
    a = inverse_mass + levers[2] * z - levers[4] * y
    b = levers[3] * z - levers[5] * y
    c = inverse_mass + levers[5] * x - levers[1] * z
    largest: float = 0.5 * (a + c) + hypot(0.5 * (a - c), b)
    return 1.0 / largest, levers


@njit(cache=True, inline="always")
def after(
    motion: Motion, row: Floats | Levers, inverse_mass: float, x: float, y: float
) -> Motion:
    """Return the motion after an impulse; row: levers of the wheel."""
    vx, vy, wx, wy, wz = motion
    wx, wy, wz = (
        wx + (row[0] * x + row[1] * y),
        wy + (row[2] * x + row[3] * y),
        wz + (row[4] * x + row[5] * y),
    )
    return vx + inverse_mass * x, vy + inverse_mass * y, wx, wy, wz


@njit(cache=True, error_model="numpy", forceinline=True)
def _clipped(x: float, y: float, limit: float, surely: float) -> tuple[float, float]:
    """Return an impulse, shortened to the limit; surely: square of a length that needs no closer look."""
    if x * x + y * y < surely:
        return x, y
    length = hypot(x, y)
    if length > limit:
        return x * (limit / length), y * (limit / length)
    return x, y


@njit(cache=True, error_model="numpy", forceinline=True)
def clipped_abreast(
    x: float, y: float, limit: float, surely: float
) -> tuple[float, float, bool]:
    """Return what `_clipped` does, without a branch, and whether it is right: not where lengths are tiny or huge."""
    squared = x * x + y * y
    length, right = _hypot_abreast(x, y)
    beyond, allowed = length > limit, squared < surely
    scale = limit / length
    scale = scale if beyond & (not allowed) else 1.0
    return x * scale, y * scale, allowed | right


@njit(cache=True, error_model="numpy")
def hypot(x: float, y: float) -> float:
    """Return the length of a vector to within a unit in the last place.

    The algorithm is that of the C library of GNU since 2.35 without fused operations (Borges, "An improved algorithm
    for hypot(a,b)", arXiv:1904.09481), here without a call and the same on every processor.
    """
    length, right = _hypot_abreast(x, y)
    return length if right else math.hypot(x, y)


@njit(cache=True, error_model="numpy", forceinline=True)
def _hypot_abreast(x: float, y: float) -> tuple[float, bool]:
    """Return what `hypot` does, without a branch, and whether it is right: not where it is tiny or huge."""
    across, along = abs(x), abs(y)
    low = across if across < along else along
    high = along if across < along else across
    length = math.sqrt(x * x + y * y)
    steep, flat = length - low, length - high
    steep_error = high * (2.0 * steep - high) + (steep - 2.0 * (high - low)) * steep
    flat_error = 2.0 * flat * (high - 2.0 * low) + (
        (4.0 * flat - low) * low + flat * flat
    )
    error = steep_error if length <= 2.0 * low else flat_error
    length = length - error / (2.0 * length)
    length = high + low if low <= high * _NOTHING else length
    return length, ((low >= _TINY) | (low == 0.0)) & (high <= _HUGE)
