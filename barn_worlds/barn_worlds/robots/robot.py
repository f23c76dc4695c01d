"""Robots as data: their body, drive, lidar and odometry.

`barn_worlds.robots.files` reads them from files. Positions are in base_link: x forward,
y left, z up, in meters. Commands and odometry refer to its origin.
"""

import math
from collections.abc import Mapping
from dataclasses import dataclass, field, replace
from functools import cached_property
from itertools import product

from barn_worlds.base.config import Checked, optional, quantity, required
from barn_worlds.geometry.polygon import (
    Corner,
    area,
    contains,
    convex_hull,
    nearest_side_m,
    regular_polygon,
)
from barn_worlds.robots.parts import DriveConfig, LidarConfig, OdometryConfig

KINDS = ("skid_steer", "differential")
DESCRIPTIONS = ("", "jackal.urdf")  # files in the package
MOST_CORNERS = 64
MOST_CASTERS = 4
_ROUND_CORNERS = 16  # of the polygon around a round footprint
_LARGEST_M = 20.0
# Numbers in files are rounded, so wheels may be this far off the ground or stick out of
# the footprint by as much.
_TOLERANCE_M = 0.001

Vector3 = tuple[float, float, float]
Extent = tuple[float, float, float, float]  # x_min, y_min, x_max, y_max


