"""Footprints as convex outlines in base_link, in the text form that Nav2's parameter `footprint` has, too."""

import json
import math
from collections.abc import Sequence

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
