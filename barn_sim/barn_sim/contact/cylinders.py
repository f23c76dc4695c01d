"""Positions of cylinders and distances to the robot: kernels on plain arrays.

A cylinder has a state (x, y, z of its center, quaternion x, y, z, w) and, for
distances, the segment between the ends of its axis seen from above. That segment is a
point while the cylinder stands upright.
"""

import math

import numpy as np

from barn_worlds.base.arrays import Bools, Floats, Integers, kernel
from barn_worlds.geometry.kernels import rectangle_gap

# Points of a segment of 1 m: closer together than a cylinder is thick.
_SAMPLES = 9
# A pushed cylinder this close pushes the next one.
TOUCH_GAP_M = 0.005
# A cylinder counts as displaced once an end of its axis has been this far from home.
MOVED_M = 1e-3
# Speed and spin up to which a cylinder counts as at rest.
_REST_M_S = 1e-2
_REST_RAD_S = 1e-1
# Vertical component of an axis from which on a cylinder is upright.
_UPRIGHT = math.cos(math.radians(0.5))
# More than the rounding error of a distance.
_ROUNDING_M = 1e-9


@kernel
def near_cylinders(
    segments: Floats,
    candidates: Bools,
    pushed: Bools,
    x: float,
    y: float,
    yaw: float,
    extent: Floats,
    radius: float,
    robot_within: float,
    pushed_within: float,
) -> tuple[Integers, float]:
    """Return rows of cylinders near the robot or a pushed one, and how far it may go.

    Args:
        segments: Axes (n, 4) of all cylinders seen from above, m.
        candidates: Which cylinders (n,) to look at.
        pushed: Which cylinders (n,) move.
        x: Position of base_link, m.
        y: Position of base_link, m.
        yaw: Yaw of base_link, rad.
        extent: x_min, y_min, x_max, y_max (4,) of the robot in base_link, m.
        radius: Radius of the cylinders, m.
        robot_within: Gap to the robot that counts as near, m.
        pushed_within: Gap to a pushed cylinder that counts as near, m.

    Returns:
        Indices of the cylinders that are near, and how far any point of the robot may
        go before others are, m; 0 or less while any cylinder is pushed.
    """
    # Nothing farther than this from base_link can be near, whatever the robot's
    # heading.
    robot_reach = _reach(extent) + radius + robot_within
    pushing = np.flatnonzero(pushed)
    # Pushed cylinders move by themselves, so the next look cannot wait for the robot.
    free = math.inf if len(pushing) == 0 else 0.0
    indices = np.empty(len(segments), np.int64)
    count = 0
    for i in range(len(segments)):
        if not candidates[i]:
            continue

        # The gap is computed only where a coarse distance does not rule it out.
        ax, ay, bx, by = segments[i]
        length = abs(bx - ax) + abs(by - ay)
        # The larger coordinate is a lower bound of the distance without a square root.
        beyond = max(abs(ax - x), abs(ay - y)) - (robot_reach + length)
        is_near = False
        if beyond < 0.0:
            gap = robot_gap(segments[i], x, y, yaw, extent)
            is_near = gap < radius + robot_within
            beyond = max(0.0, gap - radius - robot_within)
        if not is_near:
            free = min(free, beyond)

        for j in pushing:
            cx, cy, dx, dy = segments[j]
            largest_gap = 2.0 * radius + pushed_within
            reach = largest_gap + length + abs(dx - cx) + abs(dy - cy)
            if not is_near and abs(ax - cx) < reach and abs(ay - cy) < reach:
                is_near = segment_gap(segments[i], segments[j]) < largest_gap
        if is_near:
            indices[count] = i
            count += 1
    return indices[:count], free - _ROUNDING_M


@kernel
def nearest_gap(
    segments: Floats, x: float, y: float, yaw: float, extent: Floats
) -> float:
    """Return the distance (m) from the robot to the nearest axis, inf without any.

    Args:
        segments: Axes (n, 4) of cylinders seen from above, m.
        x: Position of base_link, m.
        y: Position of base_link, m.
        yaw: Yaw of base_link, rad.
        extent: x_min, y_min, x_max, y_max (4,) of the robot in base_link, m.
    """
    nearest = math.inf
    robot_reach = _reach(extent) + _ROUNDING_M
    for i in range(len(segments)):
        ax = segments[i, 0]
        ay = segments[i, 1]
        length = abs(segments[i, 2] - ax) + abs(segments[i, 3] - ay)
        # A segment beyond this cannot be nearer than the nearest so far; squares spare
        # a root.
        far = nearest + robot_reach + length
        if (ax - x) * (ax - x) + (ay - y) * (ay - y) < far * far:
            nearest = min(nearest, robot_gap(segments[i], x, y, yaw, extent))
    return nearest


@kernel
def _reach(extent: Floats) -> float:
    """Return the distance (m) from base_link to the farthest corner of the robot."""
    return math.hypot(max(-extent[0], extent[2]), max(-extent[1], extent[3]))


