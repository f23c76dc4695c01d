"""Mass, center of mass, inertia and wheels of a robot from its URDF.

All links together are one rigid body. xacro expands its files, if it is installed.
"""

import math
import re
import resource
import shutil
import subprocess  # nosec B404
from dataclasses import dataclass
from functools import partial
from pathlib import Path
from typing import Any
from xml.etree.ElementTree import Element, ParseError

import numpy as np
from defusedxml.common import DefusedXmlException
from defusedxml.ElementTree import fromstring

from barn_worlds.base.arrays import Floats
from barn_worlds.base.errors import (
    ConfigError,
    convert_os_errors,
    format_error,
    join_names,
)
from barn_worlds.base.files import read_at_most
from barn_worlds.geometry.transform import Transform, rotation_matrix

LARGEST_URDF_BYTES = 1024 * 1024
_MOST_LINKS = 1000
_XACRO_S = 20.0
_XACRO_BYTES = 1 << 30  # of memory
_LARGEST_SHIFT_M = 0.001  # between a wheel and the mirror image of its partner
_WHEEL = re.compile("wheel|tire|tyre", re.IGNORECASE)
_CASTER = re.compile("caster|castor|swivel", re.IGNORECASE)


@dataclass(frozen=True, eq=False)
class Link:
    """A link of a URDF."""

    element: Element

    pose: Transform
    """Pose in base_link."""

    is_turning: bool
    """Whether its joint is continuous, as that of a wheel."""


def read_chassis(path: Path) -> tuple[dict[str, Any], str]:
    """Return `Chassis` fields that a URDF gives and what it lacks; ConfigError if bad.

    Wheels are the links with "wheel", "tire" or "tyre" but not "caster" or "swivel" in
    their names that a continuous joint turns. Their sizes are those of their collision
    cylinders. The height of base_link is that over the link base_footprint, if there is
    one.

    Returns:
        The fields, and a sentence on what the file lacks, empty if it lacks nothing.

    Raises:
        ConfigError: If the file cannot be read or is no URDF of a robot.
    """
    with convert_os_errors(ConfigError, path):
        content = read_at_most(path, LARGEST_URDF_BYTES)
    try:
        if path.suffix == ".xacro" or b"<xacro:" in content:
            content = _run_xacro(path)
        links = _read_links(fromstring(content))
        wheels, lack = _read_wheels(links)
        fields = _read_inertia(links) | wheels
        if "base_footprint" in links:
            fields["base_height_m"] = -float(links["base_footprint"].pose.offset[2])
        return fields, lack
    except (ParseError, DefusedXmlException, ValueError, LookupError) as error:
        raise ConfigError(
            f"{path}: not a URDF that can be used: {format_error(error)}"
        ) from None


def _run_xacro(path: Path) -> bytes:
    """Return the URDF that xacro makes of a file, limited; ValueError if it fails.

    Raises:
        ValueError: If xacro is not installed, fails or exceeds its limits.
    """
    program = shutil.which("xacro")
    if program is None:
        raise ValueError(
            "it needs xacro, which is not installed; on a computer that has it, run "
            f"`xacro {path.name} > robot.urdf` and use that file"
        )
    memory = (_XACRO_BYTES, _XACRO_BYTES)
    try:
        process = subprocess.run(  # noqa: S603 (no shell)  # nosec B603
            [program, str(path.absolute())],
            capture_output=True,
            check=True,
            timeout=_XACRO_S,
            preexec_fn=partial(resource.setrlimit, resource.RLIMIT_AS, memory),
        )
    except subprocess.TimeoutExpired:
        raise ValueError(f"xacro did not end within {_XACRO_S:g} s") from None
    except subprocess.CalledProcessError as error:
        # Its last line is what went wrong.
        reason = error.stderr.decode(errors="replace").strip().rpartition("\n")[2]
        raise ValueError(f"xacro failed: {format_error(reason)}") from None
    return process.stdout[:LARGEST_URDF_BYTES]


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
    """Return a link's pose in the root of the tree; ValueError if joints make a ring.

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
        raise ValueError("no link has a mass, or a mass is not a finite number")
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


def _read_wheels(links: dict[str, Link]) -> tuple[dict[str, Any], str]:
    """Return `Chassis` fields of the wheels, and what is missing of them in words."""
    names = [name for name in links if _WHEEL.search(name) and not _CASTER.search(name)]
    wheels = [links[name] for name in names if links[name].is_turning]
    if not wheels and names:
        return {}, f"no wheels: no continuous joint turns {join_names(names)}"
    if not wheels:
        return {}, "no wheels: no link has wheel, tire or tyre in its name"
    positions = np.array([wheel.pose.offset for wheel in wheels])
    for wheel in wheels:
        # A driven wheel has a partner on the other side; one in the middle is a caster.
        mirrored = wheel.pose.offset * [1.0, -1.0, 1.0]
        off_m = np.abs(positions - mirrored).max(axis=1).min()
        if off_m > _LARGEST_SHIFT_M or abs(mirrored[1]) <= _LARGEST_SHIFT_M:
            name = wheel.element.get("name")
            raise ValueError(
                f"wheel {name!r:.60} has no partner on the other side; if it is a "
                "caster, name it so and give casters_m"
            )
    x, y, z = positions.T
    front = float(x.max())
    rear = float(x.min())
    fields = {
        "track_m": float(np.ptp(y)),
        "wheel_z_m": float(z.mean()),
        "wheelbase_m": front - rear,
        "axle_x_m": 0.5 * (front + rear),
    }
    # Wheels are alike; the first with a collision of a simple shape gives their size.
    for wheel in wheels:
        for shape in wheel.element.iterfind("collision/geometry/*"):
            if shape.tag in ("cylinder", "sphere"):
                fields.setdefault("wheel_radius_m", float(shape.attrib["radius"]))
            if shape.tag == "cylinder":
                fields.setdefault("wheel_width_m", float(shape.attrib["length"]))
    if "wheel_width_m" in fields:
        return fields, ""
    size = "width" if "wheel_radius_m" in fields else "size"
    return fields, f"no {size} of the wheels: none has a cylinder for its collision"


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
