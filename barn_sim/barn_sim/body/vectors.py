"""Vectors, quaternions (x, y, z, w) and matrices as tuples, for compiled code."""

from barn_worlds.base.arrays import Floats, kernel

# Tuples live in registers, where small arrays would be allocated anew each time.
Vector = tuple[float, float, float]
Quaternion = tuple[float, float, float, float]
Matrix = tuple[Vector, Vector, Vector]
# Position, attitude, velocity and spin of a body in the world frame.
BodyState = tuple[Vector, Quaternion, Vector, Vector]


@kernel
def vector(values: Floats) -> Vector:
    """Return the first three numbers of an array as a tuple."""
    return values[0], values[1], values[2]


@kernel
def quaternion(values: Floats) -> Quaternion:
    """Return the first four numbers of an array as a tuple."""
    return values[0], values[1], values[2], values[3]


@kernel
def fill(values: Floats, numbers: tuple[float, ...]) -> None:
    """Copy numbers of a tuple into an array in place, as many as the array holds.

    Args:
        values: Array (n,) to write to.
        numbers: At least n numbers.
    """
    for k in range(len(values)):
        values[k] = numbers[k]


@kernel
def dot(a: Vector, b: Vector) -> float:
    """Return the scalar product of two vectors."""
    return a[0] * b[0] + a[1] * b[1] + a[2] * b[2]


@kernel
def cross(a: Vector, b: Vector) -> Vector:
    """Return the vector product a x b."""
    return (
        a[1] * b[2] - a[2] * b[1],
        a[2] * b[0] - a[0] * b[2],
        a[0] * b[1] - a[1] * b[0],
    )


@kernel
def multiply(a: Quaternion, b: Quaternion) -> Quaternion:
    """Return the quaternion product a b, which rotates by b first and then by a."""
    return (
        a[3] * b[0] + a[0] * b[3] + a[1] * b[2] - a[2] * b[1],
        a[3] * b[1] + a[1] * b[3] + a[2] * b[0] - a[0] * b[2],
        a[3] * b[2] + a[2] * b[3] + a[0] * b[1] - a[1] * b[0],
        a[3] * b[3] - a[0] * b[0] - a[1] * b[1] - a[2] * b[2],
    )


@kernel
def rotation(q: Quaternion) -> Matrix:
    """Return the matrix from body to world of a unit quaternion (x, y, z, w)."""
    # A unit quaternion is assumed: `rotate` normalizes after every tick.
    x, y, z, w = q
    return (
        (1 - 2 * (y * y + z * z), 2 * (x * y - w * z), 2 * (x * z + w * y)),
        (2 * (x * y + w * z), 1 - 2 * (x * x + z * z), 2 * (y * z - w * x)),
        (2 * (x * z - w * y), 2 * (y * z + w * x), 1 - 2 * (x * x + y * y)),
    )


@kernel
def transform(matrix: Matrix, v: Vector) -> Vector:
    """Return the product of a matrix and a column vector."""
    return dot(matrix[0], v), dot(matrix[1], v), dot(matrix[2], v)


@kernel
def transpose(matrix: Matrix) -> Matrix:
    """Return the transpose of a matrix."""
    (xx, xy, xz), (yx, yy, yz), (zx, zy, zz) = matrix
    return (xx, yx, zx), (xy, yy, zy), (xz, yz, zz)
