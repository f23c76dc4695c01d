"""Beams of a lidar among cylinders and boxes, cast in closed form by compiled code.

An upright cylinder is a circle in the scan plane. It is compared only with the beams in
its angular interval, which makes about five comparisons per beam in the densest world.
Tilted cylinders are intersected with the horizontal beams in space; one that lies below
the plane is not hit. The robot's own pitch and roll (at most half a degree when it
brakes) are neglected.
"""

import math

import numpy as np
from numba import njit

from barn_sim.body.state import Record, Records
from barn_sim.body.vectors import Vector
from barn_sim.sensors.odometry import wrap
from barn_worlds.base.arrays import Floats, Integers, Singles, kernel
from barn_worlds.geometry.kernels import entry_time

# Angle of the first beam, angle from beam to beam (rad), longest range (m).
Fan = tuple[float, float, float]
# Standard deviation of a range (m), that as a share of the range, shortest and longest
# range (m).
Limits = tuple[float, float, float, float]
# Position of the sensor (m), cosine and sine of its yaw.
Frame = tuple[float, float, float, float]

ROUGH_RAD = 5e-4
"""Largest error of `rough_angle`."""

# How a sensor sees a circle, as rows of an array (8, k): angle of the center from the
# first beam and half the angle that the circle covers (rad), distance of the center
# ahead and to the left (m), squared distance (m2), first and last beam that may hit the
# circle, and whether beams a whole turn away may hit it, too.
_ANGLE, _HALF, _AHEAD, _LEFT, _SQUARED, _FIRST, _LAST, _WRAPS = range(8)
_SPAN_ROWS = 8
_TURN = 2.0 * math.pi
# Squares and slopes below this count as zero.
_PARALLEL = 1e-12


@kernel
def scan_all(
    robots: Records,
    indices: Integers,
    circles: Floats,
    cylinders: Integers,
    directions: Floats,
    fan: Fan,
    mount: Vector,
    limits: Limits,
    noise: Singles,
    used: Integers,
    measured: Singles,
) -> None:
    """Write scans of robots `indices` to `measured`; count the noise rows in `used`.

    Args:
        robots: Records (n,) of `barn_sim.body.state.ROBOT`.
        indices: Which of the robots take a scan.
        circles: x and y (n, 2, m) of the cylinders in each robot's world, m.
        cylinders: How many of the m columns each robot's world has (n,).
        directions: Unit vectors (beams, 2) in the sensor frame.
        fan: Angles of the beams and longest range.
        mount: x and y (m) and yaw (rad) of the sensors in base_link.
        limits: Noise and range limits.
        noise: Standard normal numbers (n, k, beams) for the next k scans of each robot.
        used: How many of the k rows each robot has used up (n,); counted on.
        measured: Ranges (n, beams); the rows of `indices` are filled in.
    """
    ranges = np.empty(len(directions))
    spans = np.empty((_SPAN_ROWS, circles.shape[2]))
    for index in indices:
        robot: Record = robots[index]
        cosine = math.cos(robot.yaw)
        sine = math.sin(robot.yaw)
        yaw = wrap(robot.yaw + mount[2])
        x = robot.x + cosine * mount[0] - sine * mount[1]
        y = robot.y + sine * mount[0] + cosine * mount[1]
        frame = (x, y, math.cos(yaw), math.sin(yaw))

        ranges[:] = np.inf
        xs = circles[index, 0, : cylinders[index]]
        ys = circles[index, 1, : cylinders[index]]
        _cast_spans(ranges, directions, fan, frame, xs, ys, robot.radius_m, spans)
        measure(ranges, noise[index, used[index]], limits, measured[index])
        used[index] += 1


