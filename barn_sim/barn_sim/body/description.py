"""The URDF of a robot that is described by its chassis alone."""

from collections.abc import Sequence
from xml.etree.ElementTree import Element, SubElement, indent, tostring

from barn_worlds.robots.robot import Chassis

_ACROSS = "1.5707963267948966 0 0"
_SMALLEST_BALL_M = 0.01
_COLOURS = {"body": "0.30 0.42 0.60 1.0", "dark": "0.15 0.15 0.15 1.0"}


def describe(chassis: Chassis, wheels: Sequence[str]) -> str:
    """Return a URDF with the links of the Jackal's: body, wheels (by these names) and lidar, which is at base_link.

    All of the mass is in the body. A body that is a prism is drawn as the box around it, a caster as a ball below the
    body.
    """
    robot = Element("robot", name=chassis.name)
    for name, colour in _COLOURS.items():
        SubElement(SubElement(robot, "material", name=name), "color", rgba=colour)
    SubElement(robot, "link", name="base_footprint")
    _joint(robot, "base_footprint", "fixed", (0.0, 0.0, -chassis.base_height_m))
    SubElement(robot, "link", name="base_link")
    _body(robot, chassis)
    for name, place in zip(wheels, chassis.wheels_m, strict=True):
        link = SubElement(robot, "link", name=f"{name}_link")
        size = {"radius": _text(chassis.wheel_radius_m), "length": _text(chassis.wheel_width_m)}
        _shape(link, "cylinder", size, "dark", rpy=_ACROSS)
        joint = _joint(robot, f"{name}_link", "continuous", place, f"{name}_joint")
        SubElement(joint, "axis", xyz="0 1 0")
    for k, (x, y) in enumerate(chassis.casters_m):
        radius = 0.5 * max(chassis.ground_clearance_m, _SMALLEST_BALL_M)
        link = SubElement(robot, "link", name=f"caster_{k}_link")
        _shape(link, "sphere", {"radius": _text(radius)}, "dark", ("visual",))
        _joint(robot, f"caster_{k}_link", "fixed", (x, y, radius - chassis.base_height_m))
    SubElement(robot, "link", name="lidar_link")
    _joint(robot, "lidar_link", "fixed", (0.0, 0.0, 0.0), "lidar_joint")
    indent(robot)
    return tostring(robot, encoding="unicode") + "\n"


def _body(robot: Element, chassis: Chassis) -> None:
    link = SubElement(robot, "link", name="chassis_link")
    inertial = SubElement(link, "inertial")
    SubElement(inertial, "origin", xyz=_text(*chassis.centre_of_mass_m))
    SubElement(inertial, "mass", value=_text(chassis.mass_kg))
    moments = zip(("ixx", "iyy", "izz"), map(_text, chassis.inertia_kg_m2), strict=True)
    SubElement(inertial, "inertia", {**dict(moments), "ixy": "0", "ixz": "0", "iyz": "0"})
    x_min, y_min, x_max, y_max = chassis.extent_m
    height = chassis.body_height_m - chassis.ground_clearance_m
    middle = chassis.ground_clearance_m + 0.5 * height - chassis.base_height_m
    at = _text(0.5 * (x_min + x_max), 0.5 * (y_min + y_max), middle)
    if chassis.round:
        size = {"radius": _text(chassis.footprint_radius_m), "length": _text(height)}
        _shape(link, "cylinder", size, "body", xyz=at)
    else:
        _shape(link, "box", {"size": _text(x_max - x_min, y_max - y_min, height)}, "body", xyz=at)
    _joint(robot, "chassis_link", "fixed", (0.0, 0.0, 0.0), "chassis_joint")


def _shape(
    link: Element, kind: str, size: dict[str, str], colour: str, tags: Sequence[str] = ("collision", "visual"),
    **origin: str,
) -> None:  # fmt: skip
    """Add a shape to collide with and the same to see, or one of them."""
    for tag in tags:
        part = SubElement(link, tag)
        SubElement(part, "origin", origin)
        SubElement(SubElement(part, "geometry"), kind, size)
    SubElement(part, "material", name=colour)


def _joint(robot: Element, child: str, kind: str, place: Sequence[float], name: str = "") -> Element:
    joint = SubElement(robot, "joint", name=name or f"{child}_joint", type=kind)
    SubElement(joint, "parent", link="base_link")
    SubElement(joint, "child", link=child)
    SubElement(joint, "origin", xyz=_text(*place))
    return joint


def _text(*numbers: float) -> str:
    return " ".join(f"{number:.9g}" for number in numbers)
