"""A strip of a route: how much room there is along it and to both sides, as a network for sequences sees it."""

from functools import cache

import numpy as np
from scipy.ndimage import map_coordinates

from barn_metrics.model.route import ClearanceMap, Route
from barn_worlds.arrays import Floats

SAMPLES = 128  # points of a route that are kept, 0.1 m apart; what lies beyond is not seen
_ASIDE_M = np.linspace(-0.6, 0.6, 17)
_FAR_M = 0.8  # clearance that counts as free
_TURN_SCALE = 10.0  # turns from point to point are small beside headings
CHANNELS = len(_ASIDE_M) + 3
HEADING, TURN, PRESENT = CHANNELS - 3, CHANNELS - 2, CHANNELS - 1


def route_strip(where: ClearanceMap, route: Route) -> Floats:
    """Return what lies beside a route, (SAMPLES, CHANNELS), zero after its end.

    Channels: the clearance on a line across the route, from -1 (none) to 1 (`_FAR_M` and more), from left to right;
    heading in radians; change of heading per sample, scaled; 1 where there is a sample.
    """
    points = route.points[:SAMPLES]
    along = np.gradient(points, axis=0)
    heading = np.unwrap(np.arctan2(along[:, 0], along[:, 1]))
    aside = np.stack([np.cos(heading), -np.sin(heading)])[:, :, None] * (_ASIDE_M / where.cell_m)
    clearance = map_coordinates(where.clearance_m, points.T[:, :, None] + aside, order=1, mode="nearest")
    strip = np.zeros((SAMPLES, CHANNELS))
    seen = strip[: len(points)]
    seen[:, :HEADING] = np.minimum(clearance, _FAR_M) / (0.5 * _FAR_M) - 1.0
    seen[:, HEADING], seen[:, TURN], seen[:, PRESENT] = heading, _TURN_SCALE * np.gradient(heading), 1.0
    return strip


def mirrored(strips: Floats) -> Floats:
    """Return strips (..., CHANNELS) of the same routes in mirrored worlds."""
    other: Floats = strips.copy()
    other[..., :HEADING] = strips[..., HEADING - 1 :: -1]
    other[..., HEADING : TURN + 1] *= -1.0
    return other


@cache
def strip_names(route: str) -> tuple[str, ...]:
    """Return the names of the numbers of a route's strip, flattened."""
    channels = [*(f"clearance_{aside:+.3f}_m" for aside in _ASIDE_M), "heading", "turn", "present"]
    return tuple(f"{route}_{sample}_{channel}" for sample in range(SAMPLES) for channel in channels)
