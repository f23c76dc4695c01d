"""Plain polygons with a few corners, as tuples of (x, y) in meters."""

import math
from collections.abc import Iterator, Sequence
from itertools import pairwise
from typing import NamedTuple

Corner = tuple[float, float]


class HalfPlane(NamedTuple):
    """The inside of one side of a convex polygon and of the line through it."""

    # Unit vector that points outward.
    normal_x: float
    normal_y: float
    # Of the line from the origin along the normal, in m.
    distance: float

    @classmethod
    def of_side(cls, start: Corner, end: Corner) -> "HalfPlane":
        """Return the inner half-plane of one side of a counterclockwise polygon.

        Args:
            start: First corner of the side.
            end: Next corner, counterclockwise.
        """
        length = math.dist(start, end)
        normal_x = (end[1] - start[1]) / length
        normal_y = (start[0] - end[0]) / length
        return cls(normal_x, normal_y, normal_x * start[0] + normal_y * start[1])

    def grow(self, distance_m: float) -> "HalfPlane":
        """Return a copy whose border is moved outward by a distance in m."""
        return self._replace(distance=self.distance + distance_m)

    def intersect(self, other: "HalfPlane") -> Corner:
        """Return x, y in m where two borders meet; they must not be parallel."""
        # Cramer's rule.
        p_x, p_y, p = self
        q_x, q_y, q = other
        determinant = p_x * q_y - p_y * q_x
        return (p * q_y - q * p_y) / determinant, (q * p_x - p * q_x) / determinant


def area(corners: Sequence[Corner]) -> float:
    """Return the signed area in m2, positive if the corners run counterclockwise."""
    return 0.5 * sum(
        start[0] * end[1] - end[0] * start[1] for start, end in _sides(corners)
    )


def contains(corners: Sequence[Corner], point: Corner, slack_m: float = 1e-9) -> bool:
    """Tell whether a point is in a convex polygon, on it, or at most `slack_m` outside.

    Args:
        corners: Counterclockwise corners of the polygon.
        point: x and y.
        slack_m: How far outside the point may be, to allow for rounding.
    """
    return all(
        # Twice the area of a triangle is its side times its height over it.
        _turn(start, end, point) >= -slack_m * math.dist(start, end)
        for start, end in _sides(corners)
    )


def convex_hull(points: Sequence[Corner]) -> tuple[Corner, ...]:
    """Return the hull's corners, counterclockwise, none of them on a straight side."""
    ordered = sorted(set(points))
    if len(ordered) < 3:
        return tuple(ordered)
    # Andrew's monotone chain: along the lower side, then back along the upper one.
    return (*_half_hull(ordered), *_half_hull(ordered[::-1]))


def regular_polygon(radius_m: float, count: int) -> tuple[Corner, ...]:
    """Return the corners of a regular polygon around a circle about the origin.

    Args:
        radius_m: Radius of the circle, which every side touches.
        count: Number of sides. If it is even, two of them lie across x.
    """
    step = 2.0 * math.pi / count
    # Sides touch the circle in their middle, so corners lie farther out.
    reach = radius_m / math.cos(0.5 * step)
    angles = [(k + 0.5) * step for k in range(count)]
    return tuple((reach * math.cos(angle), reach * math.sin(angle)) for angle in angles)


def offset(corners: Sequence[Corner], distance_m: float) -> tuple[Corner, ...]:
    """Return the corners of a convex polygon with each side moved outward.

    Args:
        corners: Counterclockwise corners of the polygon, none on a straight side.
        distance_m: How far; half the sides of a rectangle grow by as much.
    """
    # A side that is moved outward keeps its normal; the new corner is where neighboring
    # sides meet.
    sides = [HalfPlane.of_side(*side).grow(distance_m) for side in _sides(corners)]
    return tuple(
        previous.intersect(side)
        for previous, side in zip((sides[-1], *sides), sides, strict=False)
    )


def nearest_side_m(corners: Sequence[Corner]) -> float:
    """Return the distance in m from the origin to the nearest side line, < 0 outside.

    Outside of the polygon it is that to the line that the origin is farthest beyond.
    """
    return min(HalfPlane.of_side(*side).distance for side in _sides(corners))


def _sides(corners: Sequence[Corner]) -> Iterator[tuple[Corner, Corner]]:
    """Return the sides of a polygon as pairs of corners, the closing side included."""
    return pairwise((*corners, corners[0]))


def _half_hull(ordered: Sequence[Corner]) -> list[Corner]:
    """Return the hull's corners on one side of sorted points, without the last one."""
    corners: list[Corner] = []
    for point in ordered:
        # Corners that turn right or go straight on lie inside the hull.
        while len(corners) > 1 and _turn(corners[-2], corners[-1], point) <= 0.0:
            corners.pop()
        corners.append(point)
    return corners[:-1]


def _turn(a: Corner, b: Corner, c: Corner) -> float:
    """Return twice the signed area of triangle a, b, c, positive if it turns left."""
    return (b[0] - a[0]) * (c[1] - a[1]) - (b[1] - a[1]) * (c[0] - a[0])
