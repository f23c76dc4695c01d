"""The robot's rigid body, and the URDF that is published as robot_description.

The body is made of the robot's `Chassis`, and so is its URDF unless it comes with one. It includes the wheels' masses;
`tyres` says why the wheels are not joints.
"""

import math
from dataclasses import dataclass
from functools import cache, cached_property
from importlib import resources
from xml.etree.ElementTree import tostring

import jinja2
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
    """A collision primitive at `centre` (3,) in base_link, with the half sizes (3,) of the box around it.

    radius_m: of a cylinder, along y or upright. corners (k, 2): of an upright prism, about its centre.
    """

    centre: Floats
    half_sizes: Floats
    radius_m: float = 0.0
    upright: bool = False
    corners: Floats | None = None


@dataclass(frozen=True, eq=False)
class RobotModel:
    """A rigid body on wheels and casters, in base_link.

    centre_of_mass (3,); inertia (3,) moments about it (the products, 0.2 % of them on the Jackal, are left out); wheels
    (n, 3) centres, left and right in turn, the front ones first; footing (3,) the point of base_footprint, which
    touches the ground. casters (k, 3): points as high as the wheels' centres, above where casters touch the ground.
    """

    name: str
    mass_kg: float
    centre_of_mass: Floats
    inertia: Floats
    shapes: tuple[Shape, ...]
    wheels: Floats
    wheel_radius_m: float
    footing: Floats
    casters: Floats

    @property
    def track_m(self) -> float:
        """Distance between the left and the right wheels."""
        return float(self.wheels[0, 1] - self.wheels[1, 1])

    @cached_property
    def extent(self) -> Floats:
        """x_min, y_min, x_max, y_max of the collision shapes in base_link."""
        centres = np.array([shape.centre[:2] for shape in self.shapes])
        halves = np.array([shape.half_sizes[:2] for shape in self.shapes])
        return np.concatenate(
            [(centres - halves).min(axis=0), (centres + halves).max(axis=0)]
        )

    @cached_property
    def reach_m(self) -> float:
        """Distance from base_link to the farthest corner of that."""
        return math.hypot(*np.abs(self.extent).reshape(2, 2).max(axis=0).tolist())


@cache
def model_of(chassis: Chassis) -> RobotModel:
    """Return the model of a robot."""
    wheels = np.array(chassis.wheels_m)
    return RobotModel(
        chassis.name,
        chassis.mass_kg,
        np.array(chassis.centre_of_mass_m),
        np.array(chassis.inertia_kg_m2),
        _shapes_of(chassis, wheels),
        wheels,
        chassis.wheel_radius_m,
        np.array([0.0, 0.0, -chassis.base_height_m]),
        np.array([(x, y, chassis.wheel_z_m) for x, y in chassis.casters_m]).reshape(
            -1, 3
        ),
    )


def wheel_names(chassis: Chassis) -> tuple[str, ...]:
    """Return the names of the wheels, in the order of `Chassis.wheels_m`."""
    return WHEELS if chassis.wheelbase_m else _ONE_AXLE


def joint_names(chassis: Chassis) -> tuple[str, ...]:
    """Return the names of the joints that move: the wheels'."""
    return tuple(f"{name}_joint" for name in wheel_names(chassis))


def _shapes_of(chassis: Chassis, wheels: Floats) -> tuple[Shape, ...]:
    """Return the body as a box, an upright cylinder or a prism, and the wheels beside it.

    A prism has no wheels: they are within the footprint, and PyBullet makes no compound with a prism.
    """
    low, high = (
        edge - chassis.base_height_m
        for edge in (chassis.ground_clearance_m, chassis.body_height_m)
    )
    x_min, y_min, x_max, y_max = chassis.body_extent_m
    centre = 0.5 * np.array([x_min + x_max, y_min + y_max, low + high])
    half_sizes = 0.5 * np.array([x_max - x_min, y_max - y_min, high - low])
    if not chassis.is_round and not chassis.is_rectangular:
        return (
            Shape(centre, half_sizes, corners=np.array(chassis.hull_m) - centre[:2]),
        )
    radius = chassis.wheel_radius_m
    rim = np.array([radius, 0.5 * chassis.wheel_width_m, radius])
    body = Shape(centre, half_sizes, chassis.footprint_radius_m, upright=True)
    return (body, *(Shape(hub, rim, radius) for hub in wheels))


@cache
def description_text(chassis: Chassis) -> str:
    """Return the URDF of a robot; where its lidar is, `robot_description` says.

    One that is made has the links of the Jackal's: body, with all of the mass, wheels and lidar. A body that is a prism
    is drawn as the box around it, a caster as a ball below the body.
    """
    if chassis.description:
        file = resources.files("barn_worlds") / "data" / "robots" / chassis.description
        return file.read_text(encoding="utf-8")
    loader = jinja2.PackageLoader("barn_sim", "data")
    environment = jinja2.Environment(
        loader=loader,
        autoescape=True,
        keep_trailing_newline=True,
        trim_blocks=True,
        lstrip_blocks=True,
    )
    environment.filters["numbers"] = lambda numbers: " ".join(
        f"{number:.9g}" for number in numbers
    )
    return environment.get_template("robot.urdf.jinja").render(
        chassis=chassis, wheels=wheel_names(chassis)
    )


def robot_description(lidar: LidarConfig, chassis: Chassis) -> str:
    """Return the URDF of a robot with the lidar where `lidar` mounts it."""
    root = fromstring(description_text(chassis))
    origin = root.find("joint[@name='lidar_joint']/origin")
    assert origin is not None
    origin.set("xyz", f"{lidar.mount_x_m:g} {lidar.mount_y_m:g} {lidar.mount_z_m:g}")
    if lidar.mount_yaw_rad:
        origin.set("rpy", f"0 0 {lidar.mount_yaw_rad:g}")
    return tostring(root, encoding="unicode")


def fixed_frames(
    lidar: LidarConfig, chassis: Chassis
) -> dict[str, tuple[float, float, float]]:
    """Return the positions of the fixed frames in base_link, by name."""
    root = fromstring(robot_description(lidar, chassis))
    found = {}
    for joint in root.iterfind("joint[@type='fixed']"):
        text = (
            next((origin.get("xyz") for origin in joint.iter("origin")), None)
            or "0 0 0"
        )
        x, y, z = map(float, text.split())
        found[next(joint.iter("child")).attrib["link"]] = x, y, z
    return found