@dataclass(frozen=True)
class Chassis(Checked):
    """The rigid body of a robot, its wheels included, and how it stands on the ground.

    Planners and physics take the convex hull of the footprint. To the physics, a
    rectangle along x and y is a box, a round robot an upright cylinder about base_link,
    and anything else a prism. To planners, a round robot is a regular polygon around
    its circle. Wheels stand symmetrically to x.
    """

    name: str = required("name of the robot")
    kind: str = required("kind of drive", choices=KINDS)
    mass_kg: float = required("mass, wheels included", "kg", 0.01, 10_000.0)
    centre_of_mass_m: tuple[float, float, float] = required(
        "center of mass", "m", -_LARGEST_M, _LARGEST_M
    )
    inertia_kg_m2: tuple[float, float, float] = required(
        "moments about the center of mass", "kg m2", 1e-7, 1e6
    )
    body_height_m: float = required("height of the body's top", "m", 0.01, 10.0)
    ground_clearance_m: float = required(
        "height of the body's bottom above the ground", "m", 0.0, 5.0
    )
    base_height_m: float = required("height of base_link", "m", -5.0, 10.0)
    wheel_radius_m: float = required("radius of the wheels", "m", 0.005, 2.0)
    wheel_width_m: float = required("width of a wheel", "m", 0.001, 2.0)
    wheel_z_m: float = required(
        "height of the wheels' centers in base_link", "m", -10.0, 10.0
    )
    track_m: float = required(
        "distance between the centers of left and right wheels", "m", 0.01, 10.0
    )
    wheelbase_m: float = optional(
        0.0, "distance between the axles; 0 for one axle", "m", 0.0, 20.0
    )
    axle_x_m: float = optional(
        0.0, "x of the driven axle, or of the middle between two", "m", -10.0, 10.0
    )
    footprint_m: tuple[Corner, ...] = optional(
        (), "corners of the outline, counterclockwise; empty for a round robot", "m"
    )
    footprint_radius_m: float = optional(
        0.0, "radius of a round robot about base_link", "m", 0.0, _LARGEST_M
    )
    casters_m: tuple[Corner, ...] = optional(
        (), "x, y of the points where casters touch the ground", "m"
    )
    body_m: tuple[float, float] = optional(
        (0.0, 0.0),
        "length and width of the body's box; 0: those of the outline",
        "m",
        0.0,
        _LARGEST_M,
    )
    description: str = optional(
        "",
        "URDF to publish; empty: one generated from these numbers",
        choices=DESCRIPTIONS,
    )

    def check_rules(self) -> None:
        """Raise ConfigError unless footprint, body, wheels and mass fit together."""
        self._check_footprint()
        self.require(
            not any(self.body_m) or (all(self.body_m) and self.is_rectangular),
            "body_m",
            "must be length and width, or neither, "
            "of a robot whose hull is a rectangle",
        )
        self._check_wheels()
        self._check_mass()

    @property
    def is_round(self) -> bool:
        """Whether the footprint is a circle."""
        return self.footprint_radius_m > 0.0

    @property
    def is_rectangular(self) -> bool:
        """Whether the hull is a rectangle along x and y: a box to the physics."""
        x_min, y_min, x_max, y_max = self.extent_m
        # Exact comparison will do: a hull has the very numbers of the footprint.
        rectangle = set(product((x_min, x_max), (y_min, y_max)))
        return not self.is_round and set(self.hull_m) == rectangle

    @cached_property
    def hull_m(self) -> tuple[Corner, ...]:
        """Corners x, y in m of the footprint's convex hull, counterclockwise."""
        if self.is_round:
            return regular_polygon(self.footprint_radius_m, _ROUND_CORNERS)
        return convex_hull(self.footprint_m)

    @property
    def extent_m(self) -> Extent:
        """x_min, y_min, x_max, y_max in m of the rectangle around the footprint."""
        if self.is_round:
            radius = self.footprint_radius_m
            return -radius, -radius, radius, radius
        x, y = zip(*self.hull_m, strict=True)
        return min(x), min(y), max(x), max(y)

    @property
    def body_extent_m(self) -> Extent:
        """x_min, y_min, x_max, y_max in m of the body's box, else of the footprint."""
        if not any(self.body_m):
            return self.extent_m
        length, width = self.body_m
        return -0.5 * length, -0.5 * width, 0.5 * length, 0.5 * width

    @property
    def contact_extent_m(self) -> Extent:
        """x_min, y_min, x_max, y_max in m of all that can touch an obstacle.

        These are body and wheels where the file gives the body, else the footprint.
        """
        if not any(self.body_m):
            return self.extent_m
        x_min, y_min, x_max, y_max = self.body_extent_m
        x, y = zip(*self._wheel_corners(), strict=True)
        return min(x_min, *x), min(y_min, *y), max(x_max, *x), max(y_max, *y)

    @property
    def circumscribed_m(self) -> float:
        """Distance in m from base_link to the footprint's furthest point."""
        if self.is_round:
            return self.footprint_radius_m
        return float(max((x * x + y * y) ** 0.5 for x, y in self.hull_m))

    @property
    def inscribed_m(self) -> float:
        """Distance in m from base_link to the nearest side of the footprint."""
        return self.footprint_radius_m or nearest_side_m(self.hull_m)

    @property
    def wheels_m(self) -> tuple[Vector3, ...]:
        """Centers x, y, z of the wheels in m: left before right, front before rear."""
        half_track = 0.5 * self.track_m
        half_base = 0.5 * self.wheelbase_m
        # One axle, unless there is a wheelbase.
        axles = [self.axle_x_m]
        if self.wheelbase_m:
            axles = [self.axle_x_m + half_base, self.axle_x_m - half_base]
        return tuple(
            (x, y, self.wheel_z_m) for x, y in product(axles, (half_track, -half_track))
        )

    def _wheel_corners(self) -> list[Corner]:
        """Return x, y in m of the corners of all wheels, seen from above."""
        # From above a wheel is a rectangle as long as its diameter.
        half_x = self.wheel_radius_m
        half_y = 0.5 * self.wheel_width_m
        return [
            (x + side_x, y + side_y)
            for x, y, _ in self.wheels_m
            for side_x, side_y in product((half_x, -half_x), (half_y, -half_y))
        ]

    def _check_footprint(self) -> None:
        """Raise ConfigError unless there is one outline, around base_link."""
        corners = self.footprint_m
        self.require(
            self.is_round != bool(corners),
            "footprint_m",
            "is the outline of a robot that is not round; "
            "one of footprint_m and footprint_radius_m must be given",
        )
        if self.is_round:
            return
        self._require_near("footprint_m")
        self.require(
            3 <= len(corners) <= MOST_CORNERS,
            "footprint_m",
            f"must have 3 to {MOST_CORNERS} corners",
        )
        self.require(
            area(corners) > 0.0,
            "footprint_m",
            "must run counter-clockwise around some area",
        )
        self.require(
            contains(self.hull_m, (0.0, 0.0)),
            "footprint_m",
            "must have base_link, the origin, inside",
        )

    def _check_mass(self) -> None:
        """Raise ConfigError unless moments, heights and center of mass are possible."""
        # Each moment is a sum over two of three axes, so no moment of a real body is
        # larger than the other two together.
        total = sum(self.inertia_kg_m2)
        self.require(
            2.0 * max(self.inertia_kg_m2) <= total * (1.0 + 1e-9),
            "inertia_kg_m2",
            "must be moments of a body: none larger than the other two together",
        )
        self.require_order("body_height_m", "above", "ground_clearance_m")

        contacts = [(x, y) for x, y, _ in self.wheels_m]
        contacts += self.casters_m
        x, y, z = self.centre_of_mass_m
        # On the edge, the least push tips the robot over.
        self.require(
            contains(convex_hull(contacts), (x, y), -_TOLERANCE_M),
            "centre_of_mass_m",
            "must be within the ground that wheels and casters stand on, by 1 mm at "
            "least, or the robot falls over",
        )
        self.require(
            z + self.base_height_m > 0.0,
            "centre_of_mass_m",
            f"must be above the ground, {-self.base_height_m:g} m in base_link",
        )

    def _check_wheels(self) -> None:
        """Raise ConfigError unless wheels and casters suit ground and drive."""
        gap_m = self.wheel_z_m + self.base_height_m - self.wheel_radius_m
        # Where the centers would be if the wheels stood on the ground.
        resting_z_m = self.wheel_radius_m - self.base_height_m
        self.require(
            abs(gap_m) <= _TOLERANCE_M,
            "wheel_z_m",
            f"must let the wheels touch the ground, {gap_m:+.3f} m away: "
            f"wheel_radius_m - base_height_m is {resting_z_m:.4g}",
        )
        is_differential = self.kind == "differential"
        self.require(
            (self.wheelbase_m == 0.0) == is_differential,
            "wheelbase_m",
            "must be 0 for a differential drive, which has one axle, and above 0 for "
            f"skid_steer; kind is {self.kind}",
        )
        self.require(
            bool(self.casters_m) == is_differential,
            "casters_m",
            "must say where the casters of a differential drive are, such as "
            "casters_m: [[-0.2, 0.0]]; skid_steer has none",
        )
        self.require(
            len(self.casters_m) <= MOST_CASTERS,
            "casters_m",
            f"must be at most {MOST_CASTERS}",
        )
        self._require_near("casters_m")
        self.require(
            all(
                contains(self.hull_m, corner, _TOLERANCE_M)
                for corner in self._wheel_corners()
            ),
            "footprint_radius_m" if self.is_round else "footprint_m",
            "must enclose the wheels",
        )

    def _require_near(self, name: str) -> None:
        """Raise ConfigError if a field has points that are far away or no numbers."""
        # NaN fails the comparison.
        self.require(
            all(abs(x) <= _LARGEST_M for point in getattr(self, name) for x in point),
            name,
            f"must be within {_LARGEST_M:g} m of base_link",
        )


