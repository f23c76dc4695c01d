"""Compiled loops: distances of convex outlines from bodies, and times to contact.

A shape is a row of 7 numbers: x, y in m in the map frame, radius, half length and half
width in m, cosine and sine of its heading. A cylinder has half sizes 0, a box radius 0.
An outline moves with a pose x, y, yaw. It is a rectangle given by its extent x_min,
y_min, x_max, y_max, or a convex polygon given by its counterclockwise corners (k, 2).
"""

import math

import numpy as np

from barn_worlds.base.arrays import Floats, strict_kernel

_X = 0
_Y = 1
_RADIUS = 2
_HALF_LENGTH = 3
_HALF_WIDTH = 4
_COS = 5
_SIN = 6
# Of the corners of a box, counterclockwise.
_CORNER_SIGNS = np.array([[1.0, 1.0], [-1.0, 1.0], [-1.0, -1.0], [1.0, -1.0]])


@strict_kernel
def _to_frame(x: float, y: float, c: float, s: float) -> tuple[float, float]:
    """Return vector x, y seen in the axes of a heading with cosine c and sine s."""
    return c * x + s * y, c * y - s * x


@strict_kernel
def _disc_radius(shape: Floats) -> float:
    """Return the radius in m of a cylinder, or of the disc around a box."""
    if shape[_RADIUS] > 0.0:
        return float(shape[_RADIUS])
    return math.hypot(shape[_HALF_LENGTH], shape[_HALF_WIDTH])


@strict_kernel
def _side(corners: Floats, k: int) -> tuple[float, float]:
    """Return the vector (x, y) from corner k of a polygon to the next corner."""
    end = (k + 1) % len(corners)
    return corners[end, 0] - corners[k, 0], corners[end, 1] - corners[k, 1]


@strict_kernel
def _distance_to_segment(dx: float, dy: float, sx: float, sy: float) -> float:
    """Return the distance of a point from a segment, both seen from its start.

    Args:
        dx: Position of the point, seen from the start of the segment.
        dy: Position of the point, seen from the start of the segment.
        sx: Vector from the start of the segment to its end.
        sy: Vector from the start of the segment to its end.
    """
    square = sx * sx + sy * sy
    share = 0.0
    # A segment of length 0 is a point.
    if square > 0.0:
        along = (dx * sx + dy * sy) / square
        share = min(max(along, 0.0), 1.0)
    return math.hypot(dx - share * sx, dy - share * sy)


@strict_kernel
def rectangle_gap(ahead: float, left: float, extent: Floats) -> float:
    """Return the distance in m of a point from a rectangle in its frame, 0 inside.

    Args:
        ahead: x of the point in the frame of the rectangle.
        left: y of the point in that frame.
        extent: The rectangle.
    """
    outside_x = max(extent[0] - ahead, 0.0, ahead - extent[2])
    outside_y = max(extent[1] - left, 0.0, left - extent[3])
    return math.hypot(outside_x, outside_y)


@strict_kernel
def gaps_to_rectangle(
    shapes: Floats, x: float, y: float, yaw: float, extent: Floats
) -> Floats:
    """Return distances (n,) in m from a rectangle at a pose to shapes, 0 for overlap.

    Args:
        shapes: (n, 7).
        x: Position of the rectangle's frame in the map frame.
        y: Position of the rectangle's frame in the map frame.
        yaw: Heading of that frame.
        extent: The rectangle in that frame.
    """
    gaps = np.empty(len(shapes))
    c = math.cos(yaw)
    s = math.sin(yaw)
    half_x = 0.5 * (extent[2] - extent[0])
    half_y = 0.5 * (extent[3] - extent[1])
    for i in range(len(shapes)):
        shape = shapes[i]
        ahead, left = _to_frame(shape[_X] - x, shape[_Y] - y, c, s)
        if shape[_RADIUS] > 0.0:
            gap = rectangle_gap(ahead, left, extent) - shape[_RADIUS]
            gaps[i] = max(0.0, gap)
            continue

        # Seen from the center of the rectangle.
        ux, uy = _to_frame(shape[_COS], shape[_SIN], c, s)
        gaps[i] = box_gap(
            ahead - 0.5 * (extent[0] + extent[2]),
            left - 0.5 * (extent[1] + extent[3]),
            ux,
            uy,
            shape[_HALF_LENGTH],
            shape[_HALF_WIDTH],
            half_x,
            half_y,
        )
    return gaps


