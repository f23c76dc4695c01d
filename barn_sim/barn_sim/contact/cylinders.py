"""Positions of cylinders and distances to the robot: kernels on plain arrays.

A cylinder has a state (x, y, z of its centre, quaternion x, y, z, w) and, for distances, the segment between the ends
of its axis seen from above. That segment is a point while the cylinder stands upright.
"""

import math

import numpy as np
from numba import njit

from barn_worlds.base.arrays import Bools, Floats, Integers
from barn_worlds.geometry.kernels import rectangle_gap

_SAMPLES = 9  # per segment of 1 m: closer together than a cylinder is thick
_ROUNDING_M = 1e-9  # more than distances are rounded by


@njit(cache=True)
def near_cylinders(
    segments: Floats, among: Bools, pushed: Bools, x: float, y: float, yaw: float, extent: Floats, radius: float,
    robot_within: float, pushed_within: float,
) -> tuple[Integers, float]:  # fmt: skip
    """Return the indices of the cylinders in `among` that are near the robot or near a pushed one, and a distance.

    Any point of the robot may go so far before others are near it, m; 0 if any cylinder is pushed. segments (n, 4) m;
    extent: x_min, y_min, x_max, y_max of the robot about its pose x, y, yaw. Near means a gap below `robot_within` to
    the robot, or below `pushed_within` to a cylinder in `pushed`.
    """
    far = (
        math.hypot(max(-extent[0], extent[2]), max(-extent[1], extent[3]))
        + radius
        + robot_within
    )
    found, count, pushing = np.empty(len(segments), np.int64), 0, np.flatnonzero(pushed)
    free = math.inf if len(pushing) == 0 else 0.0
    for i in range(len(segments)):
        if not among[i]:
            continue
        ax, ay, bx, by = segments[i]
        reach = far + abs(bx - ax) + abs(by - ay)
        beyond = max(abs(ax - x), abs(ay - y)) - reach
        near = False
        if beyond < 0.0:
            gap = robot_gap(segments[i], x, y, yaw, extent)
            near = gap < radius + robot_within
            beyond = max(0.0, gap - radius - robot_within)
        if not near:
            free = min(free, beyond)
        for j in pushing:
            cx, cy, dx, dy = segments[j]
            reach = (
                2.0 * radius
                + pushed_within
                + abs(bx - ax)
                + abs(by - ay)
                + abs(dx - cx)
                + abs(dy - cy)
            )
            if not near and abs(ax - cx) < reach and abs(ay - cy) < reach:
                near = (
                    segment_gap(segments[i], segments[j]) < 2.0 * radius + pushed_within
                )
        if near:
            found[count] = i
            count += 1
    return found[:count], free - _ROUNDING_M


@njit(cache=True)
def nearest_gap(
    segments: Floats, x: float, y: float, yaw: float, extent: Floats
) -> float:
    """Return the distance in m from the robot's rectangle to the nearest of the segments (n, 4)."""
    nearest = math.inf
    reach = (
        math.hypot(max(-extent[0], extent[2]), max(-extent[1], extent[3])) + _ROUNDING_M
    )
    for i in range(len(segments)):
        ax, ay, bx, by = segments[i, 0], segments[i, 1], segments[i, 2], segments[i, 3]
        far = nearest + reach + abs(bx - ax) + abs(by - ay)
        if (ax - x) * (ax - x) + (ay - y) * (ay - y) < far * far:
            nearest = min(nearest, robot_gap(segments[i], x, y, yaw, extent))
    return nearest


@njit(cache=True)
def robot_gap(segment: Floats, x: float, y: float, yaw: float, extent: Floats) -> float:
    """Return the distance in m from the robot's rectangle to a segment (4,), 0 where it overlaps."""
    c, s, nearest = math.cos(yaw), math.sin(yaw), math.inf
    samples = 1 if segment[0] == segment[2] and segment[1] == segment[3] else _SAMPLES
    for k in range(samples):
        part = k / (_SAMPLES - 1)
        dx = segment[0] + part * (segment[2] - segment[0]) - x
        dy = segment[1] + part * (segment[3] - segment[1]) - y
        ahead, left = c * dx + s * dy, c * dy - s * dx
        nearest = min(nearest, rectangle_gap(ahead, left, extent))
    return nearest


