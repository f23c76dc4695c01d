"""Motion of a free rigid body, operation by operation as Bullet integrates it in double precision.

A body that touches nothing moves under the forces applied and its own inertia alone. These kernels repeat what
btRigidBody, btSequentialImpulseConstraintSolver and btTransformUtil do then (Bullet 3.27, no damping), with every sum
in the same order. So they give the same bits, and a body can change between Bullet and these kernels at any tick.

Bullet stores the attitude as a matrix. It makes that matrix from a quaternion after each tick, and a quaternion from
the matrix whenever one is asked for, which is not the same to the last bit. Here the first is called the `heading`,
from which all else follows, the second the `attitude`. Quaternions are x, y, z, w.
"""

import math

from numba import njit

from barn_worlds.base.arrays import Floats

Triple = tuple[float, float, float]
Quaternion = tuple[float, float, float, float]
Matrix = tuple[Triple, Triple, Triple]

_EPSILON = 2.0**-52
_SLOW = 0.001  # rad/s below which the sine is replaced by its series
_LARGEST_TURN = 0.25 * math.pi  # rad in a tick
_CANDIDATES = 4096


@njit(cache=True, error_model="numpy")
def basis_of(heading: Quaternion) -> Matrix:
    """Return the matrix of a quaternion of any length (btMatrix3x3::setRotation)."""
    x, y, z, w = heading
    s = 2.0 / (x * x + y * y + z * z + w * w)
    xs, ys, zs = x * s, y * s, z * s
    wx, wy, wz = w * xs, w * ys, w * zs
    xx, xy, xz = x * xs, x * ys, x * zs
    yy, yz, zz = y * ys, y * zs, z * zs
    return (
        (1.0 - (yy + zz), xy - wz, xz + wy),
        (xy + wz, 1.0 - (xx + zz), yz - wx),
        (xz - wy, yz + wx, 1.0 - (xx + yy)),
    )


@njit(cache=True, error_model="numpy")
def attitude_of(basis: Matrix) -> Quaternion:
    """Return the quaternion of a matrix (btMatrix3x3::getRotation)."""
    (xx, xy, xz), (yx, yy, yz), (zx, zy, zz) = basis
    trace = xx + yy + zz
    if trace > 0.0:
        s = math.sqrt(trace + 1.0)
        return (
            (zy - yz) * (0.5 / s),
            (xz - zx) * (0.5 / s),
            (yx - xy) * (0.5 / s),
            s * 0.5,
        )
    largest = 2 if max(xx, yy) < zz else 1 if xx < yy else 0
    if largest == 0:
        s = math.sqrt(xx - yy - zz + 1.0)
        return (
            s * 0.5,
            (yx + xy) * (0.5 / s),
            (zx + xz) * (0.5 / s),
            (zy - yz) * (0.5 / s),
        )
    if largest == 1:
        s = math.sqrt(yy - zz - xx + 1.0)
        return (
            (xy + yx) * (0.5 / s),
            s * 0.5,
            (zy + yz) * (0.5 / s),
            (xz - zx) * (0.5 / s),
        )
    s = math.sqrt(zz - xx - yy + 1.0)
    return (xz + zx) * (0.5 / s), (yz + zy) * (0.5 / s), s * 0.5, (yx - xy) * (0.5 / s)


@njit(cache=True, error_model="numpy")
def turned(attitude: Quaternion, spin: Triple, tick: float) -> Quaternion:
    """Return the heading after a tick with this spin in rad/s (btTransformUtil::integrateTransform)."""
    squared = spin[0] * spin[0] + spin[1] * spin[1] + spin[2] * spin[2]
    rate = math.sqrt(squared) if squared > _EPSILON else 0.0
    rate = _LARGEST_TURN / tick if rate * tick > _LARGEST_TURN else rate
    half = 0.5 * rate * tick
    series = 0.5 * tick - (tick * tick * tick) * 0.020833333333 * rate * rate
    part = series if rate < _SLOW else math.sin(half) / rate
    q = _product(
        (spin[0] * part, spin[1] * part, spin[2] * part, math.cos(half)), attitude
    )
    squared = q[0] * q[0] + q[1] * q[1] + q[2] * q[2] + q[3] * q[3]
    s = 1.0 / math.sqrt(squared) if squared > _EPSILON else 1.0
    return q[0] * s, q[1] * s, q[2] * s, q[3] * s