@strict_kernel
def box_gap(
    x: float,
    y: float,
    ux: float,
    uy: float,
    half_length: float,
    half_width: float,
    half_x: float,
    half_y: float,
) -> float:
    """Return the gap in m of a turned box and a rectangle along x, y; 0 for overlap.

    Args:
        x: Center of the box, seen from the center of the rectangle.
        y: Center of the box, seen from the center of the rectangle.
        ux: Direction of its length: x of the unit vector.
        uy: Direction of its length: y of the unit vector.
        half_length: Half the longer side, along ux and uy.
        half_width: Half the other side.
        half_x: Half the side of the rectangle along x.
        half_y: Half the side of the rectangle along y.
    """
    along = x * ux + y * uy
    across = y * ux - x * uy
    # Two convex shapes overlap unless an axis of one of them separates them.
    # A turned box reaches along an axis as far as both half sides projected on it.
    cos = abs(ux)
    sin = abs(uy)
    overlap_x = abs(x) <= half_x + (cos * half_length + sin * half_width)
    overlap_y = abs(y) <= half_y + (sin * half_length + cos * half_width)
    overlap_along = abs(along) <= half_length + (cos * half_x + sin * half_y)
    overlap_across = abs(across) <= half_width + (sin * half_x + cos * half_y)
    if overlap_x and overlap_y and overlap_along and overlap_across:
        return 0.0

    # The nearest pair of points contains a corner of one of them.
    nearest = math.inf
    for k in range(4):
        i, j = _CORNER_SIGNS[k]
        corner_x = x + i * half_length * ux - j * half_width * uy
        corner_y = y + i * half_length * uy + j * half_width * ux
        nearest = min(nearest, _distance_outside(corner_x, corner_y, half_x, half_y))

        corner_x = i * half_x - x
        corner_y = j * half_y - y
        along = corner_x * ux + corner_y * uy
        across = corner_y * ux - corner_x * uy
        nearest = min(
            nearest, _distance_outside(along, across, half_length, half_width)
        )
    return nearest


@strict_kernel
def _distance_outside(x: float, y: float, half_x: float, half_y: float) -> float:
    """Return the distance of a point from a rectangle around the origin, 0 inside."""
    return math.hypot(max(abs(x) - half_x, 0.0), max(abs(y) - half_y, 0.0))


@strict_kernel
def times_to_rectangle(
    shapes: Floats,
    velocities: Floats,
    x: float,
    y: float,
    yaw: float,
    speed: float,
    extent: Floats,
) -> Floats:
    """Return when (n,) in s a moving rectangle meets shapes' discs, 0 if now, or inf.

    Args:
        shapes: (n, 7); a box counts as the disc around it.
        velocities: (n, 2) of the shapes in m/s.
        x: Position of the rectangle's frame in the map frame.
        y: Position of the rectangle's frame in the map frame.
        yaw: Heading of that frame.
        speed: Speed of the rectangle in m/s, straight ahead.
        extent: The rectangle in its frame.
    """
    times = np.empty(len(shapes))
    c = math.cos(yaw)
    s = math.sin(yaw)
    half_x = 0.5 * (extent[2] - extent[0])
    half_y = 0.5 * (extent[3] - extent[1])
    for i in range(len(shapes)):
        radius = _disc_radius(shapes[i])
        ahead, left = _to_frame(shapes[i, _X] - x, shapes[i, _Y] - y, c, s)
        px = ahead - 0.5 * (extent[0] + extent[2])
        py = left - 0.5 * (extent[1] + extent[3])
        vx, vy = _to_frame(velocities[i, 0], velocities[i, 1], c, s)
        vx -= speed

        # The center of the disc meets the rectangle widened by the radius: two
        # rectangles and a disc at every corner.
        first = min(
            entry_time(px, py, vx, vy, half_x + radius, half_y),
            entry_time(px, py, vx, vy, half_x, half_y + radius),
        )
        for k in range(4):
            qx = px - _CORNER_SIGNS[k, 0] * half_x
            qy = py - _CORNER_SIGNS[k, 1] * half_y
            inside = qx * qx + qy * qy <= radius * radius
            entry = 0.0 if inside else _disc_entry_time(qx, qy, vx, vy, radius)
            first = min(first, entry)
        times[i] = first
    return times


