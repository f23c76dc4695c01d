"""Positions and rotations in space, relative to a parent frame."""

import math
from dataclasses import dataclass, field
from functools import partial

import numpy as np

from barn_worlds.base.arrays import Floats


@dataclass(frozen=True, eq=False)
class Transform:
    """A position (3,) in meters and a rotation matrix (3, 3) in a parent frame."""

    offset: Floats = field(default_factory=partial(np.zeros, 3))
    rotation: Floats = field(default_factory=partial(np.eye, 3))

    def __matmul__(self, inner: "Transform") -> "Transform":
        """Return `inner`, a transform in this frame, in the parent frame."""
        return Transform(
            self.offset + self.rotation @ inner.offset, self.rotation @ inner.rotation
        )

    def inverse(self) -> "Transform":
        """Return the transform of the parent frame in this one."""
        # The transpose of a rotation is its inverse.
        return Transform(-self.rotation.T @ self.offset, self.rotation.T)

    @property
    def tilt_rad(self) -> float:
        """Angle between the z axis, up or down, and that of the parent frame."""
        return math.asin(min(1.0, math.hypot(*self.rotation[:2, 2])))

    @property
    def yaw_rad(self) -> float:
        """Direction of the x axis in the plane of the parent frame."""
        return math.atan2(self.rotation[1, 0], self.rotation[0, 0])


def rotation_matrix(roll: float, pitch: float, yaw: float) -> Floats:
    """Return the matrix (3, 3) of roll, pitch, then yaw (rad) about fixed axes.

    Args:
        roll: First rotation, about x, in radians.
        pitch: Second rotation, about y, in radians.
        yaw: Third rotation, about z, in radians.
    """
    matrix = np.eye(3)
    # Axes are fixed, so each further rotation multiplies from the left.
    for axis, angle in enumerate((roll, pitch, yaw)):
        i = (axis + 1) % 3
        j = (axis + 2) % 3
        rotation = np.eye(3)
        rotation[i, i] = rotation[j, j] = math.cos(angle)
        rotation[j, i] = math.sin(angle)
        rotation[i, j] = -math.sin(angle)
        matrix = rotation @ matrix
    return matrix


def quaternion_matrix(x: float, y: float, z: float, w: float) -> Floats:
    """Return the matrix (3, 3) of a quaternion, of any length but 0."""
    axis = np.array([x, y, z])
    cross = np.array([[0.0, -z, y], [z, 0.0, -x], [-y, x, 0.0]])
    # Rodrigues' formula, by cosine and sine of half the angle.
    matrix: Floats = (w * w - axis @ axis) * np.eye(3)
    matrix += 2.0 * (np.outer(axis, axis) + w * cross)
    matrix /= axis @ axis + w * w
    return matrix
