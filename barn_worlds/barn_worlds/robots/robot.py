"""Robots as data: their body, drive, lidar and odometry. `barn_worlds.robots.files` reads them from files.

Everything is in base_link: x forward, y left, z up, metres. Its origin is where commands and odometry refer to.
"""

import math
from collections.abc import Mapping
from dataclasses import dataclass, field
from functools import cached_property

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
DESCRIPTIONS = ("", "jackal.urdf")  # in the package
MOST_CORNERS = 64
_ROUND_CORNERS = 16  # of the polygon around a round footprint
MOST_CASTERS = 4
_LARGEST_M = 20.0
_OFF_GROUND_M = _OUT_M = (
    0.001  # that wheels may be off the ground, and out of the footprint, in a file
)

Triple = tuple[float, float, float]


@dataclass(frozen=True)
class Chassis(Checked):
    """The rigid body of a robot, its wheels included, and where it stands on the ground.

    Planners and physics take the convex hull of the footprint: a box if it is a rectangle along x and y, else a prism;
    a round robot is an upright cylinder about base_link to the physics, and a regular polygon of 16 corners around its
    circle to planners. Wheels stand symmetrically to x.
    """

    name: str = required("name of the robot")
    kind: str = required("kind of drive", choices=KINDS)
    mass_kg: float = required("mass, wheels included", "kg", 0.01, 10_000.0)
    centre_of_mass_m: tuple[float, float, float] = required(
        "centre of mass", "m", -_LARGEST_M, _LARGEST_M
    )
    inertia_kg_m2: tuple[float, float, float] = required(
        "moments about the centre of mass", "kg m2", 1e-7, 1e6
    )
    body_height_m: float = required("top of the body over the ground", "m", 0.01, 10.0)
    ground_clearance_m: float = required(
        "bottom of the body over the ground", "m", 0.0, 5.0
    )
    base_height_m: float = required("base_link over the ground", "m", -5.0, 10.0)
    wheel_radius_m: float = required("radius of the wheels", "m", 0.005, 2.0)
    wheel_width_m: float = required("width of a wheel", "m", 0.001, 2.0)
    wheel_z_m: float = required(
        "height of the wheels' centres in base_link", "m", -10.0, 10.0
    )
    track_m: float = required(
        "distance between the centres of left and right wheels", "m", 0.01, 10.0
    )
    wheelbase_m: float = optional(
        0.0, "distance between the axles; 0 for one axle", "m", 0.0, 20.0
    )
    axle_x_m: float = optional(
        0.0, "x of the driven axle, or half way between two", "m", -10.0, 10.0
    )
    footprint_m: tuple[Corner, ...] = optional(
        (), "corners of the outline, counter-clockwise; not of a round robot", "m"
    )
    footprint_radius_m: float = optional(
        0.0, "radius of a round robot about base_link", "m", 0.0, _LARGEST_M
    )
    casters_m: tuple[Corner, ...] = optional(
        (), "x, y where casters touch the ground", "m"
    )
    body_m: tuple[float, float] = optional(
        (0.0, 0.0),
        "length and width of the body's box; 0: the outline's",
        "m",
        0.0,
        _LARGEST_M,
    )
    description: str = optional(
        "",
        "URDF that is published; empty: one made of these numbers",
        choices=DESCRIPTIONS,
    )

    def __post_init__(self) -> None:
        super().__post_init__()
        self._check_footprint()
        both = (
            "must be length and width, or neither, of a robot whose hull is a rectangle"
        )
        self.require(
            not any(self.body_m) or (all(self.body_m) and self.rectangular),
            "body_m",
            both,
        )
        self._check_wheels()
        self._check_mass()

    @property
    def round(self) -> bool:
        """Whether the footprint is a circle."""
        return self.footprint_radius_m > 0.0

    @property
    def rectangular(self) -> bool:
        """Whether the hull is a rectangle along x and y, which the physics has as a box."""
        x_min, y_min, x_max, y_max = self.extent_m
        return not self.round and set(self.hull_m) == {
            (x, y) for x in (x_min, x_max) for y in (y_min, y_max)
        }

    @cached_property
    def hull_m(self) -> tuple[Corner, ...]:
        """Corners of the convex hull of the footprint, counter-clockwise."""
        return (
            regular_polygon(self.footprint_radius_m, _ROUND_CORNERS)
            if self.round
            else convex_hull(self.footprint_m)
        )

    @property
    def extent_m(self) -> tuple[float, float, float, float]:
        """x_min, y_min, x_max, y_max of the footprint."""
        if self.round:
            radius = self.footprint_radius_m
            return -radius, -radius, radius, radius
        (left, right), (low, high) = (
            (min(side), max(side)) for side in zip(*self.hull_m, strict=True)
        )
        return left, low, right, high

    @property
    def body_extent_m(self) -> tuple[float, float, float, float]:
        """x_min, y_min, x_max, y_max of the body in the physics, without the wheels."""
        half_x, half_y = 0.5 * self.body_m[0], 0.5 * self.body_m[1]
        return (-half_x, -half_y, half_x, half_y) if half_x else self.extent_m

    @property
    def contact_extent_m(self) -> tuple[float, float, float, float]:
        """x_min, y_min, x_max, y_max of what can touch: body and wheels where the body is given, else the hull."""
        if not any(self.body_m):
            return self.extent_m
        left, low, right, high = self.body_extent_m
        half_x, half_y = self.wheel_radius_m, 0.5 * self.wheel_width_m
        x, y, _ = zip(*self.wheels_m, strict=True)
        lowest = min(left, min(x) - half_x), min(low, min(y) - half_y)
        return *lowest, max(right, max(x) + half_x), max(high, max(y) + half_y)

    @property
    def circumscribed_m(self) -> float:
        """Distance from base_link to the furthest point of the footprint."""
        return self.footprint_radius_m or float(
            max((x * x + y * y) ** 0.5 for x, y in self.hull_m)
        )

    @property
    def inscribed_m(self) -> float:
        """Distance from base_link to the nearest side of the footprint."""
        return self.footprint_radius_m or nearest_side_m(self.hull_m)

    @property
    def wheels_m(self) -> tuple[Triple, ...]:
        """Centres of the wheels: left and right of the front axle, if there are two, then of the rear or only one."""
        half, ahead = 0.5 * self.track_m, 0.5 * self.wheelbase_m
        axles = (
            (self.axle_x_m + ahead, self.axle_x_m - ahead)
            if self.wheelbase_m
            else (self.axle_x_m,)
        )
        return tuple((x, side, self.wheel_z_m) for x in axles for side in (half, -half))

    def _check_footprint(self) -> None:
        one = "is the outline of a robot that is not round; one of footprint_m and footprint_radius_m must be given"
        self.require(self.round != bool(self.footprint_m), "footprint_m", one)
        if self.round:
            return
        corners = self.footprint_m
        self._require_points("footprint_m")
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
        x, y, z = self.inertia_kg_m2
        possible = 2.0 * max(x, y, z) <= (x + y + z) * (1.0 + 1e-9)
        self.require(
            possible,
            "inertia_kg_m2",
            "must be moments of a body: none larger than the other two together",
        )
        above = f"must be above ground_clearance_m = {self.ground_clearance_m:g}"
        self.require(
            self.body_height_m > self.ground_clearance_m, "body_height_m", above
        )
        over = "must be above the ground that wheels and casters stand on, or the robot falls over"
        stands = convex_hull(
            [(x, y) for x, y, _ in self.wheels_m] + list(self.casters_m)
        )
        self.require(
            contains(stands, self.centre_of_mass_m[:2]), "centre_of_mass_m", over
        )
        ground = f"must be above the ground, {-self.base_height_m:g} m in base_link"
        self.require(
            self.centre_of_mass_m[2] + self.base_height_m > 0.0,
            "centre_of_mass_m",
            ground,
        )

    def _check_wheels(self) -> None:
        low = self.wheel_z_m + self.base_height_m - self.wheel_radius_m
        wanted = f"wheel_radius_m - base_height_m is {self.wheel_radius_m - self.base_height_m:.4g}"
        down = f"must let the wheels touch the ground, {low:+.3f} m away: {wanted}"
        self.require(abs(low) <= _OFF_GROUND_M, "wheel_z_m", down)
        if self.kind == "differential":
            one = "must be 0 for a differential drive, which has one axle"
            self.require(self.wheelbase_m == 0.0, "wheelbase_m", one)
            self.require(
                bool(self.casters_m),
                "casters_m",
                "must say where the casters of a differential drive are",
            )
        else:
            self.require(
                self.wheelbase_m > 0.0,
                "wheelbase_m",
                f"must be above 0 for {self.kind}",
            )
            self.require(
                not self.casters_m,
                "casters_m",
                f"are for a differential drive, not for {self.kind}",
            )
        self.require(
            len(self.casters_m) <= MOST_CASTERS,
            "casters_m",
            f"must be at most {MOST_CASTERS}",
        )
        self._require_points("casters_m")
        half_long, half_wide = self.wheel_radius_m, 0.5 * self.wheel_width_m
        sides = [
            (ahead * half_long, aside * half_wide)
            for ahead in (1, -1)
            for aside in (1, -1)
        ]
        corners = [
            (x + ahead, y + aside)
            for x, y, _ in self.wheels_m
            for ahead, aside in sides
        ]
        name = "footprint_radius_m" if self.round else "footprint_m"
        self.require(
            all(contains(self.hull_m, one, _OUT_M) for one in corners),
            name,
            "must enclose the wheels",
        )

    def _require_points(self, name: str) -> None:
        points = getattr(self, name)
        within = all(
            math.isfinite(x) and abs(x) <= _LARGEST_M for point in points for x in point
        )
        self.require(within, name, f"must be within {_LARGEST_M:g} m of base_link")