@strict_kernel
def _disc_entry_time(x: float, y: float, vx: float, vy: float, radius: float) -> float:
    """Return when a moving point outside a disc about the origin enters it, or inf."""
    square = vx * vx + vy * vy
    along = x * vx + y * vy
    beyond = x * x + y * y - radius * radius
    # Of the quadratic equation for the time at which the distance is the radius.
    root = along * along - square * beyond
    # `along` is negative while the point comes closer.
    if root >= 0.0 and along < 0.0:
        return (-along - math.sqrt(root)) / square
    return math.inf


@strict_kernel
def entry_time(
    px: float, py: float, vx: float, vy: float, half_x: float, half_y: float
) -> float:
    """Return when a moving point enters a rectangle about the origin, 0 inside, or inf.

    Args:
        px: Position of the point.
        py: Position of the point.
        vx: Velocity of the point.
        vy: Velocity of the point.
        half_x: Half the side of the rectangle along x.
        half_y: Half the side of the rectangle along y.

    Returns:
        The time, 0 within the rectangle and inf for never.
    """
    # Inside from the last entry between two opposite sides to the first exit.
    enter = 0.0
    leave = math.inf
    for position, velocity, half in ((px, vx, half_x), (py, vy, half_y)):
        if velocity != 0.0:
            # When the point is between both sides along this axis.
            low = (-half - position) / velocity
            high = (half - position) / velocity
            enter = max(enter, min(low, high))
            leave = min(leave, max(low, high))
        elif abs(position) > half:
            return math.inf
    return enter if enter <= leave else math.inf


@strict_kernel
def polygon_gap(x: float, y: float, corners: Floats) -> float:
    """Return a point's signed distance from a convex polygon, negative inside.

    Args:
        x: Position of the point.
        y: Position of the point.
        corners: (k, 2). A single corner is a point.
    """
    count = len(corners)
    if count == 1:
        return math.hypot(x - corners[0, 0], y - corners[0, 1])

    nearest = math.inf
    deepest = -math.inf
    for k in range(count):
        sx, sy = _side(corners, k)
        dx = x - corners[k, 0]
        dy = y - corners[k, 1]
        # Positive outside of this side.
        depth = (dx * sy - dy * sx) / math.sqrt(sx * sx + sy * sy)
        deepest = max(deepest, depth)
        nearest = min(nearest, _distance_to_segment(dx, dy, sx, sy))
    return nearest if deepest > 0.0 else deepest


@strict_kernel
def polygon_gaps(x: Floats, y: Floats, corners: Floats, distances: Floats) -> None:
    """Write to `distances` those of n points from a convex polygon, below zero inside.

    Args:
        x: Positions (n,).
        y: Positions (n,).
        corners: (k, 2).
        distances: (n,), which is filled in.
    """
    for i in range(len(x)):
        distances[i] = polygon_gap(x[i], y[i], corners)


@strict_kernel
def gaps_to_polygon(
    shapes: Floats, x: float, y: float, yaw: float, corners: Floats, radius: float
) -> Floats:
    """Return distances (n,) in m of a polygon or disc from shapes, 0 for overlap.

    Args:
        shapes: (n, 7).
        x: Position of the outline's frame in the map frame.
        y: Position of the outline's frame in the map frame.
        yaw: Heading of that frame.
        corners: Of the polygon, or the center of the disc.
        radius: Of the disc, 0 for a polygon.
    """
    gaps = np.empty(len(shapes))
    box = np.empty((4, 2))
    c = math.cos(yaw)
    s = math.sin(yaw)
    for i in range(len(shapes)):
        shape = shapes[i]
        ahead, left = _to_frame(shape[_X] - x, shape[_Y] - y, c, s)
        if shape[_RADIUS] > 0.0:
            gap = polygon_gap(ahead, left, corners) - radius - shape[_RADIUS]
            gaps[i] = max(0.0, gap)
            continue

        ux, uy = _to_frame(shape[_COS], shape[_SIN], c, s)
        for k in range(4):
            along = _CORNER_SIGNS[k, 0] * shape[_HALF_LENGTH]
            across = _CORNER_SIGNS[k, 1] * shape[_HALF_WIDTH]
            box[k, 0] = ahead + along * ux - across * uy
            box[k, 1] = left + along * uy + across * ux
        gaps[i] = max(0.0, _polygon_distance(corners, box) - radius)
    return gaps