@njit(cache=True, error_model="numpy")
def _product(a: Quaternion, b: Quaternion) -> Quaternion:
    return (
        a[3] * b[0] + a[0] * b[3] + a[1] * b[2] - a[2] * b[1],
        a[3] * b[1] + a[1] * b[3] + a[2] * b[0] - a[0] * b[2],
        a[3] * b[2] + a[2] * b[3] + a[0] * b[1] - a[1] * b[0],
        a[3] * b[3] - a[0] * b[0] - a[1] * b[1] - a[2] * b[2],
    )


@njit(cache=True, error_model="numpy")
def _rotated(q: Quaternion, v: Triple) -> Triple:
    half = (
        q[3] * v[0] + q[1] * v[2] - q[2] * v[1],
        q[3] * v[1] + q[2] * v[0] - q[0] * v[2],
        q[3] * v[2] + q[0] * v[1] - q[1] * v[0],
        -q[0] * v[0] - q[1] * v[1] - q[2] * v[2],
    )
    whole = _product(half, (-q[0], -q[1], -q[2], q[3]))
    return whole[0], whole[1], whole[2]


@njit(cache=True, error_model="numpy")
def _cross(a: Triple, b: Triple) -> Triple:
    return (
        a[1] * b[2] - a[2] * b[1],
        a[2] * b[0] - a[0] * b[2],
        a[0] * b[1] - a[1] * b[0],
    )


@njit(cache=True, error_model="numpy")
def _dot(a: Triple, b: Triple) -> float:
    return a[0] * b[0] + a[1] * b[1] + a[2] * b[2]


@njit(cache=True, error_model="numpy")
def _gyration(
    attitude: Quaternion, spin: Triple, inverse_inertia: Triple, tick: float
) -> Triple:
    """Return the change of the spin in a tick by the body's own inertia (computeGyroscopicImpulseImplicit_Body)."""
    ix, iy, iz = (
        1.0 / inverse_inertia[0],
        1.0 / inverse_inertia[1],
        1.0 / inverse_inertia[2],
    )
    x, y, z = _rotated((-attitude[0], -attitude[1], -attitude[2], attitude[3]), spin)
    ax, ay, az = ix * x, iy * y, iz * z
    residual = _cross((x, y, z), (ax, ay, az))
    residual = residual[0] * tick, residual[1] * tick, residual[2] * tick
    # columns of the Jacobian: inertia + (skew(spin) inertia - skew(angular momentum)) tick
    first = ix, (z * ix - az) * tick, (-y * ix + ay) * tick
    second = (-z * iy + az) * tick, iy, (x * iy - ax) * tick
    third = (y * iz - ay) * tick, (-x * iz + ax) * tick, iz
    normal = _cross(second, third)
    scale = _dot(first, normal)
    scale = 1.0 / scale if abs(scale) > _EPSILON else scale
    u, v = scale * _dot(residual, normal), scale * _dot(first, _cross(residual, third))
    after = _rotated(
        attitude, (x - u, y - v, z - scale * _dot(first, _cross(second, residual)))
    )
    return after[0] - spin[0], after[1] - spin[1], after[2] - spin[2]


