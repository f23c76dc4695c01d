"""Rotations as quaternions x, y, z, w, Euler angles and 4 x 4 matrices."""

import math
import warnings

import numpy as np
from scipy.spatial.transform import Rotation, Slerp


def identity_matrix():
    """Return the transform that moves nothing."""
    return np.eye(4)


def translation_matrix(direction):
    """Return the transform that moves by x, y, z."""
    matrix = np.eye(4)
    matrix[:3, 3] = direction[:3]
    return matrix


def translation_from_matrix(matrix):
    """Return by what x, y, z a transform moves."""
    return np.array(matrix)[:3, 3]


def inverse_matrix(matrix):
    """Return the transform back."""
    return np.linalg.inv(matrix)


def concatenate_matrices(*matrices):
    """Return the product of transforms."""
    product = np.eye(4)
    for matrix in matrices:
        product = product @ matrix
    return product


def vector_norm(data, axis=None):
    """Return the length of vectors."""
    return np.linalg.norm(data, axis=axis)


def unit_vector(data, axis=None):
    """Return vectors of length 1."""
    return data / np.linalg.norm(data, axis=axis, keepdims=axis is not None)


def quaternion_about_axis(angle, axis):
    """Return the rotation by an angle about an axis."""
    return np.array([*math.sin(angle / 2.0) * unit_vector(axis), math.cos(angle / 2.0)])


def quaternion_multiply(quaternion1, quaternion0):
    """Return the product of two quaternions."""
    x, y, z, w = quaternion1
    factor = np.array([[w, -z, y, x], [z, w, -x, y], [-y, x, w, z], [-x, -y, -z, w]])
    return factor @ quaternion0


def quaternion_conjugate(quaternion):
    """Return the rotation the other way."""
    return np.array(quaternion) * (-1.0, -1.0, -1.0, 1.0)


def quaternion_inverse(quaternion):
    """Return the inverse of a quaternion of any length."""
    return quaternion_conjugate(quaternion) / np.dot(quaternion, quaternion)


def quaternion_slerp(quat0, quat1, fraction):
    """Return the rotation at a fraction of the shorter way between two."""
    return Slerp((0.0, 1.0), Rotation.from_quat([quat0, quat1]))(fraction).as_quat()


def random_quaternion():
    """Return a rotation, all equally likely."""
    return Rotation.random().as_quat()


def quaternion_matrix(quaternion):
    """Return the 4 x 4 matrix of a rotation."""
    matrix = np.eye(4)
    matrix[:3, :3] = Rotation.from_quat(quaternion).as_matrix()
    return matrix


def quaternion_from_matrix(matrix):
    """Return the rotation of a matrix, with w of 0 or more."""
    quaternion = Rotation.from_matrix(np.asarray(matrix)[:3, :3]).as_quat()
    return -quaternion if quaternion[3] < 0.0 else quaternion


def rotation_matrix(angle, direction, point=None):
    """Return the transform that turns about an axis, through a point."""
    matrix = quaternion_matrix(quaternion_about_axis(angle, direction[:3]))
    if point is not None:
        matrix[:3, 3] = point[:3] - matrix[:3, :3] @ point[:3]
    return matrix


def _sequence(axes):
    """Return scipy's name of axes that stand still (s) or turn along (r)."""
    return axes[1:].upper() if axes[0] == "r" else axes[1:]


def quaternion_from_euler(ai, aj, ak, axes="sxyz"):
    """Return the rotation by three angles, with w of 0 or more."""
    quaternion = Rotation.from_euler(_sequence(axes), (ai, aj, ak)).as_quat()
    return -quaternion if quaternion[3] < 0.0 else quaternion


def euler_matrix(ai, aj, ak, axes="sxyz"):
    """Return the 4 x 4 matrix of the rotation by three angles."""
    return quaternion_matrix(quaternion_from_euler(ai, aj, ak, axes))


def euler_from_quaternion(quaternion, axes="sxyz"):
    """Return the three angles of a rotation."""
    with warnings.catch_warnings():
        # Where two axes coincide, any split between their angles is right.
        warnings.simplefilter("ignore")
        return tuple(Rotation.from_quat(quaternion).as_euler(_sequence(axes)))


def euler_from_matrix(matrix, axes="sxyz"):
    """Return the three angles of a rotation matrix."""
    return euler_from_quaternion(quaternion_from_matrix(matrix), axes)
