"""Meshes for PyBullet's renderer: vertices, indices of triangles, and normals."""

from collections.abc import Sequence
from typing import TypeAlias

import numpy as np

from barn_worlds.base.arrays import Points, unit_vectors
from barn_worlds.geometry.polygon import Corner

Mesh: TypeAlias = dict[str, list[list[float]] | list[int]]

# Sides of the prism that stands for a round pillar.
_SIDES = 14


def prism(corners: Sequence[Corner], height_m: float) -> Mesh:
    """Return the closed mesh of an upright prism about the origin, with flat faces.

    Args:
        corners: Convex outline (k, 2) about the prism's center, counter-clockwise, m.
        height_m: Height, half of it above the center.
    """
    outline = np.asarray(corners, np.float64)
    count = len(outline)
    low = np.column_stack([outline, np.full(count, -0.5 * height_m)])
    high = np.column_stack([outline, np.full(count, 0.5 * height_m)])
    faces = [low[::-1], high]
    for k in range(count):
        following = (k + 1) % count
        faces.append(np.array([low[k], low[following], high[following], high[k]]))

    vertices: list[list[float]] = []
    indices: list[int] = []
    normals: list[list[float]] = []
    for face in faces:
        # A fan of triangles; vertices are not shared, so that edges look sharp.
        first = len(vertices)
        for k in range(1, len(face) - 1):
            indices += [first, first + k, first + k + 1]
        normal = np.cross(face[1] - face[0], face[2] - face[1])
        normal = normal / np.linalg.norm(normal)
        vertices += face.tolist()
        normals += [normal.tolist()] * len(face)
    return {"vertices": vertices, "indices": indices, "normals": normals}


def pillars(centers_m: Points, radius_m: float, height_m: float) -> Mesh:
    """Return one mesh of upright cylinders that stand on the ground, without bottoms.

    Args:
        centers_m: Centers (k, 2), m.
        radius_m: Radius of each.
        height_m: Height of each, from the ground.
    """
    circle = unit_vectors(np.linspace(0.0, 2.0 * np.pi, _SIDES, endpoint=False))
    zeros = np.zeros((_SIDES, 1))
    heights = np.full((_SIDES, 1), height_m)

    # Vertices: the rim below, the rim above twice, since the normals of side and top
    # differ, and the middle of the top.
    rims = [
        np.hstack([radius_m * circle, level]) for level in (zeros, heights, heights)
    ]
    pillar = np.vstack([*rims, [[0.0, 0.0, height_m]]])
    outwards = np.hstack([circle, zeros])
    upwards = np.tile([0.0, 0.0, 1.0], (_SIDES + 1, 1))
    normals = np.vstack([outwards, outwards, upwards])

    start = np.arange(_SIDES)
    end = (start + 1) % _SIDES
    middle = np.full(_SIDES, 3 * _SIDES)
    lower_halves = np.column_stack([start, end, end + _SIDES])
    upper_halves = np.column_stack([start, end + _SIDES, start + _SIDES])
    tops = np.column_stack([start + 2 * _SIDES, end + 2 * _SIDES, middle])
    faces = np.vstack([lower_halves, upper_halves, tops])

    count = len(centers_m)
    shifts = np.column_stack([centers_m, np.zeros(count)])
    offsets = len(pillar) * np.arange(count)[:, None, None]
    return {
        "vertices": (shifts[:, None] + pillar).reshape(-1, 3).tolist(),
        "indices": (offsets + faces).ravel().tolist(),
        "normals": np.tile(normals, (count, 1)).tolist(),
    }
