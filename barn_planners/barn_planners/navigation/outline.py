"""Footprints as convex outlines in base_link, in the text form that Nav2's parameter `footprint` has, too."""

import json
import math
from collections.abc import Sequence
from itertools import pairwise

from barn_worlds.geometry.polygon import Corner, area, contains, hull

RULE = "must be corners [[x, y], ...] in m of a convex outline around base_link, counter-clockwise"
_MOST_CORNERS = 64


def text_of(corners: Sequence[Corner]) -> str:
    """Return corners as `corners_of` reads them, to a tenth of a millimetre."""
    return json.dumps([[round(x, 4), round(y, 4)] for x, y in corners])


def corners_of(text: str) -> tuple[Corner, ...] | None:
    """Return the corners of a convex outline around the origin, counter-clockwise; None if a text is none."""
    try:
        corners = tuple((float(x), float(y)) for x, y in json.loads(text))
    except (TypeError, ValueError):
        return None
    finite = all(math.isfinite(x) and math.isfinite(y) for x, y in corners)
    if not (finite and 3 <= len(corners) <= _MOST_CORNERS and area(corners) > 0.0 and contains(corners, (0.0, 0.0))):
        return None
    return corners if set(hull(corners)) == set(corners) else None


def grown(corners: Sequence[Corner], by_m: float) -> tuple[Corner, ...]:
    """Return a convex outline with each side moved outwards; a rectangle's half sizes grow by as much."""
    sides = [_side(a, b) for a, b in pairwise((*corners, *corners[:1]))]
    moved = []
    for (px, py, pd), (qx, qy, qd) in zip((*sides[-1:], *sides[:-1]), sides, strict=True):
        across = px * qy - py * qx
        p, q = pd + by_m, qd + by_m
        moved.append(((p * qy - q * py) / across, (q * px - p * qx) / across))
    return tuple(moved)


def nearest_side_m(corners: Sequence[Corner]) -> float:
    """Return the distance of base_link from the nearest side of a convex outline, below 0 outside it."""
    points = [(float(x), float(y)) for x, y in corners]
    return min(_side(a, b)[2] for a, b in pairwise((*points, points[0])))


def _side(a: Corner, b: Corner) -> tuple[float, float, float]:
    """Return the outward normal of a side and its distance from the origin along it."""
    length = math.dist(a, b)
    x, y = (b[1] - a[1]) / length, (a[0] - b[0]) / length
    return x, y, x * a[0] + y * a[1]