@njit(cache=True)
def segment_gap(first: Floats, second: Floats) -> float:
    """Return the distance in m between two segments (4,), to within the spacing of the samples along the first."""
    ex, ey = second[2] - second[0], second[3] - second[1]
    length = ex * ex + ey * ey
    nearest = math.inf
    samples = 1 if first[0] == first[2] and first[1] == first[3] else _SAMPLES
    for k in range(samples):
        part = k / (_SAMPLES - 1)
        dx = first[0] + part * (first[2] - first[0]) - second[0]
        dy = first[1] + part * (first[3] - first[1]) - second[1]
        t = 0.0 if length == 0.0 else min(1.0, max(0.0, (dx * ex + dy * ey) / length))
        nearest = min(nearest, math.hypot(dx - t * ex, dy - t * ey))
    return nearest


@njit(cache=True)
def follow_cylinders(
    indices: Integers, bodies: Floats, x: float, y: float, yaw: float, extent: Floats, homes: Floats, radius: float,
    half: float, limits: tuple[float, float, float, float], states: Floats, segments: Floats, pushed: Bools,
    displaced: Bools,
) -> None:  # fmt: skip
    """Copy the bodies' states (k, 13: state, velocity, spin) of the cylinders `indices` (k,) into the arrays of all.

    A cylinder counts as pushed if it moves faster than `limits` 0 (m/s) and 1 (rad/s), or if the robot is nearer than
    `limits` 2 (m); as displaced once an end of its axis has been further than `limits` 3 (m) from its home (n, 2).
    """
    speed_limit, spin_limit, touch_gap, moved = limits
    for k in range(len(indices)):
        i = indices[k]
        states[i] = bodies[k, :7]
        ux, uy, _ = _axis(states[i])
        segment = segments[i]
        segment[0], segment[1] = states[i, 0] - half * ux, states[i, 1] - half * uy
        segment[2], segment[3] = states[i, 0] + half * ux, states[i, 1] + half * uy
        for end in range(0, 4, 2):
            if (
                math.hypot(segment[end] - homes[i, 0], segment[end + 1] - homes[i, 1])
                > moved
            ):
                displaced[i] = True
        speed, spin = np.linalg.norm(bodies[k, 7:10]), np.linalg.norm(bodies[k, 10:13])
        touched = robot_gap(segment, x, y, yaw, extent) < radius + touch_gap
        pushed[i] = touched or speed > speed_limit or spin > spin_limit


@njit(cache=True)
def see_cylinders(
    indices: Integers,
    states: Floats,
    half: float,
    height: float,
    upright: float,
    centres: Floats,
    tilted: Floats,
) -> int:
    """Write how the cylinders `indices` cross the plane at `height` to `centres` (n, 2) and `tilted` (m, 7).

    If the vertical component of the axis is at least `upright`, `centres` gets the centre of the circle in the plane;
    otherwise it gets infinity and the cylinder a row of `tilted`. Returns the number of rows.
    """
    count = 0
    for i in indices:
        ux, uy, uz = _axis(states[i])
        rise = height - states[i, 2]
        centres[i] = np.inf
        if abs(uz) < upright:
            row = tilted[count]
            row[0], row[1], row[2] = states[i, 0], states[i, 1], -rise
            row[3], row[4], row[5], row[6] = ux, uy, uz, half
            count += 1
        elif abs(rise / uz) <= half:
            centres[i, 0] = states[i, 0] + rise / uz * ux
            centres[i, 1] = states[i, 1] + rise / uz * uy
    return count


@njit(cache=True)
def _axis(state: Floats) -> tuple[float, float, float]:
    x, y, z, w = state[3], state[4], state[5], state[6]
    return 2.0 * (x * z + w * y), 2.0 * (y * z - w * x), 1.0 - 2.0 * (x * x + y * y)
