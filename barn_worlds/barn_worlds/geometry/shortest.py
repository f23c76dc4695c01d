"""The shortest way of a disc among equal upright cylinders, bounded from below.

A disc that keeps clear of cylinders moves as a point among discs that have both radii. The way found here is never
longer than the shortest one of such a point:

1. Each disc of radius r contains a regular polygon with corners on its circle. A shortest way among the polygons, which
   are smaller, is at most as long, goes straight from corner to corner, and touches the polygon at each.
2. Each polygon contains the disc of radius r cos(pi / corners). Two corners see each other where the segment between
   them keeps clear of these, which is so for all that see each other among the polygons, and perhaps for more.

So the shortest way over what sees each other is at most the shortest among the polygons, and that the true one.
"""

import math

import numpy as np
from numba import njit

from barn_worlds.base.arrays import Floats

CORNERS = 32  # of a polygon, whose inner radius is then 0.5 % less than the disc's
MOST_CYLINDERS = 2000  # that are searched among, in a second or two; the straight line is a bound, too
_TOUCHING = math.sin(math.pi / CORNERS)
_ROUNDING = 1e-9


def shortest_path_bound_m(
    start: Floats, goal: Floats, centres: Floats, radius_m: float
) -> float:
    """Return a lower bound of the length in m of any way from start to goal (2,) that enters no disc.

    centres (n, 2): of the discs. radius_m: of each, the moving disc's and the cylinder's together. The bound is at
    least the straight line; that line where there is no way at all or there are more than `MOST_CYLINDERS` discs.
    """
    straight_m = math.hypot(goal[0] - start[0], goal[1] - start[1])
    if not 0 < len(centres) <= MOST_CYLINDERS:
        return straight_m
    corners, outward = _corners(np.ascontiguousarray(centres), radius_m)
    points = np.concatenate((corners, np.stack((start, goal))))
    found = _search(
        points,
        outward,
        np.ascontiguousarray(centres),
        radius_m * math.cos(math.pi / CORNERS),
    )
    return max(float(found), straight_m) if math.isfinite(found) else straight_m


@njit(cache=True)
def _corners(centres: Floats, radius: float) -> tuple[Floats, Floats]:
    """Return the corners (n, 2) of the polygons that lie in no disc seen, and their directions (n, 2) from centres."""
    most = len(centres) * CORNERS + 1
    corners, outward = np.empty((most, 2)), np.empty((most, 2))
    inner = radius * math.cos(math.pi / CORNERS) - _ROUNDING
    count = 0
    for i in range(len(centres)):
        near = centres[
            np.hypot(centres[:, 0] - centres[i, 0], centres[:, 1] - centres[i, 1])
            < 2.0 * radius
        ]
        for k in range(CORNERS):
            angle = 2.0 * math.pi * k / CORNERS
            outward[count, 0], outward[count, 1] = math.cos(angle), math.sin(angle)
            corners[count] = centres[i] + radius * outward[count]
            if _sees(corners[count], corners[count], near, inner):
                count += 1
    return corners[:count], outward[:count]


@njit(cache=True)
def _sees(a: Floats, b: Floats, centres: Floats, radius: float) -> bool:
    """Tell whether the segment from a to b (2,) enters no disc."""
    dx, dy = b[0] - a[0], b[1] - a[1]
    square = max(dx * dx + dy * dy, 1e-300)
    for i in range(len(centres)):
        px, py = centres[i, 0] - a[0], centres[i, 1] - a[1]
        along = max(0.0, min(1.0, (px * dx + py * dy) / square))
        off_x, off_y = px - along * dx, py - along * dy
        if off_x * off_x + off_y * off_y < radius * radius:
            return False
    return True


@njit(cache=True)
def _search(points: Floats, outward: Floats, centres: Floats, radius: float) -> float:
    """Return the length of the shortest way over points from the last but one to the last, inf where there is none.

    A* with the straight line to the goal. outward: directions of the corners, which are the first points.
    """
    goal = len(points) - 1
    cost, left = np.full(len(points), np.inf), np.empty(len(points))
    for i in range(len(points)):
        left[i] = math.hypot(
            points[goal, 0] - points[i, 0], points[goal, 1] - points[i, 1]
        )
    done = np.zeros(len(points), np.bool_)
    cost[goal - 1] = 0.0
    while True:
        here = 0
        for i in range(len(points)):
            if not done[i] and (
                done[here] or cost[i] + left[i] < cost[here] + left[here]
            ):
                here = i
        if done[here] or not math.isfinite(cost[here]) or here == goal:
            return float(cost[goal])
        done[here] = True
        for i in range(len(points)):
            dx, dy = points[i, 0] - points[here, 0], points[i, 1] - points[here, 1]
            length = math.hypot(dx, dy)
            if done[i] or length == 0.0 or cost[here] + length >= cost[i]:
                continue
            touches = _touches(outward, here, dx, dy, length) and _touches(
                outward, i, dx, dy, length
            )
            if touches and _sees(points[here], points[i], centres, radius - _ROUNDING):
                cost[i] = cost[here] + length


@njit(cache=True)
def _touches(outward: Floats, point: int, dx: float, dy: float, length: float) -> bool:
    """Tell whether a leg touches the polygon at a corner: it lies within half the corner's angle of the tangent."""
    if point >= len(outward):  # start or goal
        return True
    return bool(
        abs(dx * outward[point, 0] + dy * outward[point, 1])
        <= (_TOUCHING + _ROUNDING) * length
    )
