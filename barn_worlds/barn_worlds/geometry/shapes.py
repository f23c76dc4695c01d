"""Upright cylinders and boxes seen from above as rows of an array, as `geometry.kernels` takes them."""

import numpy as np

from barn_worlds.base.arrays import Floats, Points
from barn_worlds.geometry.bodies import Bodies


def shape_rows(centres: Points, radius_m: Floats, size_m: Points, yaw_rad: Floats) -> Floats:
    """Return shapes (n, 7) of centres (n, 2), radii (n,) of cylinders, sizes (n, 2) of boxes and headings (n,)."""
    sides = np.column_stack([np.cos(yaw_rad), np.sin(yaw_rad)])
    return np.column_stack([centres, radius_m, 0.5 * size_m, sides])


def body_shapes(bodies: Bodies) -> Floats:
    """Return bodies as shapes (n, 7)."""
    return shape_rows(bodies.poses[:, :2], bodies.radius_m, bodies.size_m, bodies.poses[:, 2])
