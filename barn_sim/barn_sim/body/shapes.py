"""Upright cylinders and boxes of any size, seen from above, and their distances to the robot.

A shape is a row x, y (m, map frame), radius, half length and half width (m), cosine and sine of its heading. A cylinder
has half sizes 0, a box radius 0.
"""

import math

import numpy as np
from numba import njit

from barn_worlds.base.arrays import Floats, Points
from barn_worlds.geometry.bodies import Bodies


def shape_rows(centres: Points, radius_m: Floats, size_m: Points, yaw_rad: Floats) -> Floats:
    """Return shapes (n, 7) of centres (n, 2), radii (n,) of cylinders, sizes (n, 2) of boxes and headings (n,)."""
    sides = np.column_stack([np.cos(yaw_rad), np.sin(yaw_rad)])
    return np.column_stack([centres, radius_m, 0.5 * size_m, sides])


def body_shapes(bodies: Bodies) -> Floats:
    """Return bodies as shapes (n, 7)."""
    return shape_rows(bodies.poses[:, :2], bodies.radius_m, bodies.size_m, bodies.poses[:, 2])


@njit(cache=True)
def shape_gaps(shapes: Floats, x: float, y: float, yaw: float, extent: Floats) -> Floats:
    """Return the distances (n,) in m from the robot's rectangle to shapes (n, 7), 0 where they overlap.

    extent: x_min, y_min, x_max, y_max of the robot about its pose x, y, yaw.
    """
    gaps = np.empty(len(shapes))
    c, s = math.cos(yaw), math.sin(yaw)
    for i in range(len(shapes)):
        dx, dy = shapes[i, 0] - x, shapes[i, 1] - y
        ahead, left = c * dx + s * dy, c * dy - s * dx
        if shapes[i, 2] > 0.0:
            outside_x = max(extent[0] - ahead, 0.0, ahead - extent[2])
            outside_y = max(extent[1] - left, 0.0, left - extent[3])
            gaps[i] = max(0.0, math.hypot(outside_x, outside_y) - shapes[i, 2])
            continue
        # the box's sides in the robot's frame
        ux, uy = c * shapes[i, 5] + s * shapes[i, 6], c * shapes[i, 6] - s * shapes[i, 5]
        ahead -= 0.5 * (extent[0] + extent[2])
        left -= 0.5 * (extent[1] + extent[3])
        half_x, half_y = 0.5 * (extent[2] - extent[0]), 0.5 * (extent[3] - extent[1])
        gaps[i] = box_gap(ahead, left, ux, uy, shapes[i, 3], shapes[i, 4], half_x, half_y)
    return gaps


@njit(cache=True)
def box_gap(
    x: float, y: float, ux: float, uy: float, half_long: float, half_wide: float, half_x: float, half_y: float
) -> float:
    """Return the distance from a rectangle around the origin to one at x, y whose length lies along ux, uy; 0 inside.

    half_long, half_wide: of the other one; half_x, half_y: of that around the origin.
    """
    # apart along an axis of either: two convex shapes overlap unless one of these separates them
    wide_x, wide_y = abs(ux) * half_long + abs(uy) * half_wide, abs(uy) * half_long + abs(ux) * half_wide
    along, across = x * ux + y * uy, y * ux - x * uy
    long_reach, wide_reach = abs(ux) * half_x + abs(uy) * half_y, abs(uy) * half_x + abs(ux) * half_y
    overlap = abs(x) <= half_x + wide_x and abs(y) <= half_y + wide_y
    if overlap and abs(along) <= half_long + long_reach and abs(across) <= half_wide + wide_reach:
        return 0.0
    nearest = math.inf
    for k in range(4):
        i, j = 2.0 * (k % 2) - 1.0, 2.0 * (k // 2) - 1.0
        # a corner of the other one to the rectangle, and the other way round
        px, py = x + i * half_long * ux - j * half_wide * uy, y + i * half_long * uy + j * half_wide * ux
        nearest = min(nearest, math.hypot(max(abs(px) - half_x, 0.0), max(abs(py) - half_y, 0.0)))
        qx, qy = i * half_x - x, j * half_y - y
        own, other = qx * ux + qy * uy, qy * ux - qx * uy
        nearest = min(nearest, math.hypot(max(abs(own) - half_long, 0.0), max(abs(other) - half_wide, 0.0)))
    return nearest


@njit(cache=True)
def times_to_contact(
    shapes: Floats, velocities: Floats, x: float, y: float, yaw: float, speed: float, extent: Floats
) -> Floats:
    """Return when (n,) in s the robot's rectangle meets shapes (n, 7) if all keep their velocities, inf for never.

    velocities (n, 2): of the shapes, m/s; the robot goes straight ahead at `speed`. A box counts as the disc around it.
    """
    times = np.empty(len(shapes))
    c, s = math.cos(yaw), math.sin(yaw)
    half_x, half_y = 0.5 * (extent[2] - extent[0]), 0.5 * (extent[3] - extent[1])
    for i in range(len(shapes)):
        radius = shapes[i, 2] if shapes[i, 2] > 0.0 else math.hypot(shapes[i, 3], shapes[i, 4])
        dx, dy = shapes[i, 0] - x, shapes[i, 1] - y
        px, py = c * dx + s * dy - 0.5 * (extent[0] + extent[2]), c * dy - s * dx - 0.5 * (extent[1] + extent[3])
        vx = c * velocities[i, 0] + s * velocities[i, 1] - speed
        vy = c * velocities[i, 1] - s * velocities[i, 0]
        # the disc's centre meets the rectangle widened by its radius: two rectangles and a disc at every corner
        first = min(enters(px, py, vx, vy, half_x + radius, half_y), enters(px, py, vx, vy, half_x, half_y + radius))
        for k in range(4):
            qx, qy = px - (2.0 * (k % 2) - 1.0) * half_x, py - (2.0 * (k // 2) - 1.0) * half_y
            square, along, beyond = vx * vx + vy * vy, qx * vx + qy * vy, qx * qx + qy * qy - radius * radius
            root = along * along - square * beyond
            if beyond <= 0.0:
                first = 0.0
            elif root >= 0.0 and along < 0.0:
                first = min(first, (-along - math.sqrt(root)) / square)
        times[i] = first
    return times


@njit(cache=True)
def enters(px: float, py: float, vx: float, vy: float, half_x: float, half_y: float) -> float:
    """Return when a moving point enters a rectangle around the origin, 0 within it and inf for never.

    vx, vy: its velocity; of a unit vector, times are distances.
    """
    enter, leave = 0.0, math.inf
    for position, velocity, half in ((px, vx, half_x), (py, vy, half_y)):
        if velocity != 0.0:
            one, other = (-half - position) / velocity, (half - position) / velocity
            enter, leave = max(enter, min(one, other)), min(leave, max(one, other))
        elif abs(position) > half:
            return math.inf
    return enter if enter <= leave else math.inf
