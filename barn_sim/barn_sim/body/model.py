"""The robot's rigid body, and the URDF that is published as robot_description.

Both are made of the robot's `Chassis`, unless it comes with a URDF. The body includes
the wheels' masses; `barn_sim.body.rigid_body` explains why the wheels are not joints.
"""

import math
from dataclasses import dataclass
from functools import cache, cached_property
from importlib import resources
from xml.etree.ElementTree import tostring

import numpy as np
from defusedxml.ElementTree import fromstring

from barn_sim.config import LidarConfig
from barn_worlds.base.arrays import Floats
from barn_worlds.robots.robot import Chassis

WHEELS = (
    "front_left_wheel",
    "front_right_wheel",
    "rear_left_wheel",
    "rear_right_wheel",
)
_ONE_AXLE = ("left_wheel", "right_wheel")


@dataclass(frozen=True, eq=False)
class Shape:
    """A collision primitive: a box, a cylinder or an upright prism."""

    center: Floats
    """Position (3,) in base_link, m."""

    half_sizes: Floats
    """Half sizes (3,) of the box around the shape, m."""

    radius_m: float = 0.0
    """Radius of a cylinder."""

    upright: bool = False
    """Whether a cylinder stands upright; otherwise its axis is along y."""

    corners: Floats | None = None
    """Corners (k, 2) of a prism about its center, m."""


@dataclass(frozen=True, eq=False)
class RobotModel:
    """A rigid body on wheels and casters, in base_link."""

    name: str
    mass_kg: float

    center_of_mass: Floats
    """Position (3,), m."""

    inertia: Floats
    """Moments (3,) about the center of mass, kg m2.

    The products of inertia, 0.2% of the moments on the Jackal, are left out.
    """

    shapes: tuple[Shape, ...]

    wheels: Floats
    """Centers (n, 3) in m, left and right in turn, the front ones first."""

    wheel_radius_m: float

    casters: Floats
    """Points (k, 3) above the casters, as high as the wheels' centers, m."""

    @cached_property
    def extent(self) -> Floats:
        """x_min, y_min, x_max, y_max (4,) of the collision shapes in base_link, m."""
        centers = np.array([shape.center[:2] for shape in self.shapes])
        halves = np.array([shape.half_sizes[:2] for shape in self.shapes])
        # A round body's half sizes are its radius, so the box covers it as well.
        low = (centers - halves).min(axis=0)
        high = (centers + halves).max(axis=0)
        return np.concatenate([low, high])

    @cached_property
    def reach_m(self) -> float:
        """Distance from base_link to the farthest corner of `extent`, m."""
        # The rows are two opposite corners. On each axis the farther side counts.
        farthest = np.abs(self.extent).reshape(2, 2).max(axis=0)
        return math.hypot(*farthest.tolist())


@cache
def model_of(chassis: Chassis) -> RobotModel:
    """Return the rigid-body model of a chassis, one cached object for equal chassis."""
    wheels = np.array(chassis.wheels_m)
    # A caster counts as a ball of the wheels' radius, so its center is as high as
    # theirs.
    casters = [(x, y, chassis.wheel_z_m) for x, y in chassis.casters_m]
    return RobotModel(
        name=chassis.name,
        mass_kg=chassis.mass_kg,
        center_of_mass=np.array(chassis.centre_of_mass_m),
        inertia=np.array(chassis.inertia_kg_m2),
        shapes=_body_shapes(chassis, wheels),
        wheels=wheels,
        wheel_radius_m=chassis.wheel_radius_m,
        casters=np.array(casters).reshape(-1, 3),
    )


def wheel_names(chassis: Chassis) -> tuple[str, ...]:
    """Return the URDF link names of the wheels, in the order of `Chassis.wheels_m`."""
    # Without a wheelbase there is one axle, and casters carry the rest.
    return WHEELS if chassis.wheelbase_m else _ONE_AXLE


