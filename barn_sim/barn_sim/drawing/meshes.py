"""Closed meshes for PyBullet: vertices, indices and normals."""

from collections.abc import Sequence
from typing import Any

import numpy as np

from barn_worlds.base.arrays import Floats
from barn_worlds.geometry.polygon import Corner

_SIDES = 14  # of a pillar


def prism(corners: Sequence[Corner], height_m: float) -> dict[str, list[Any]]:
    """Return an upright prism of convex corners (k, 2) about its middle as a closed mesh with a normal to each face."""
    around = np.asarray(corners, np.float64)
    low, high = (np.column_stack([around, np.full(len(around), level)]) for level in (-0.5 * height_m, 0.5 * height_m))
    faces = [low[::-1], high]
    following = np.roll(np.arange(len(around)), -1)
    faces += [np.array([low[k], low[n], high[n], high[k]]) for k, n in enumerate(following)]
    made: dict[str, list[Any]] = {"vertices": [], "indices": [], "normals": []}
    for face in faces:
        across, first = np.cross(face[1] - face[0], face[2] - face[1]), len(made["vertices"])
        made["indices"] += [i for k in range(1, len(face) - 1) for i in (first, first + k, first + k + 1)]
        made["vertices"] += face.tolist()
        made["normals"] += [(across / np.linalg.norm(across)).tolist()] * len(face)
    return made


def pillars(centres_m: Floats, radius_m: float, height_m: float) -> dict[str, list[Any]]:
    """Return upright cylinders at centres (k, 2) as one mesh of sides and tops, with vertices, indices and normals."""
    angles = np.linspace(0.0, 2.0 * np.pi, _SIDES, endpoint=False)
    around = np.column_stack([np.cos(angles), np.sin(angles)])
    low, high = np.zeros((_SIDES, 1)), np.full((_SIDES, 1), height_m)
    rim = [np.hstack([radius_m * around, level]) for level in (low, high, high)]
    one = np.vstack([*rim, [[0.0, 0.0, height_m]]])
    outwards, upwards = np.hstack([around, low]), np.tile([0.0, 0.0, 1.0], (_SIDES + 1, 1))
    normals = np.vstack([outwards, outwards, upwards])
    here = np.arange(_SIDES)
    after, last = (here + 1) % _SIDES, np.full(_SIDES, 3 * _SIDES)
    sides = [(here, after, after + _SIDES), (here, after + _SIDES, here + _SIDES)]
    tops = [(here + 2 * _SIDES, after + 2 * _SIDES, last)]
    faces = np.vstack([np.column_stack(corners) for corners in sides + tops])
    shifts = np.column_stack([centres_m, np.zeros(len(centres_m))])
    return {
        "vertices": (shifts[:, None] + one).reshape(-1, 3).tolist(),
        "indices": (len(one) * np.arange(len(centres_m))[:, None, None] + faces).ravel().tolist(),
        "normals": np.tile(normals, (len(centres_m), 1)).tolist(),
    }
