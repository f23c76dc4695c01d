"""Rotations and transforms, against what they do to points."""

import math

import numpy as np
import pytest

from barn_worlds.geometry.transform import Transform, quaternion_matrix, rotation_matrix


def test_a_rotation_is_about_fixed_axes():
    left = rotation_matrix(0.0, 0.0, 0.5 * math.pi) @ [1.0, 0.0, 0.0]
    assert left == pytest.approx([0.0, 1.0, 0.0])
    turned = rotation_matrix(0.3, -0.2, 0.5)
    assert turned @ turned.T == pytest.approx(np.eye(3))
    assert turned[2, 0] == pytest.approx(math.sin(0.2))


def test_a_quaternion_turns_as_angles_do():
    for axis in range(3):
        angles = [0.0, 0.0, 0.0]
        angles[axis] = 0.7
        quaternion = [0.0, 0.0, 0.0, math.cos(0.35)]
        quaternion[axis] = math.sin(0.35)
        # Its length does not matter.
        turned = quaternion_matrix(*(3.0 * np.array(quaternion)))
        assert turned == pytest.approx(rotation_matrix(*angles))


def test_a_transform_and_its_inverse_cancel():
    pose = Transform(np.array([1.0, 2.0, 3.0]), rotation_matrix(0.3, -0.2, 0.5))
    back = pose.inverse() @ pose
    assert back.offset == pytest.approx(np.zeros(3))
    assert back.rotation == pytest.approx(np.eye(3))