@strict_kernel
def _polygon_distance(a: Floats, b: Floats) -> float:
    """Return the distance of two convex polygons, 0 where they overlap.

    One of them may be a single point.
    """
    if not (_separates(a, b) or _separates(b, a)):
        return 0.0
    nearest = math.inf
    # The nearest points of two convex polygons that are apart include a corner.
    for corners, polygon in ((a, b), (b, a)):
        for k in range(len(corners)):
            gap = polygon_gap(corners[k, 0], corners[k, 1], polygon)
            nearest = min(nearest, max(gap, 0.0))
    return nearest


@strict_kernel
def _separates(a: Floats, b: Floats) -> bool:
    """Tell whether all of b lies beyond one side of a; False if a is a point."""
    count = len(a)
    if count < 2:
        return False
    for k in range(count):
        sx, sy = _side(a, k)
        least = math.inf
        for j in range(len(b)):
            dx = b[j, 0] - a[k, 0]
            dy = b[j, 1] - a[k, 1]
            # Positive to the right of a side: outside, as corners run counterclockwise.
            least = min(least, dx * sy - dy * sx)
        if least > 0.0:
            return True
    return False


@strict_kernel
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
    """Return when (n,) in s a moving outline meets shapes' discs, 0 if now, or inf.

    Args:
        shapes: (n, 7); a box counts as the disc around it.
        velocities: (n, 2) of the shapes in m/s.
        x: Position of the outline's frame in the map frame.
        y: Position of the outline's frame in the map frame.
        yaw: Heading of that frame.
        speed: Speed of the outline in m/s, straight ahead.
        corners: Of the polygon, or the center of the disc.
        radius: Of the disc, 0 for a polygon.
    """
    times = np.empty(len(shapes))
    c = math.cos(yaw)
    s = math.sin(yaw)
    count = len(corners)
    # A disc is one corner, its center, and no sides.
    for i in range(len(shapes)):
        reach = radius + _disc_radius(shapes[i])
        px, py = _to_frame(shapes[i, _X] - x, shapes[i, _Y] - y, c, s)
        vx, vy = _to_frame(velocities[i, 0], velocities[i, 1], c, s)
        vx -= speed
        if polygon_gap(px, py, corners) <= reach:
            times[i] = 0.0
            continue

        # The center of the disc meets the outline widened by the reach: a disc at each
        # corner, and each side moved outward.
        first = math.inf
        for k in range(count):
            qx = px - corners[k, 0]
            qy = py - corners[k, 1]
            first = min(first, _disc_entry_time(qx, qy, vx, vy, reach))
            if count == 1:
                continue

            sx, sy = _side(corners, k)
            length = math.hypot(sx, sy)
            outside = (qx * sy - qy * sx) / length - reach
            closing_speed = (vx * sy - vy * sx) / length
            if closing_speed < 0.0 <= outside:
                time = -outside / closing_speed
                meeting_x = qx + time * vx
                meeting_y = qy + time * vy
                along = (meeting_x * sx + meeting_y * sy) / length
                if 0.0 <= along <= length:
                    first = min(first, time)
        times[i] = first
    return times


@strict_kernel
def distance_to_line(line: Floats, x: float, y: float) -> float:
    """Return the distance in m of a point from a polyline.

    Args:
        line: Points (n, 2) that it goes through, at least one.
        x: Position of the point.
        y: Position of the point.
    """
    nearest = math.hypot(x - line[0, 0], y - line[0, 1])
    for k in range(len(line) - 1):
        dx = x - line[k, 0]
        dy = y - line[k, 1]
        sx = line[k + 1, 0] - line[k, 0]
        sy = line[k + 1, 1] - line[k, 1]
        nearest = min(nearest, _distance_to_segment(dx, dy, sx, sy))
    return nearest