@dataclass(frozen=True)
class Robot(Checked):
    """A robot; sources says by section where its numbers are from."""

    chassis: Chassis
    drive: DriveConfig
    lidar: LidarConfig
    odometry: OdometryConfig = field(default_factory=OdometryConfig)
    wheel_friction: float = quantity(
        0.5, "friction coefficient of the wheels on the ground", "", 0.0, 3.0
    )
    summary: str = quantity("", "what the robot is, in one line")
    sources: Mapping[str, str] = field(default_factory=dict, hash=False)

    def __post_init__(self) -> None:
        super().__post_init__()
        under = (
            f"must be above the ground, {-self.chassis.base_height_m:g} m in base_link"
        )
        self.require(
            self.lidar.mount_z_m + self.chassis.base_height_m > 0.0,
            "lidar.mount_z_m",
            under,
        )

    @property
    def name(self) -> str:
        """Name of the robot."""
        return self.chassis.name

    @property
    def length_m(self) -> float:
        """Outer length along x."""
        left, _, right, _ = self.chassis.extent_m
        return right - left

    @property
    def width_m(self) -> float:
        """Outer width along y."""
        _, low, _, high = self.chassis.extent_m
        return high - low

    @property
    def reach_m(self) -> float:
        """How far the footprint reaches from base_link along x or y: half the side of the square around it."""
        return max(map(abs, self.chassis.extent_m))

    def footprint_cells(self, resolution_m: float) -> int:
        """Return the side, in cells and odd, of the square that the robot occupies on a grid.

        The square around base_link that the robot fits into, rounded up to whole cells with base_link in the middle of
        one: the Jackal (0.508 x 0.430 m) takes 5 x 5 cells of 0.15 m, as in the original data set.
        """
        beyond_own_cell_m = self.reach_m - resolution_m / 2.0
        return 2 * max(0, math.ceil(beyond_own_cell_m / resolution_m - 1e-9)) + 1
