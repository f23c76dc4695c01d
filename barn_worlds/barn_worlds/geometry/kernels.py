"""Compiled loops: distances of convex outlines from upright cylinders and boxes, times to contact, points from lines.

A shape is a row x, y (m, map frame), radius, half length and half width (m), cosine and sine of its heading. A cylinder
has half sizes 0, a box radius 0. An outline moves with a pose x, y, yaw; `extent` is x_min, y_min, x_max, y_max of a
rectangle about it, corners (k, 2) are those of a convex polygon, counter-clockwise.
"""

import math

import numpy as np
from numba import njit

from barn_worlds.base.arrays import Floats


@njit(cache=True)
def rectangle_gap(ahead: float, left: float, extent: Floats) -> float:
    """Return the distance in m of a point in the frame of a rectangle from it, 0 inside."""
    outside_x = max(extent[0] - ahead, 0.0, ahead - extent[2])
    outside_y = max(extent[1] - left, 0.0, left - extent[3])
    return math.hypot(outside_x, outside_y)


@njit(cache=True)
def gaps_to_rectangle(
    shapes: Floats, x: float, y: float, yaw: float, extent: Floats
) -> Floats:
    """Return the distances (n,) in m from a rectangle to shapes (n, 7), 0 where they overlap."""
    gaps = np.empty(len(shapes))
    c, s = math.cos(yaw), math.sin(yaw)
    for i in range(len(shapes)):
        dx, dy = shapes[i, 0] - x, shapes[i, 1] - y
        ahead, left = c * dx + s * dy, c * dy - s * dx
        if shapes[i, 2] > 0.0:
            gaps[i] = max(0.0, rectangle_gap(ahead, left, extent) - shapes[i, 2])
            continue
        # the box's sides in the frame of the rectangle
        ux, uy = (
            c * shapes[i, 5] + s * shapes[i, 6],
            c * shapes[i, 6] - s * shapes[i, 5],
        )
        ahead -= 0.5 * (extent[0] + extent[2])
        left -= 0.5 * (extent[1] + extent[3])
        half_x, half_y = 0.5 * (extent[2] - extent[0]), 0.5 * (extent[3] - extent[1])
        gaps[i] = box_gap(
            ahead, left, ux, uy, shapes[i, 3], shapes[i, 4], half_x, half_y
        )
    return gaps