@njit(cache=True, error_model="numpy")
def world_tensor(basis: Matrix, inverse: Triple) -> Matrix:
    """Return the inverse inertia in the world frame (btRigidBody::updateInertiaTensor)."""
    rows = times(basis[0], inverse), times(basis[1], inverse), times(basis[2], inverse)
    return (
        (_dot(basis[0], rows[0]), _dot(basis[1], rows[0]), _dot(basis[2], rows[0])),
        (_dot(basis[0], rows[1]), _dot(basis[1], rows[1]), _dot(basis[2], rows[1])),
        (_dot(basis[0], rows[2]), _dot(basis[1], rows[2]), _dot(basis[2], rows[2])),
    )


@njit(cache=True, error_model="numpy")
def times(a: Triple, b: Triple) -> Triple:
    """Return the products of numbers in one place."""
    return a[0] * b[0], a[1] * b[1], a[2] * b[2]


@njit(cache=True, error_model="numpy")
def _seen_from(matrix: Matrix, vector: Triple) -> Triple:
    """Return the products of the columns of a matrix with a vector."""
    (xx, xy, xz), (yx, yy, yz), (zx, zy, zz) = matrix
    return (
        _dot((xx, yx, zx), vector),
        _dot((xy, yy, zy), vector),
        _dot((xz, yz, zz), vector),
    )


@njit(cache=True, error_model="numpy")
def spun(
    tensor: Matrix,
    attitude: Quaternion,
    spin: Triple,
    torque: Triple,
    inverse: Triple,
    tick: float,
) -> Triple:
    """Return the spin after a tick under a torque; tensor: inverse inertia in the world frame."""
    gyro = _gyration(attitude, spin, inverse, tick)
    x, y, z = _seen_from(tensor, torque)
    return (
        spin[0] + (x * tick + gyro[0]),
        spin[1] + (y * tick + gyro[1]),
        spin[2] + (z * tick + gyro[2]),
    )


@njit(cache=True)
def still_turning(
    attitude: Quaternion,
    spin: Triple,
    heading: Quaternion,
    stale: Quaternion,
    inverse: Triple,
    tick: float,
) -> tuple[bool, Triple]:
    """Find a torque under which a body in Bullet keeps its spin for a tick, which brings it to `heading`.

    attitude: before that tick; stale: heading whose inertia Bullet still has. Returns whether there is one, to the
    last bit of the matrix of the heading, and the torque; if there is none, one that keeps the spin but for rounding.
    """
    basis, tensor = basis_of(stale), world_tensor(basis_of(stale), inverse)
    wanted = basis_of(heading)
    gyro = _gyration(attitude, spin, inverse, tick)
    inertia = 1.0 / inverse[0], 1.0 / inverse[1], 1.0 / inverse[2]
    first = (0.0, 0.0, 0.0)
    for k in range(_CANDIDATES):
        # several nearly equal torques, of which one that rounds as wanted
        push = (
            _nudged(gyro[0], k, tick),
            _nudged(gyro[1], k // 16, tick),
            _nudged(gyro[2], k // 256, tick),
        )
        local = times(_seen_from(basis, push), inertia)
        torque = _dot(basis[0], local), _dot(basis[1], local), _dot(basis[2], local)
        after = spun(tensor, attitude, spin, torque, inverse, tick)
        if basis_of(turned(attitude, after, tick)) == wanted:
            return True, torque
        if k == 0:
            first = torque
    return False, first


@njit(cache=True)
def _nudged(gyro: float, k: int, tick: float) -> float:
    return -gyro / tick * (1.0 + _EPSILON * (k % 16 - 16 * (k % 16 > 8)))


@njit(cache=True)
def triple(values: Floats) -> Triple:
    """Return three numbers of an array as a tuple."""
    return values[0], values[1], values[2]


@njit(cache=True)
def quaternion(values: Floats) -> Quaternion:
    """Return four numbers of an array as a tuple."""
    return values[0], values[1], values[2], values[3]


@njit(cache=True)
def fill(values: Floats, given: tuple[float, ...]) -> None:
    """Write a tuple to an array of its length."""
    for k in range(len(values)):
        values[k] = given[k]