@dataclass(frozen=True)
class Robot(Checked):
    """A robot: its body, drive and sensors."""

    chassis: Chassis
    drive: DriveConfig
    lidar: LidarConfig
    odometry: OdometryConfig = field(default_factory=OdometryConfig)
    wheel_friction: float = quantity(
        0.5, "friction coefficient of the wheels on the ground", "", 0.0, 3.0
    )
    summary: str = quantity("", "one-line summary of the robot")
    # Where the numbers are from, by section of the file.
    sources: Mapping[str, str] = field(default_factory=dict, hash=False)

    def check_rules(self) -> None:
        """Raise ConfigError unless the lidar is above the ground."""
        base_height_m = self.chassis.base_height_m
        self.require(
            self.lidar.mount_z_m + base_height_m > 0.0,
            "lidar.mount_z_m",
            f"must be above the ground, {-base_height_m:g} m in base_link",
        )

    @property
    def name(self) -> str:
        """Name of the robot."""
        return self.chassis.name

    def drives_as(self, other: "Robot") -> bool:
        """Tell whether another robot is equal except for name, summary and sources."""
        chassis = replace(self.chassis, name=other.name)
        renamed = replace(
            self, chassis=chassis, summary=other.summary, sources=other.sources
        )
        return renamed == other

    @property
    def length_m(self) -> float:
        """Length in m along x of the footprint."""
        x_min, _, x_max, _ = self.chassis.extent_m
        return x_max - x_min

    @property
    def width_m(self) -> float:
        """Width in m along y of the footprint."""
        _, y_min, _, y_max = self.chassis.extent_m
        return y_max - y_min

    @property
    def reach_m(self) -> float:
        """Half the side in m of the square about base_link that the robot fits into."""
        return max(map(abs, self.chassis.extent_m))

    def footprint_cells(self, resolution_m: float) -> int:
        """Return the side in cells, odd, of the square that the robot takes on a grid.

        base_link is in the middle of a cell. The Jackal (0.508 x 0.430 m) takes 5 x 5
        cells of 0.15 m, as in the original data set.
        """
        beyond_cell_m = self.reach_m - resolution_m / 2.0
        # A robot that exactly fills its cells must not take more for a rounding error.
        return 2 * max(0, math.ceil(beyond_cell_m / resolution_m - 1e-9)) + 1