def joint_names(chassis: Chassis) -> tuple[str, ...]:
    """Return the URDF joint names of the wheels, in the order of `Chassis.wheels_m`."""
    return tuple(f"{name}_joint" for name in wheel_names(chassis))


def _body_shapes(chassis: Chassis, wheels: Floats) -> tuple[Shape, ...]:
    """Return collision shapes: a box or cylinder, then the wheels; or a prism alone.

    A prism has no wheels: they are within the footprint, and PyBullet makes no compound
    with a prism.
    """
    low = chassis.ground_clearance_m - chassis.base_height_m
    high = chassis.body_height_m - chassis.base_height_m
    x_min, y_min, x_max, y_max = chassis.body_extent_m
    center = 0.5 * np.array([x_min + x_max, y_min + y_max, low + high])
    half_sizes = 0.5 * np.array([x_max - x_min, y_max - y_min, high - low])
    if not chassis.is_round and not chassis.is_rectangular:
        corners = np.array(chassis.hull_m) - center[:2]
        return (Shape(center, half_sizes, corners=corners),)

    body = Shape(center, half_sizes, chassis.footprint_radius_m, upright=True)
    radius = chassis.wheel_radius_m
    # Along y, the axle: wheels lie on their sides in Bullet's terms.
    wheel_sizes = np.array([radius, 0.5 * chassis.wheel_width_m, radius])
    return (body, *(Shape(hub, wheel_sizes, radius) for hub in wheels))


@cache
def description_text(chassis: Chassis) -> str:
    """Return the URDF text of a robot from its own file, or else a generated one.

    The lidar is where the file has it.

    A generated URDF has the links of the Jackal's: the body with all of the mass,
    wheels and lidar. It shows a prism as the box around it and a caster as a ball.
    """
    if chassis.description:
        file = resources.files("barn_worlds") / "data" / "robots" / chassis.description
        return file.read_text(encoding="utf-8")
    # Only here: commands import this module to show their help.
    import jinja2  # noqa: PLC0415

    environment = jinja2.Environment(
        loader=jinja2.PackageLoader("barn_sim", "data"),
        autoescape=True,
        keep_trailing_newline=True,
        trim_blocks=True,
        lstrip_blocks=True,
    )
    # Nine digits keep micrometers and read like the original file.
    environment.filters["numbers"] = lambda numbers: " ".join(
        f"{number:.9g}" for number in numbers
    )
    template = environment.get_template("robot.urdf.jinja")
    return template.render(chassis=chassis, wheels=wheel_names(chassis))


def robot_description(lidar: LidarConfig, chassis: Chassis) -> str:
    """Return the URDF text of a robot with its lidar moved to the configured mount.

    Args:
        lidar: Mounting of the lidar in base_link.
        chassis: The robot.
    """
    root = fromstring(description_text(chassis))
    # Presets mount other lidars on the same robot, so the file's place is only a
    # default.
    origin = root.find("joint[@name='lidar_joint']/origin")
    assert origin is not None
    origin.set("xyz", f"{lidar.mount_x_m:g} {lidar.mount_y_m:g} {lidar.mount_z_m:g}")
    if lidar.mount_yaw_rad:
        origin.set("rpy", f"0 0 {lidar.mount_yaw_rad:g}")
    return tostring(root, encoding="unicode")


def fixed_frames(
    lidar: LidarConfig, chassis: Chassis
) -> dict[str, tuple[float, float, float]]:
    """Return position x, y, z (m) in base_link by name of link, of fixed joints only.

    Args:
        lidar: Mounting of the lidar in base_link.
        chassis: The robot.
    """
    root = fromstring(robot_description(lidar, chassis))
    positions = {}
    for joint in root.iterfind("joint[@type='fixed']"):
        origin = joint.find(".//origin")
        # URDF lets both the element and its attribute be left out, which means zero.
        text = "0 0 0"
        if origin is not None:
            text = origin.get("xyz", text)
        x, y, z = map(float, text.split())
        positions[next(joint.iter("child")).attrib["link"]] = (x, y, z)
    return positions