@kernel
def cast_beams(
    ranges: Floats,
    directions: Floats,
    fan: Fan,
    frame: Frame,
    centers: Floats,
    radius: float,
    tilted: Floats,
    shapes: Floats,
) -> None:
    """Lower `ranges` in place to first hits from one pose, to 0 within an obstacle.

    Args:
        ranges: Distances (n,) along the beams, m.
        directions: Unit vectors (n, 2) in the sensor frame.
        fan: Angles of the beams and longest range.
        frame: Pose of the sensor in the frame of the obstacles.
        centers: Upright cylinders (m, 2), m.
        radius: Radius of the cylinders, upright or tilted, m.
        tilted: Other cylinders (k, 7), see `barn_sim.sensors.lidar.Lidar.scan`.
        shapes: Cylinders of other sizes and boxes (l, 7).
    """
    _cast_circles(ranges, directions, fan, frame, centers, radius)
    _cast_tilted(ranges, directions, frame, tilted, radius)
    _cast_shapes(ranges, directions, fan, frame, shapes)


@kernel
def cast_sweep(
    ranges: Floats,
    directions: Floats,
    fan: Fan,
    frames: Floats,
    turn: float,
    centers: Floats,
    radius: float,
    tilted: Floats,
    shapes: Floats,
) -> None:
    """Lower `ranges` in place to first hits, each beam from a sensor pose of its own.

    Args:
        ranges: Distances (n,) along the beams, m.
        directions: Unit vectors (n, 2) in the sensor frame.
        fan: Angles of the beams and longest range.
        frames: x, y, cosine and sine of the yaw of the sensor at each beam (n, 4).
        turn: Largest angle between the sensor at a beam and at the last one, rad.
        centers: Upright cylinders (m, 2), m.
        radius: Radius of the cylinders, upright or tilted, m.
        tilted: Other cylinders (k, 7), see `barn_sim.sensors.lidar.Lidar.scan`.
        shapes: Cylinders of other sizes and boxes (l, 7).
    """
    angle_min, increment, range_max = fan
    last_beam = len(ranges) - 1
    x, y, cosine, sine = frames[-1]
    shift = np.hypot(frames[:, 0] - x, frames[:, 1] - y).max()

    for i in range(len(centers)):
        dx = centers[i, 0] - x
        dy = centers[i, 1] - y
        distance = math.hypot(dx, dy)
        if not distance - radius - shift <= range_max:
            continue

        # Seen from the last frame, widened by how far the sensor moves and turns.
        half = _TURN
        if distance > radius + 2.0 * shift:
            parallax = math.asin(shift / distance)
            half = parallax + math.asin(radius / (distance - shift)) + turn + increment
        ahead = cosine * dx + sine * dy
        left = cosine * dy - sine * dx
        angle = math.atan2(left, ahead) - angle_min

        # Each beam once, although the intervals of neighboring turns may overlap.
        next_beam = 0
        for lap in range(-1, 2):
            low = angle + lap * _TURN - half
            high = angle + lap * _TURN + half
            first = max(next_beam, math.floor(low / increment))
            last = min(last_beam, math.ceil(high / increment))
            for beam in range(first, last + 1):
                _cast_moving(ranges, directions, frames, beam, centers[i], radius)
            next_beam = max(next_beam, last + 1)

    for beam in range(len(ranges)):
        frame = (frames[beam, 0], frames[beam, 1], frames[beam, 2], frames[beam, 3])
        beam_fan = (angle_min + beam * increment, increment, range_max)
        beam_range = ranges[beam : beam + 1]
        direction = directions[beam : beam + 1]
        _cast_tilted(beam_range, direction, frame, tilted, radius)
        _cast_shapes(beam_range, direction, beam_fan, frame, shapes)


@kernel
def measure(ranges: Floats, noise: Singles, limits: Limits, measured: Singles) -> None:
    """Write ranges with noise to `measured`, -inf where too near, +inf where too far.

    Args:
        ranges: True ranges (n,) in m, inf where nothing is hit.
        noise: Standard normal numbers (n,).
        limits: Noise and range limits. The larger of both deviations counts.
        measured: Filled in (n,): -inf below the shortest range, +inf beyond the last.
    """
    std, share, range_min, range_max = limits
    for beam in range(len(ranges)):
        deviation = share * min(ranges[beam], range_max)
        if not deviation > std:
            deviation = std
        distance = ranges[beam] + deviation * noise[beam]
        reading = distance
        if distance > range_max:
            reading = np.inf
        if distance < range_min:
            reading = -np.inf
        measured[beam] = reading


