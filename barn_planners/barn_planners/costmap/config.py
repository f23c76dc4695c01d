"""Configuration of costmaps, and the text form of footprints."""

import json
import math
from collections.abc import Sequence
from dataclasses import dataclass
from functools import cached_property

import numpy as np

from barn_worlds.base.arrays import Points
from barn_worlds.base.config import Checked, optional, quantity
from barn_worlds.geometry.polygon import (
    Corner,
    area,
    contains,
    convex_hull,
    nearest_side_m,
    offset,
)

MAX_CELLS = 16_000_000
LARGEST_SIDE_M = 200.0
_MAX_CORNERS = 64


@dataclass(frozen=True)
class CostmapConfig(Checked):
    """A costmap fed by a lidar; the defaults are the Jackal's local costmap."""

    resolution_m: float = quantity(0.05, "side of a cell", "m", 0.005, 1.0)
    size_m: float = quantity(
        10.0, "side of the square around the robot", "m", 1.0, LARGEST_SIDE_M
    )
    footprint_half_length_m: float = quantity(
        0.21, "half the robot's length", "m", 0.01, 5.0
    )
    footprint_half_width_m: float = quantity(
        0.165, "half the robot's width", "m", 0.01, 5.0
    )
    footprint_padding_m: float = quantity(
        0.1, "padding of the footprint on every side", "m", -0.1, 2.0
    )
    inscribed_radius_m: float = quantity(
        0.0,
        "cells within this distance of obstacles cost 253; 0: use the padded"
        " footprint's inscribed radius",
        "m",
        minimum=0.0,
    )
    inflation_radius_m: float = quantity(
        0.30,
        "cells farther than this from every obstacle have no cost",
        "m",
        minimum=0.0,
    )
    cost_scaling_per_m: float = quantity(
        10.0, "rate at which the cost falls beyond the inscribed radius", "1/m"
    )
    soft_costs: bool = quantity(
        True,
        "give cells between the inscribed and the inflation radius a cost below 253",
    )
    obstacle_range_m: float = quantity(
        2.5, "lidar hits up to this distance are marked", "m", 0.0, 100.0
    )
    raytrace_range_m: float = quantity(
        3.0, "rays clear up to this distance", "m", 0.0, 100.0
    )
    clear_footprint: bool = quantity(True, "clear the cells of the padded footprint")
    recentre_cells: int = quantity(
        1, "cells that the robot moves before the grid is recentered", "", 1, 1000
    )
    as_costmap_2d: bool = optional(
        False, "true: rays, footprint and window follow costmap_2d exactly (a quirk)"
    )
    inflates_by_front: bool = optional(
        False,
        "true: a cell's cost comes from the wavefront that arrives first (a slow quirk)",
    )
    footprint: str = optional(
        "", "convex outline [[x, y], ...] instead of the half sizes", "m"
    )
    clockwise_outline: bool = optional(
        False, "true: the footprint is drawn clockwise (a quirk)"
    )

    @property
    def inscribed_m(self) -> float:
        """Distance in m from a lethal cell up to which cells cost 253.

        It is `inscribed_radius_m` if that is set, else that of the padded footprint.
        """
        # 0 means that nobody has set it.
        return self.inscribed_radius_m or self._padded_inscribed_m

    @property
    def circumscribed_m(self) -> float:
        """Distance in m of the padded footprint's furthest corner from base_link."""
        return max(math.hypot(x, y) for x, y in self.padded_outline_m.tolist())

    @cached_property
    def padded_outline_m(self) -> Points:
        """Corners (n, 2) in m of the padded footprint in base_link, counter-clockwise.

        Those of a rectangle begin with the front left one.
        """
        padding_m = self.footprint_padding_m
        corners = parse_footprint(self.footprint)
        if corners:
            return np.array(offset(corners, padding_m))

        return rectangle(
            self.footprint_half_length_m + padding_m,
            self.footprint_half_width_m + padding_m,
        )

    @property
    def _padded_inscribed_m(self) -> float:
        """Distance in m of the padded footprint's nearest side from base_link."""
        corners = self.padded_outline_m
        if self.footprint:
            return nearest_side_m(corners.tolist())

        # The smaller of a rectangle's padded half sizes, without rounding.
        return float(corners[0].min())

    def check_rules(self) -> None:
        """Raise ConfigError unless footprint, padding and number of cells are valid."""
        self.require(
            not self.footprint or parse_footprint(self.footprint) is not None,
            "footprint",
            "must be corners [[x, y], ...] in m of a convex outline around base_link, "
            "counter-clockwise",
        )
        self.require(
            self._padded_inscribed_m > 0.0,
            "footprint_padding_m",
            "must leave a footprint",
        )
        self.require(
            (self.size_m / self.resolution_m) ** 2 <= MAX_CELLS,
            "size_m",
            f"must make at most {MAX_CELLS} cells of {self.resolution_m:g} m",
        )


@dataclass(frozen=True)
class GlobalCostmapConfig(CostmapConfig):
    """The costmap of the global plan; without a map it rolls along with the robot."""

    size_m: float = quantity(
        40.0, "smallest side of the square if there is no map", "m", 1.0, LARGEST_SIDE_M
    )
    recentre_cells: int = quantity(
        50, "cells that the robot moves before the grid is recentered", "", 1, 1000
    )
    static_layer: bool = quantity(True, "use the obstacles of the map, if there is one")
    lidar_marks: bool = quantity(True, "mark what the lidar sees, even with a map")
    map_resolution: bool = quantity(
        False, "use the map's resolution instead of resolution_m"
    )


def rectangle(half_length_m: float, half_width_m: float) -> Points:
    """Return the corners (4, 2) in m of a rectangle around base_link, front left first.

    Args:
        half_length_m: Distance of its front and rear from base_link.
        half_width_m: Distance of its sides from base_link.

    Returns:
        Corners (4, 2) in m, front left first, counter-clockwise.
    """
    x = half_length_m
    y = half_width_m
    return np.array([[x, y], [-x, y], [-x, -y], [x, -y]])


def format_footprint(corners: Sequence[Corner]) -> str:
    """Return corners in m, rounded to 0.1 mm, as the JSON text [[x, y], ...].

    It is the format of Nav2's parameter `footprint`.
    """
    # A tenth of a millimeter is far below a cell and keeps files readable.
    return json.dumps([[round(x, 4), round(y, 4)] for x, y in corners])


def parse_footprint(text: str) -> tuple[Corner, ...] | None:
    """Return the corners (x, y) in m of the JSON text [[x, y], ...], None if invalid.

    Returns:
        None if the text is not a convex outline around the origin, counter-clockwise.
    """
    try:
        # JSON, since Nav2 writes the parameter as a text of nested lists.
        corners = tuple((float(x), float(y)) for x, y in json.loads(text))
    except (TypeError, ValueError):
        return None

    # NaN would pass the comparisons below, and JSON has it.
    is_finite = all(math.isfinite(x) and math.isfinite(y) for x, y in corners)
    if (
        is_finite
        and 3 <= len(corners) <= _MAX_CORNERS
        and area(corners) > 0.0
        and contains(corners, (0.0, 0.0))
        # A corner that the hull leaves out makes the outline concave.
        and set(convex_hull(corners)) == set(corners)
    ):
        return corners

    return None
