"""The shortest path of a disc among equal upright cylinders, bounded from below.

A disc that keeps clear of cylinders moves as a point among discs that have both radii.
The path of this module is never longer than the shortest one of that point:

1. Each disc of radius r contains a regular polygon with corners on its circle. The
   polygons are smaller, so a shortest path among them is at most as long. It goes
   straight from corner to corner, and touches the polygon at each.
2. Each polygon contains the disc of radius r cos(pi / corners). Two corners see each
   other where the segment between them keeps clear of these discs. All pairs that see
   each other among the polygons do so, and perhaps more.

So the shortest path over pairs that see each other is at most as long as the shortest
among the polygons, and that one at most as long as the true one.
"""

import math

import numpy as np

from barn_worlds.base.arrays import Floats, strict_kernel

# Of a polygon, whose inner radius is then 0.5% less than the disc's.
CORNERS = 32
# Searched in a second or two; among more, some are left out.
MOST_CYLINDERS = 2000
_INNER_SHARE = math.cos(math.pi / CORNERS)
# Sine of half the angle between two neighboring corners.
_TOUCHING = math.sin(math.pi / CORNERS)
# Discs shrink by this, so that rounding never makes the bound too long.
_ROUNDING = 1e-9


def shortest_path_bound_m(
    start: Floats, goal: Floats, centers: Floats, radius_m: float
) -> float:
    """Return a lower bound in m on the length of any path that enters no disc.

    Args:
        start: Where the path begins, (2,).
        goal: Where it ends, (2,).
        centers: Of the discs, (n, 2).
        radius_m: Of each disc: the moving disc's and the cylinder's together.

    Returns:
        The bound, at least the straight line. It is that line where there is no path at
        all.
    """
    straight_m = math.hypot(goal[0] - start[0], goal[1] - start[1])
    if not len(centers):
        return straight_m

    # A shortest path among some of the discs is never longer than among all. The discs
    # of a wall overlap, so one per square of half their radius closes it as well.
    if len(centers) > MOST_CYLINDERS:
        squares = np.floor(centers / (radius_m / 2.0))
        _, places = np.unique(squares, axis=0, return_index=True)
        detours_m = sum(np.hypot(*(centers[places] - end).T) for end in (start, goal))
        centers = centers[places[np.argsort(detours_m)[:MOST_CYLINDERS]]]
    centers = np.ascontiguousarray(centers)
    corners, outward = _visible_corners(centers, radius_m)
    points = np.concatenate((corners, np.stack((start, goal))))
    length_m = float(_search(points, outward, centers, radius_m * _INNER_SHARE))
    return max(length_m, straight_m) if math.isfinite(length_m) else straight_m


@strict_kernel
def _visible_corners(centers: Floats, radius: float) -> tuple[Floats, Floats]:
    """Return polygon corners (n, 2) outside all inner discs, and outward directions."""
    capacity = len(centers) * CORNERS + 1
    corners = np.empty((capacity, 2))
    outward = np.empty((capacity, 2))
    inner_radius = radius * _INNER_SHARE - _ROUNDING
    count = 0
    for i in range(len(centers)):
        dx = centers[:, 0] - centers[i, 0]
        dy = centers[:, 1] - centers[i, 1]
        # Only these can cover a corner.
        neighbors = centers[np.hypot(dx, dy) < 2.0 * radius]
        for k in range(CORNERS):
            angle = 2.0 * math.pi * k / CORNERS
            outward[count, 0] = math.cos(angle)
            outward[count, 1] = math.sin(angle)
            corners[count] = centers[i] + radius * outward[count]
            if _sees(corners[count], corners[count], neighbors, inner_radius):
                count += 1
    return corners[:count], outward[:count]


@strict_kernel
def _sees(a: Floats, b: Floats, centers: Floats, radius: float) -> bool:
    """Tell whether the segment from a to b (2,) enters no disc of `radius`."""
    dx = b[0] - a[0]
    dy = b[1] - a[1]
    # The bound makes a segment of length 0 a point.
    square = max(dx * dx + dy * dy, 1e-300)
    for i in range(len(centers)):
        px = centers[i, 0] - a[0]
        py = centers[i, 1] - a[1]
        along = max(0.0, min(1.0, (px * dx + py * dy) / square))
        offset_x = px - along * dx
        offset_y = py - along * dy
        if offset_x * offset_x + offset_y * offset_y < radius * radius:
            return False
    return True


@strict_kernel
def _search(points: Floats, outward: Floats, centers: Floats, radius: float) -> float:
    """Return the length in m of the shortest path from start to goal, inf without one.

    It leads from the last but one point to the last, by A* with the straight line to
    the goal as the heuristic.

    Args:
        points: Corners of polygons, then start and goal, (n + 2, 2).
        outward: Directions (n, 2) of the corners from their centers.
        centers: Of the discs, (m, 2).
        radius: Of the inner discs, which block sight.
    """
    goal = len(points) - 1
    remaining = np.empty(len(points))
    for i in range(len(points)):
        dx = points[goal, 0] - points[i, 0]
        dy = points[goal, 1] - points[i, 1]
        remaining[i] = math.hypot(dx, dy)

    cost = np.full(len(points), np.inf)
    done = np.zeros(len(points), np.bool_)
    cost[goal - 1] = 0.0
    while True:
        # Nearly all pairs are looked at anyway, so a heap would not help.
        current = 0
        for i in range(len(points)):
            total = cost[i] + remaining[i]
            is_better = total < cost[current] + remaining[current]
            if not done[i] and (done[current] or is_better):
                current = i
        if done[current] or not math.isfinite(cost[current]) or current == goal:
            return float(cost[goal])
        done[current] = True

        for i in range(len(points)):
            dx = points[i, 0] - points[current, 0]
            dy = points[i, 1] - points[current, 1]
            length = math.hypot(dx, dy)
            if done[i] or length == 0.0 or cost[current] + length >= cost[i]:
                continue
            touches = _touches(outward, current, dx, dy, length) and _touches(
                outward, i, dx, dy, length
            )
            if touches and _sees(
                points[current], points[i], centers, radius - _ROUNDING
            ):
                cost[i] = cost[current] + length


@strict_kernel
def _touches(outward: Floats, point: int, dx: float, dy: float, length: float) -> bool:
    """Tell whether a leg dx, dy touches the polygon at corner `point`.

    It does if it lies within half the corner's angle of the tangent. Start and goal,
    which have no direction, are touched by every leg.
    """
    if point >= len(outward):
        return True
    radial = abs(dx * outward[point, 0] + dy * outward[point, 1])
    return bool(radial <= (_TOUCHING + _ROUNDING) * length)
