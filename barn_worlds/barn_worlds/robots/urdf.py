"""Mass, center of mass, inertia and wheels of a robot from its URDF.

All links together are one rigid body. xacro must have been run before.
"""

import math
from dataclasses import dataclass
from pathlib import Path
from typing import Any
from xml.etree.ElementTree import Element, ParseError

import numpy as np
from defusedxml.common import DefusedXmlException
from defusedxml.ElementTree import fromstring

from barn_worlds.base.arrays import Floats
from barn_worlds.base.errors import ConfigError, convert_os_errors, format_error
from barn_worlds.base.files import read_at_most
from barn_worlds.geometry.transform import Transform, rotation_matrix

LARGEST_URDF_BYTES = 1024 * 1024
_MOST_LINKS = 1000


@dataclass(frozen=True, eq=False)
class Link:
    """A link of a URDF."""

    element: Element

    pose: Transform
    """Pose in base_link."""

    is_turning: bool
    """Whether its joint is continuous, as that of a wheel."""


def read_chassis(path: Path) -> dict[str, Any]:
    """Return the fields of `Chassis` that a URDF file gives: mass, inertia, wheels.

    Wheels are the links with "wheel" but not "caster" in their names that a continuous
    joint turns. Their sizes are those of their collision cylinders. The height of
    base_link is that over the link base_footprint, if there is one.

    Raises:
        ConfigError: If the file cannot be read or is no URDF of a robot.
    """
    with convert_os_errors(ConfigError, path):
        content = read_at_most(path, LARGEST_URDF_BYTES)
    try:
        links = _read_links(fromstring(content))
        fields = _read_inertia(links) | _read_wheels(links)
        if "base_footprint" in links:
            fields["base_height_m"] = -float(links["base_footprint"].pose.offset[2])
        return fields
    except (ParseError, DefusedXmlException, ValueError, LookupError) as error:
        raise ConfigError(
            f"{path}: not a URDF that can be used: {format_error(error)}"
        ) from None


def _read_links(root: Element) -> dict[str, Link]:
    """Return links with poses in base_link by name; ValueError if they are no tree."""
    elements = {element.attrib["name"]: element for element in root.findall("link")}
    if "base_link" not in elements or len(elements) > _MOST_LINKS:
        raise ValueError(
            f"must have a link base_link, and no more than {_MOST_LINKS} links"
        )
    # Parent and element of each joint by its child link.
    joints: dict[str, tuple[str, Element]] = {}
    for joint in root.findall("joint"):
        child = _child(joint, "child").attrib["link"]
        joints[child] = (_child(joint, "parent").attrib["link"], joint)
    base = _pose_in_root("base_link", joints)
    links = {}
    for name, element in elements.items():
        pose = _pose_in_root(name, joints)
        # base_link need not be the root of the tree.
        in_base = base.inverse() @ pose
        is_turning = name in joints and joints[name][1].get("type") == "continuous"
        links[name] = Link(element, in_base, is_turning)
    return links


def _pose_in_root(name: str, joints: dict[str, tuple[str, Element]]) -> Transform:
    """Return the pose of a link in the root of the tree.

    Args:
        name: Name of the link.
        joints: Parent link and element of the joints by the name of their child link.
    """
    # Up the tree from joint to joint. In a ring there is no end.
    pose = Transform()
    for _ in range(_MOST_LINKS):
        if name not in joints:
            return pose
        name, joint = joints[name]
        pose = _read_origin(joint) @ pose
    raise ValueError(f"joints make a ring at link {name!r}")


def _read_inertia(links: dict[str, Link]) -> dict[str, Any]:
    """Return `Chassis` fields: mass, center of mass, moments of all links together."""
    masses = []
    centers = []
    tensors = []
    for link in links.values():
        inertial = link.element.find("inertial")
        if inertial is None:
            continue
        pose = link.pose @ _read_origin(inertial)
        masses.append(float(_child(inertial, "mass").attrib["value"]))
        centers.append(pose.offset)
        tensor = _read_tensor(_child(inertial, "inertia"))
        tensors.append(pose.rotation @ tensor @ pose.rotation.T)
    mass = sum(masses)
    if not 0.0 < mass < math.inf:
        raise ValueError("no link has a mass, or one has none that is a number")
    weighted = np.array(masses)[:, None] * np.array(centers)
    center = weighted.sum(axis=0) / mass

    # Parallel axis theorem: moments about the common center of mass.
    total = np.zeros((3, 3))
    for link_mass, link_center, tensor in zip(masses, centers, tensors, strict=True):
        arm = link_center - center
        total += tensor + link_mass * (arm @ arm * np.eye(3) - np.outer(arm, arm))
    return {
        "mass_kg": mass,
        "centre_of_mass_m": tuple(center.tolist()),
        "inertia_kg_m2": tuple(np.diag(total).tolist()),
    }


def _read_wheels(links: dict[str, Link]) -> dict[str, Any]:
    """Return `Chassis` fields: positions and sizes of the wheels, empty without any."""
    wheels = [
        link
        for name, link in links.items()
        if link.is_turning and "wheel" in name and "caster" not in name
    ]
    if not wheels:
        return {}
    x, y, z = np.array([wheel.pose.offset for wheel in wheels]).T
    front = float(x.max())
    rear = float(x.min())
    fields = {
        "track_m": float(np.ptp(y)),
        "wheel_z_m": float(z.mean()),
        "wheelbase_m": front - rear,
        "axle_x_m": 0.5 * (front + rear),
    }
    # Wheels are alike; the first with a collision cylinder gives their size.
    for wheel in wheels:
        cylinder = wheel.element.find("collision/geometry/cylinder")
        if cylinder is not None:
            fields["wheel_radius_m"] = float(cylinder.attrib["radius"])
            fields["wheel_width_m"] = float(cylinder.attrib["length"])
            break
    return fields


def _read_origin(parent: Element) -> Transform:
    """Return the pose in an element's <origin>, the identity if it has none."""
    origin = parent.find("origin")
    attributes = {} if origin is None else origin.attrib
    roll, pitch, yaw = _read_triple(attributes.get("rpy", "0 0 0")).tolist()
    return Transform(
        _read_triple(attributes.get("xyz", "0 0 0")), rotation_matrix(roll, pitch, yaw)
    )


def _read_tensor(inertia: Element) -> Floats:
    """Return the inertia tensor (3, 3) in kg m2 of an <inertia> element."""
    keys = [["ixx", "ixy", "ixz"], ["ixy", "iyy", "iyz"], ["ixz", "iyz", "izz"]]
    return np.array([[float(inertia.attrib[key]) for key in row] for row in keys])


def _read_triple(text: str) -> Floats:
    """Return three finite numbers (3,) of a text, else raise ValueError."""
    numbers = np.array([float(word) for word in text.split()])
    if numbers.shape != (3,) or not np.isfinite(numbers).all():
        raise ValueError(f"must be three numbers: {text!r}")
    return numbers


def _child(parent: Element, tag: str) -> Element:
    """Return the first child element with a tag; ValueError if there is none."""
    child = parent.find(tag)
    if child is None:
        raise ValueError(f"<{parent.tag} name={parent.get('name')!r}> without <{tag}>")
    return child