@kernel
def robot_gap(segment: Floats, x: float, y: float, yaw: float, extent: Floats) -> float:
    """Return the distance (m) from the robot's rectangle to an axis, 0 within it.

    Args:
        segment: Axis (4,) of a cylinder seen from above, m.
        x: Position of base_link, m.
        y: Position of base_link, m.
        yaw: Yaw of base_link, rad.
        extent: x_min, y_min, x_max, y_max (4,) of the robot in base_link, m.
    """
    c = math.cos(yaw)
    s = math.sin(yaw)
    nearest = math.inf
    is_point = segment[0] == segment[2] and segment[1] == segment[3]
    for k in range(1 if is_point else _SAMPLES):
        part = k / (_SAMPLES - 1)
        dx = segment[0] + part * (segment[2] - segment[0]) - x
        dy = segment[1] + part * (segment[3] - segment[1]) - y
        # In the robot's frame its outline is a rectangle along the axes.
        ahead = c * dx + s * dy
        left = c * dy - s * dx
        nearest = min(nearest, rectangle_gap(ahead, left, extent))
    return nearest


@kernel
def segment_gap(first: Floats, second: Floats) -> float:
    """Return the distance (m) of two segments, measured from samples on the first.

    Args:
        first: Segment (4,) along which samples are taken, m.
        second: Segment (4,), m.
    """
    ex = second[2] - second[0]
    ey = second[3] - second[1]
    squared = ex * ex + ey * ey
    nearest = math.inf
    is_point = first[0] == first[2] and first[1] == first[3]
    for k in range(1 if is_point else _SAMPLES):
        part = k / (_SAMPLES - 1)
        dx = first[0] + part * (first[2] - first[0]) - second[0]
        dy = first[1] + part * (first[3] - first[1]) - second[1]
        # Nearest point of the second segment, as a share of its length.
        t = 0.0
        if squared > 0.0:
            t = min(1.0, max(0.0, (dx * ex + dy * ey) / squared))
        nearest = min(nearest, math.hypot(dx - t * ex, dy - t * ey))
    return nearest


@kernel
def follow_cylinders(
    indices: Integers,
    bodies: Floats,
    x: float,
    y: float,
    yaw: float,
    extent: Floats,
    homes: Floats,
    radius: float,
    half: float,
    states: Floats,
    segments: Floats,
    pushed: Bools,
    displaced: Bools,
) -> None:
    """Write Bullet's states of cylinders to all arrays; set `pushed` and `displaced`.

    Args:
        indices: Rows (k,) of the cylinders.
        bodies: State, velocity and spin (k, 13) of each.
        x: Position of base_link, m.
        y: Position of base_link, m.
        yaw: Yaw of base_link, rad.
        extent: x_min, y_min, x_max, y_max (4,) of the robot in base_link, m.
        homes: Centers (n, 2) of all cylinders at the start, m.
        radius: Radius of the cylinders, m.
        half: Half their height, m.
        states: State (n, 7) of each cylinder, replaced.
        segments: Axes (n, 4) seen from above, replaced.
        pushed: Whether each moves or touches the robot (n,), replaced.
        displaced: Whether an end of its axis has been away from home (n,), set.
    """
    for k in range(len(indices)):
        i = indices[k]
        states[i] = bodies[k, :7]
        ux, uy, _ = _axis(states[i])
        segment = segments[i]
        segment[0] = states[i, 0] - half * ux
        segment[1] = states[i, 1] - half * uy
        segment[2] = states[i, 0] + half * ux
        segment[3] = states[i, 1] + half * uy
        for end in range(0, 4, 2):
            dx = segment[end] - homes[i, 0]
            dy = segment[end + 1] - homes[i, 1]
            if math.hypot(dx, dy) > MOVED_M:
                displaced[i] = True
        speed = np.linalg.norm(bodies[k, 7:10])
        spin = np.linalg.norm(bodies[k, 10:13])
        # Touch counts even at rest: the robot is about to push it, and with it its
        # neighbors.
        is_touched = robot_gap(segment, x, y, yaw, extent) < radius + TOUCH_GAP_M
        pushed[i] = is_touched or speed > _REST_M_S or spin > _REST_RAD_S


@kernel
def intersect_cylinders(
    indices: Integers,
    states: Floats,
    half: float,
    height: float,
    centers: Floats,
    tilted: Floats,
) -> int:
    """Write circles at a height (or inf) to `centers`, others to `tilted`; count those.

    Args:
        indices: Rows of the cylinders.
        states: State (n, 7) of all cylinders.
        half: Half their height, m.
        height: Height of the plane above the ground, m.
        centers: Filled in (n, 2): center of the circle in the plane, or infinity.
        tilted: Filled in (m, 7) for the others, see `Lidar.scan`.

    Returns:
        The number of rows of `tilted`.
    """
    count = 0
    for i in indices:
        ux, uy, uz = _axis(states[i])
        rise = height - states[i, 2]
        centers[i] = np.inf
        # A tilted cylinder cuts the plane in an ellipse, which `_cast_tilted`
        # intersects in space.
        if abs(uz) < _UPRIGHT:
            row = tilted[count]
            row[0] = states[i, 0]
            row[1] = states[i, 1]
            row[2] = -rise
            row[3] = ux
            row[4] = uy
            row[5] = uz
            row[6] = half
            count += 1
        # A slight tilt shifts the circle by rise times slope and leaves it a circle.
        elif abs(rise / uz) <= half:
            centers[i, 0] = states[i, 0] + rise / uz * ux
            centers[i, 1] = states[i, 1] + rise / uz * uy
    return count


@kernel
def _axis(state: Floats) -> tuple[float, float, float]:
    """Return the unit vector along the axis of a cylinder by its state (7,)."""
    x, y, z, w = state[3], state[4], state[5], state[6]
    return 2.0 * (x * z + w * y), 2.0 * (y * z - w * x), 1.0 - 2.0 * (x * x + y * y)
