"""Plain polygons with a few corners, as tuples of (x, y) in metres."""

import math
from collections.abc import Sequence
from itertools import pairwise

Corner = tuple[float, float]


def area(corners: Sequence[Corner]) -> float:
    """Return the enclosed area in m2, positive if the corners run counter-clockwise."""
    sides = zip(corners, [*corners[1:], *corners[:1]], strict=True)
    return 0.5 * sum(x * v - u * y for (x, y), (u, v) in sides)


def contains(corners: Sequence[Corner], point: Corner, slack_m: float = 1e-9) -> bool:
    """Tell whether a point is in a convex polygon of counter-clockwise corners, or within `slack_m` of it."""
    sides = zip(corners, [*corners[1:], *corners[:1]], strict=True)
    return all(_turn(a, b, point) >= -slack_m * math.dist(a, b) for a, b in sides)


def convex_hull(points: Sequence[Corner]) -> tuple[Corner, ...]:
    """Return the convex hull of points, counter-clockwise and without corners on straight sides."""
    ordered = sorted(set(points))
    if len(ordered) < 3:
        return tuple(ordered)
    return (*_chain(ordered), *_chain(ordered[::-1]))


def regular_polygon(radius_m: float, count: int) -> tuple[Corner, ...]:
    """Return the regular polygon around a circle about the origin, two of its sides across x where count is even."""
    step = 2.0 * math.pi / count
    reach = radius_m / math.cos(0.5 * step)
    return tuple(
        (reach * math.cos((k + 0.5) * step), reach * math.sin((k + 0.5) * step))
        for k in range(count)
    )


def offset(corners: Sequence[Corner], by_m: float) -> tuple[Corner, ...]:
    """Return a convex outline with each side moved outwards; a rectangle's half sizes grow by as much."""
    sides = [_side(a, b) for a, b in pairwise((*corners, *corners[:1]))]
    moved = []
    for (px, py, pd), (qx, qy, qd) in zip(
        (*sides[-1:], *sides[:-1]), sides, strict=True
    ):
        across = px * qy - py * qx
        p, q = pd + by_m, qd + by_m
        moved.append(((p * qy - q * py) / across, (q * px - p * qx) / across))
    return tuple(moved)


def nearest_side_m(corners: Sequence[Corner]) -> float:
    """Return the distance of base_link from the nearest side of a convex outline, below 0 outside it."""
    points = [(float(x), float(y)) for x, y in corners]
    return min(_side(a, b)[2] for a, b in pairwise((*points, points[0])))


def _chain(ordered: Sequence[Corner]) -> list[Corner]:
    """Return one side of the hull without its last corner."""
    kept: list[Corner] = []
    for point in ordered:
        while len(kept) > 1 and _turn(kept[-2], kept[-1], point) <= 0.0:
            kept.pop()
        kept.append(point)
    return kept[:-1]


def _turn(a: Corner, b: Corner, c: Corner) -> float:
    """Return twice the area of a triangle, positive if it turns left."""
    return (b[0] - a[0]) * (c[1] - a[1]) - (b[1] - a[1]) * (c[0] - a[0])


def _side(a: Corner, b: Corner) -> tuple[float, float, float]:
    """Return the outward normal of a side and its distance from the origin along it."""
    length = math.dist(a, b)
    x, y = (b[1] - a[1]) / length, (a[0] - b[0]) / length
    return x, y, x * a[0] + y * a[1]