@kernel
def rough_angle(y: float, x: float) -> float:
    """Return atan2(y, x) in rad within `ROUGH_RAD`, three times as fast; NaN at (0, 0).

    Args:
        y: Second coordinate of a vector other than (0, 0).
        x: First coordinate of it.

    Returns:
        The direction of the vector in [-pi, pi].
    """
    across = abs(y)
    along = abs(x)
    is_steep = across > along
    ratio = (along if is_steep else across) / (across if is_steep else along)

    # Polynomial of least error for the arc tangent on [0, 1].
    squared = ratio * ratio
    slope = -0.327622764 + squared * (0.15931422 - 0.0464964749 * squared)
    angle = ratio * (1.0 + squared * slope)

    if is_steep:
        angle = 0.5 * math.pi - angle
    if x < 0.0:
        angle = math.pi - angle
    return -angle if y < 0.0 else angle


@kernel
def _cast_circles(
    ranges: Floats,
    directions: Floats,
    fan: Fan,
    frame: Frame,
    centers: Floats,
    radius: float,
) -> None:
    """Lower `ranges` in place to first hits on circles, all to 0 from within one."""
    xs = centers[:, 0].copy()
    ys = centers[:, 1].copy()
    spans = np.empty((_SPAN_ROWS, len(centers)))
    _cast_spans(ranges, directions, fan, frame, xs, ys, radius, spans)


@kernel
def _cast_spans(
    ranges: Floats,
    directions: Floats,
    fan: Fan,
    frame: Frame,
    xs: Floats,
    ys: Floats,
    radius: float,
    spans: Floats,
) -> None:
    """Lower `ranges` to first hits on circles, to 0 within one; overwrite `spans`."""
    increment = fan[1]
    last_beam = len(ranges) - 1
    _find_spans(fan, frame, xs, ys, radius, last_beam, spans)
    for i in range(len(xs)):
        if spans[_SQUARED, i] <= radius * radius:
            ranges[:] = 0.0
            return

        first = int(spans[_FIRST, i])
        last = int(spans[_LAST, i])
        wraps = spans[_WRAPS, i] > 0.0
        if first > last and not wraps:
            continue

        ahead = spans[_AHEAD, i]
        left = spans[_LEFT, i]
        _cast_circle(ranges, directions, first, last, ahead, left, radius)
        if wraps:
            for lap in range(-1, 2, 2):
                angle = spans[_ANGLE, i] + lap * _TURN
                half = spans[_HALF, i]
                first = max(0, math.floor((angle - half) / increment))
                last = min(last_beam, math.ceil((angle + half) / increment))
                _cast_circle(ranges, directions, first, last, ahead, left, radius)


@kernel
def _find_spans(
    fan: Fan,
    frame: Frame,
    xs: Floats,
    ys: Floats,
    radius: float,
    last_beam: float,
    spans: Floats,
) -> None:
    """Write to `spans` (8, k) where each circle is and which beams may hit it.

    Without branches, so that several are computed at once.

    Angles may be rough: one beam too many changes nothing, since the intersection
    decides. A circle beyond the longest range has half angle -1 and no beams.
    """
    angle_min, increment, range_max = fan
    x, y, cosine, sine = frame
    reach = (range_max + radius) * (range_max + radius)
    end = (last_beam + 1.0) * increment

    # Conditions only select values, so that the compiler uses vector instructions.
    for i in range(len(xs)):
        dx = xs[i] - x
        dy = ys[i] - y
        squared = dx * dx + dy * dy
        ahead = cosine * dx + sine * dy
        left = cosine * dy - sine * dx
        distance = math.sqrt(squared)

        angle = rough_angle(left, ahead) - angle_min
        angle = angle + _TURN if angle < 0.0 else angle
        angle = angle - _TURN if angle >= _TURN else angle

        # Arc sine by its series; where that converges slowly, an upper bound.
        ratio = radius / distance
        cubed = ratio * ratio * ratio
        half = ratio + cubed * (1.0 / 6.0) + 0.1 * cubed * ratio * ratio
        half = half if ratio <= 0.5 else 0.5 * math.pi * ratio
        half = -1.0 if squared > reach else half + 2.0 * ROUGH_RAD

        low = np.ceil((angle - half) / increment)
        high = np.floor((angle + half) / increment)
        high = high if high < last_beam else last_beam
        wraps = 1.0 if angle + half >= _TURN - increment else 0.0
        wraps = 1.0 if angle - half <= end - _TURN else wraps

        spans[_ANGLE, i] = angle
        spans[_HALF, i] = half
        spans[_AHEAD, i] = ahead
        spans[_LEFT, i] = left
        spans[_SQUARED, i] = squared
        spans[_FIRST, i] = low if low > 0.0 else 0.0
        spans[_LAST, i] = -1.0 if half < 0.0 else high
        spans[_WRAPS, i] = 0.0 if half < 0.0 else wraps