@njit(cache=True)
def box_gap(
    x: float,
    y: float,
    ux: float,
    uy: float,
    half_long: float,
    half_wide: float,
    half_x: float,
    half_y: float,
) -> float:
    """Return the distance from a rectangle around the origin to one at x, y with its length along ux, uy; 0 inside."""
    # apart along an axis of either: two convex shapes overlap unless one of these separates them
    wide_x, wide_y = (
        abs(ux) * half_long + abs(uy) * half_wide,
        abs(uy) * half_long + abs(ux) * half_wide,
    )
    along, across = x * ux + y * uy, y * ux - x * uy
    long_reach, wide_reach = (
        abs(ux) * half_x + abs(uy) * half_y,
        abs(uy) * half_x + abs(ux) * half_y,
    )
    overlap = abs(x) <= half_x + wide_x and abs(y) <= half_y + wide_y
    if (
        overlap
        and abs(along) <= half_long + long_reach
        and abs(across) <= half_wide + wide_reach
    ):
        return 0.0
    nearest = math.inf
    for k in range(4):
        i, j = 2.0 * (k % 2) - 1.0, 2.0 * (k // 2) - 1.0
        # a corner of the other one to the rectangle, and the other way round
        px, py = (
            x + i * half_long * ux - j * half_wide * uy,
            y + i * half_long * uy + j * half_wide * ux,
        )
        nearest = min(
            nearest, math.hypot(max(abs(px) - half_x, 0.0), max(abs(py) - half_y, 0.0))
        )
        qx, qy = i * half_x - x, j * half_y - y
        own, other = qx * ux + qy * uy, qy * ux - qx * uy
        nearest = min(
            nearest,
            math.hypot(
                max(abs(own) - half_long, 0.0), max(abs(other) - half_wide, 0.0)
            ),
        )
    return nearest


@njit(cache=True)
def times_to_rectangle(
    shapes: Floats,
    velocities: Floats,
    x: float,
    y: float,
    yaw: float,
    speed: float,
    extent: Floats,
) -> Floats:
    """Return when (n,) in s a rectangle meets shapes (n, 7) of velocities (n, 2), as `Footprint.times_to_contact`."""
    times = np.empty(len(shapes))
    c, s = math.cos(yaw), math.sin(yaw)
    half_x, half_y = 0.5 * (extent[2] - extent[0]), 0.5 * (extent[3] - extent[1])
    for i in range(len(shapes)):
        radius = (
            shapes[i, 2]
            if shapes[i, 2] > 0.0
            else math.hypot(shapes[i, 3], shapes[i, 4])
        )
        dx, dy = shapes[i, 0] - x, shapes[i, 1] - y
        px, py = (
            c * dx + s * dy - 0.5 * (extent[0] + extent[2]),
            c * dy - s * dx - 0.5 * (extent[1] + extent[3]),
        )
        vx = c * velocities[i, 0] + s * velocities[i, 1] - speed
        vy = c * velocities[i, 1] - s * velocities[i, 0]
        # the disc's centre meets the rectangle widened by its radius: two rectangles and a disc at every corner
        first = min(
            entry_time(px, py, vx, vy, half_x + radius, half_y),
            entry_time(px, py, vx, vy, half_x, half_y + radius),
        )
        for k in range(4):
            qx, qy = (
                px - (2.0 * (k % 2) - 1.0) * half_x,
                py - (2.0 * (k // 2) - 1.0) * half_y,
            )
            square, along, beyond = (
                vx * vx + vy * vy,
                qx * vx + qy * vy,
                qx * qx + qy * qy - radius * radius,
            )
            root = along * along - square * beyond
            if beyond <= 0.0:
                first = 0.0
            elif root >= 0.0 and along < 0.0:
                first = min(first, (-along - math.sqrt(root)) / square)
        times[i] = first
    return times


@njit(cache=True)
def entry_time(
    px: float, py: float, vx: float, vy: float, half_x: float, half_y: float
) -> float:
    """Return when a point of velocity vx, vy enters a rectangle around the origin, 0 within it and inf for never."""
    enter, leave = 0.0, math.inf
    for position, velocity, half in ((px, vx, half_x), (py, vy, half_y)):
        if velocity != 0.0:
            one, other = (-half - position) / velocity, (half - position) / velocity
            enter, leave = max(enter, min(one, other)), min(leave, max(one, other))
        elif abs(position) > half:
            return math.inf
    return enter if enter <= leave else math.inf


@njit(cache=True)
def polygon_gap(x: float, y: float, corners: Floats) -> float:
    """Return the distance of a point from a convex polygon, below zero inside; from its only corner if it has one."""
    count = len(corners)
    if count == 1:
        return math.hypot(x - corners[0, 0], y - corners[0, 1])
    nearest, deepest = math.inf, -math.inf
    for k in range(count):
        ax, ay = corners[k, 0], corners[k, 1]
        sx, sy = corners[(k + 1) % count, 0] - ax, corners[(k + 1) % count, 1] - ay
        square = sx * sx + sy * sy
        dx, dy = x - ax, y - ay
        deepest = max(deepest, (dx * sy - dy * sx) / math.sqrt(square))
        along = min(max((dx * sx + dy * sy) / square, 0.0), 1.0)
        nearest = min(nearest, math.hypot(dx - along * sx, dy - along * sy))
    return nearest if deepest > 0.0 else deepest


@njit(cache=True)
def polygon_gaps(x: Floats, y: Floats, corners: Floats, found: Floats) -> None:
    """Fill in the distances (n,) of points from a convex polygon, below zero inside."""
    for i in range(len(x)):
        found[i] = polygon_gap(x[i], y[i], corners)


@njit(cache=True)
def gaps_to_polygon(
    shapes: Floats, x: float, y: float, yaw: float, corners: Floats, radius: float
) -> Floats:
    """Return the distances (n,) in m from a polygon or a disc at a pose to shapes (n, 7), 0 where they overlap.

    corners, radius: those of a polygon and 0, or middle and radius of a disc.
    """
    gaps, box = np.empty(len(shapes)), np.empty((4, 2))
    c, s = math.cos(yaw), math.sin(yaw)
    for i in range(len(shapes)):
        dx, dy = shapes[i, 0] - x, shapes[i, 1] - y
        ahead, left = c * dx + s * dy, c * dy - s * dx
        if shapes[i, 2] > 0.0:
            gaps[i] = max(
                0.0, polygon_gap(ahead, left, corners) - radius - shapes[i, 2]
            )
            continue
        ux, uy = (
            c * shapes[i, 5] + s * shapes[i, 6],
            c * shapes[i, 6] - s * shapes[i, 5],
        )
        for k, (a, b) in enumerate(
            ((1.0, 1.0), (-1.0, 1.0), (-1.0, -1.0), (1.0, -1.0))
        ):
            long, wide = a * shapes[i, 3], b * shapes[i, 4]
            box[k, 0], box[k, 1] = (
                ahead + long * ux - wide * uy,
                left + long * uy + wide * ux,
            )
        gaps[i] = max(0.0, _apart(corners, box) - radius)
    return gaps


@njit(cache=True)
def _apart(a: Floats, b: Floats) -> float:
    """Return the distance of two convex polygons, 0 where they overlap; one may be a point."""
    if not (_separated(a, b) or _separated(b, a)):
        return 0.0
    nearest = math.inf
    for one, other in ((a, b), (b, a)):
        for k in range(len(one)):
            nearest = min(nearest, max(polygon_gap(one[k, 0], one[k, 1], other), 0.0))
    return nearest


@njit(cache=True)
def _separated(a: Floats, b: Floats) -> bool:
    """Tell whether all of b lies beyond one side of a."""
    count = len(a)
    if count < 2:
        return False
    for k in range(count):
        sx, sy = a[(k + 1) % count, 0] - a[k, 0], a[(k + 1) % count, 1] - a[k, 1]
        least = math.inf
        for j in range(len(b)):
            least = min(least, (b[j, 0] - a[k, 0]) * sy - (b[j, 1] - a[k, 1]) * sx)
        if least > 0.0:
            return True
    return False


@njit(cache=True)
def times_to_polygon(
    shapes: Floats,
    velocities: Floats,
    x: float,
    y: float,
    yaw: float,
    speed: float,
    corners: Floats,
    radius: float,
) -> Floats:
    """Do as `times_to_rectangle` for a polygon or a disc; corners, radius as for `gaps_to_polygon`."""
    times = np.empty(len(shapes))
    c, s = math.cos(yaw), math.sin(yaw)
    count = len(corners)
    for i in range(len(shapes)):
        reach = radius + (
            shapes[i, 2]
            if shapes[i, 2] > 0.0
            else math.hypot(shapes[i, 3], shapes[i, 4])
        )
        dx, dy = shapes[i, 0] - x, shapes[i, 1] - y
        px, py = c * dx + s * dy, c * dy - s * dx
        vx = c * velocities[i, 0] + s * velocities[i, 1] - speed
        vy = c * velocities[i, 1] - s * velocities[i, 0]
        if polygon_gap(px, py, corners) <= reach:
            times[i] = 0.0
            continue
        first, square = math.inf, vx * vx + vy * vy
        for k in range(count):
            # the disc's centre meets the outline widened by its radius: a disc at each corner, and each side moved out
            qx, qy = px - corners[k, 0], py - corners[k, 1]
            along = qx * vx + qy * vy
            root = along * along - square * (qx * qx + qy * qy - reach * reach)
            if root >= 0.0 and along < 0.0:
                first = min(first, (-along - math.sqrt(root)) / square)
            if count == 1:
                continue
            sx, sy = (
                corners[(k + 1) % count, 0] - corners[k, 0],
                corners[(k + 1) % count, 1] - corners[k, 1],
            )
            length = math.hypot(sx, sy)
            outward, closing = (
                (qx * sy - qy * sx) / length - reach,
                (vx * sy - vy * sx) / length,
            )
            if closing < 0.0 <= outward:
                after = -outward / closing
                where = ((qx + after * vx) * sx + (qy + after * vy) * sy) / length
                if 0.0 <= where <= length:
                    first = min(first, after)
        times[i] = first
    return times


@njit(cache=True)
def distance_to(line: Floats, x: float, y: float) -> float:
    """Return the distance in m of a point from a line through points (n, 2), one at least."""
    nearest = math.hypot(x - line[0, 0], y - line[0, 1])
    for k in range(len(line) - 1):
        from_x, from_y = x - line[k, 0], y - line[k, 1]
        side_x, side_y = line[k + 1, 0] - line[k, 0], line[k + 1, 1] - line[k, 1]
        square = side_x * side_x + side_y * side_y
        along = (
            min(max((from_x * side_x + from_y * side_y) / square, 0.0), 1.0)
            if square > 0.0
            else 0.0
        )
        nearest = min(
            nearest, math.hypot(from_x - along * side_x, from_y - along * side_y)
        )
    return nearest