@njit(cache=True, inline="always")
def _cast_circle(
    ranges: Floats,
    directions: Floats,
    first: int,
    last: int,
    ahead: float,
    left: float,
    radius: float,
) -> None:
    """Lower the ranges of beams first to last, inclusive, to hits on a circle."""
    for beam in range(first, last + 1):
        along = directions[beam, 0] * ahead + directions[beam, 1] * left
        across = directions[beam, 0] * left - directions[beam, 1] * ahead
        chord = radius * radius - across * across
        hit = along - math.sqrt(chord if chord >= 0.0 else 0.0)
        # A select: no processor foresees branches that depend on geometry.
        is_nearer = (chord >= 0.0) & (along > 0.0) & (hit < ranges[beam])
        ranges[beam] = hit if is_nearer else ranges[beam]


@kernel
def _cast_moving(
    ranges: Floats,
    directions: Floats,
    frames: Floats,
    beam: int,
    center: Floats,
    radius: float,
) -> None:
    """Lower the range of one beam, from its row of `frames`, to its hit on a circle."""
    dx = center[0] - frames[beam, 0]
    dy = center[1] - frames[beam, 1]
    ahead = frames[beam, 2] * dx + frames[beam, 3] * dy
    left = frames[beam, 2] * dy - frames[beam, 3] * dx
    if dx * dx + dy * dy <= radius * radius:
        ranges[beam] = 0.0
    else:
        _cast_circle(ranges, directions, beam, beam, ahead, left, radius)


@kernel
def _cast_shapes(
    ranges: Floats, directions: Floats, fan: Fan, frame: Frame, shapes: Floats
) -> None:
    """Lower `ranges` to hits on shapes (k, 7): boxes, or cylinders if radius is set."""
    for i in range(len(shapes)):
        radius = shapes[i, 2]
        if radius > 0.0:
            _cast_circles(ranges, directions, fan, frame, shapes[i : i + 1], radius)
        else:
            _cast_box(ranges, directions, fan, frame, shapes[i])


@kernel
def _cast_box(
    ranges: Floats, directions: Floats, fan: Fan, frame: Frame, box: Floats
) -> None:
    """Lower `ranges` in place to first hits on a box (7,); all are 0 from within it."""
    x, y, cosine, sine = frame
    angle_min, increment, range_max = fan
    center_x, center_y, _, half_x, half_y, box_cosine, box_sine = box

    # Position of the sensor in the frame of the box, in which its sides are straight.
    dx = x - center_x
    dy = y - center_y
    ox = box_cosine * dx + box_sine * dy
    oy = box_cosine * dy - box_sine * dx
    outside_x = max(abs(ox) - half_x, 0.0)
    outside_y = max(abs(oy) - half_y, 0.0)
    if math.hypot(outside_x, outside_y) > range_max:
        return
    if abs(ox) <= half_x and abs(oy) <= half_y:
        ranges[:] = 0.0
        return

    # Cosine and sine of the turn from the sensor's frame to that of the box.
    turn_cosine = box_cosine * cosine + box_sine * sine
    turn_sine = box_cosine * sine - box_sine * cosine

    # Directions of the outermost corners, seen from that of the center.
    rightmost = 0.0
    leftmost = 0.0
    for k in range(4):
        corner_x = (2.0 * (k % 2) - 1.0) * half_x - ox
        corner_y = (2.0 * (k // 2) - 1.0) * half_y - oy
        offset = rough_angle(
            oy * corner_x - ox * corner_y, -ox * corner_x - oy * corner_y
        )
        rightmost = min(rightmost, offset)
        leftmost = max(leftmost, offset)

    center_left = turn_sine * ox - turn_cosine * oy
    center_ahead = -turn_cosine * ox - turn_sine * oy
    angle = rough_angle(center_left, center_ahead) - angle_min
    for lap in range(-2, 2):
        low = angle + lap * _TURN + rightmost - 2.0 * ROUGH_RAD
        high = angle + lap * _TURN + leftmost + 2.0 * ROUGH_RAD
        first = max(0, math.floor(low / increment))
        last = min(len(ranges) - 1, math.ceil(high / increment))
        for beam in range(first, last + 1):
            bx = turn_cosine * directions[beam, 0] - turn_sine * directions[beam, 1]
            by = turn_sine * directions[beam, 0] + turn_cosine * directions[beam, 1]
            distance = entry_time(ox, oy, bx, by, half_x, half_y)
            ranges[beam] = min(ranges[beam], distance)


@kernel
def _cast_tilted(
    ranges: Floats, directions: Floats, frame: Frame, cylinders: Floats, radius: float
) -> None:
    """Lower `ranges` in place to hits on tilted cylinders (k, 7), all to 0 in one."""
    x, y, cosine, sine = frame
    for i in range(len(cylinders)):
        center_x, center_y, center_z, ux, uy, uz, half = cylinders[i]

        # Position of the sensor relative to the cylinder, and along its axis.
        ox = x - center_x
        oy = y - center_y
        oz = -center_z
        along = ox * ux + oy * uy + oz * uz
        beyond = ox * ox + oy * oy + oz * oz - along * along - radius * radius
        if beyond <= 0.0 and abs(along) <= half:
            ranges[:] = 0.0
            return

        for beam in range(len(ranges)):
            bx = cosine * directions[beam, 0] - sine * directions[beam, 1]
            by = sine * directions[beam, 0] + cosine * directions[beam, 1]
            offset = (ox, oy, oz)
            axis = (ux, uy, uz)
            distance = _hit_cylinder(bx, by, offset, axis, along, beyond, half, radius)
            ranges[beam] = min(ranges[beam], distance)


@kernel
def _hit_cylinder(
    bx: float,
    by: float,
    offset: Vector,
    axis: Vector,
    along: float,
    beyond: float,
    half: float,
    radius: float,
) -> float:
    """Return the distance (m) along a beam to a tilted cylinder, inf without a hit."""
    ox, oy, oz = offset
    ux, uy, uz = axis
    # Advance along the axis per meter of the beam.
    slope = bx * ux + by * uy
    nearest = math.inf

    # The side: a quadratic equation for the distance at which the radius is reached.
    a = 1.0 - slope * slope
    b = ox * bx + oy * by - along * slope
    discriminant = b * b - a * beyond
    if a > _PARALLEL and discriminant >= 0.0:
        distance = (-b - math.sqrt(discriminant)) / a
        if distance >= 0.0 and abs(along + slope * distance) <= half:
            nearest = distance

    # The cap that faces the beam.
    if abs(slope) > _PARALLEL:
        distance = (-math.copysign(half, slope) - along) / slope
        if 0.0 <= distance < nearest:
            px = ox + bx * distance
            py = oy + by * distance
            height = px * ux + py * uy + oz * uz
            if px * px + py * py + oz * oz - height * height <= radius * radius:
                nearest = distance
    return nearest
