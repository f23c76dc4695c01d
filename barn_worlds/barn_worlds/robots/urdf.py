"""Mass, center of mass, inertia and wheels of a robot from its URDF.

All links together are one rigid body. xacro expands its files, if it is installed.
"""

import re
import resource
import shutil
import subprocess  # nosec B404
from dataclasses import dataclass
from functools import partial
from pathlib import Path
from typing import Any
from xml.etree.ElementTree import Element, ParseError, tostring

import numpy as np
from defusedxml.common import DefusedXmlException
from defusedxml.ElementTree import fromstring

from barn_worlds.base.arrays import Floats
from barn_worlds.base.errors import (
    ConfigError,
    WorldError,
    convert_os_errors,
    find_duplicates,
    format_error,
    list_names,
    note,
    read_numbers,
    suggest,
)
from barn_worlds.base.files import read_at_most
from barn_worlds.geometry.transform import Transform, rotation_matrix

LARGEST_URDF_BYTES = 1024 * 1024
_MOST_LINKS = 1000
_XACRO_S = 20.0
_XACRO_BYTES = 1 << 30  # of memory
_LARGEST_SHIFT_M = 0.002  # between a wheel and the mirror image of its partner
_ALONG = 0.99  # least cosine between an axis and the direction that it should have
_MOMENTS = (("ixx", "ixy", "ixz"), ("ixy", "iyy", "iyz"), ("ixz", "iyz", "izz"))
_WHEEL = re.compile("wheel|tire|tyre", re.IGNORECASE)
_SIDEWAYS = re.compile(
    "mecanum|omni_?wheel|omni_?directional|holonomic|planar_move|swerve", re.IGNORECASE
)
_CASTER = re.compile("caster|castor|swivel", re.IGNORECASE)


@dataclass(frozen=True, eq=False)
class Link:
    """A link of a URDF."""

    element: Element

    pose: Transform
    """Pose in base_link."""

    parent: str
    """Name of the link that its joint is on, empty for the root."""

    joint_type: str

    axis: Floats
    """Direction (3,) in base_link that its joint turns about."""


def read_chassis(path: Path) -> tuple[dict[str, Any], str]:
    """Return `Chassis` fields that a URDF gives and what it lacks; ConfigError if bad.

    Wheels are the links with "wheel", "tire" or "tyre" but not "caster" or "swivel" in
    their names that a continuous joint turns. Their sizes and places are those of their
    collision cylinders or spheres. The height of base_link is that over the link
    base_footprint, if there is one.

    Returns:
        The fields, and a sentence on what the file lacks, empty if it lacks nothing.

    Raises:
        ConfigError: If the file cannot be read or is no URDF of a robot.
    """
    with convert_os_errors(ConfigError, path):
        content = read_at_most(path, LARGEST_URDF_BYTES)
    try:
        root = fromstring(content)
        # What xacro makes keeps its comments, which may hold its tags.
        tags = " ".join(str(element.tag) for element in root.iter())
        if path.suffix == ".xacro" or "xacro}" in tags:
            root = fromstring(_run_xacro(path))
        sideways = _SIDEWAYS.search(tostring(root, "unicode"))
        if sideways:
            note(
                f"{path}: has {sideways[0]!r} in it; its wheels are taken for plain "
                "wheels, which do not move sideways"
            )
        links = _read_links(root)
        wheels, lack = _read_wheels(links)
        fields = _read_inertia(links) | wheels
        if "base_footprint" in links:
            fields["base_height_m"] = -float(links["base_footprint"].pose.offset[2])
        return fields, lack
    except DefusedXmlException:
        raise ConfigError(
            f"{path}: document types and entities are not allowed"
        ) from None
    except (ParseError, ValueError, LookupError, WorldError) as error:
        raise ConfigError(
            f"{path}: not a URDF; missing or wrong: {format_error(error)}"
        ) from None


def _run_xacro(path: Path) -> bytes:
    """Return xacro's output for a file; ValueError or ConfigError if there is none.

    Raises:
        ValueError: If xacro is not installed or takes too long.
        ConfigError: If it fails.
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
        # Warnings come before what went wrong, names of files in lines after it.
        text = error.stderr.decode(errors="replace").rpartition("error: ")[2]
        reason = text.strip().partition("\n")[0]
        raise ConfigError(
            f"{path}: xacro failed: {format_error(reason)}; where the "
            f"robot's packages are installed, run `xacro {path.name} > robot.urdf` "
            "and use that file"
        ) from None
    return process.stdout[:LARGEST_URDF_BYTES]


def _read_links(root: Element) -> dict[str, Link]:
    """Return links by name, posed in base_link; ValueError without it or for a ring."""
    elements = root.findall("link")
    names = [element.attrib["name"] for element in elements]
    if "base_link" not in names or len(names) > _MOST_LINKS:
        raise ValueError(
            f"must have a link base_link, and 1 to {_MOST_LINKS} links"
            f"{suggest('base_link', names)}"
        )
    joints = root.findall("joint")
    children = [_child(joint, "child").attrib["link"] for joint in joints]
    parents = [_child(joint, "parent").attrib["link"] for joint in joints]
    for name in find_duplicates(names) + find_duplicates(children):
        raise ValueError(f"link {name!r:.60} must occur once, on at most one joint")
    for name in children + parents:
        if name not in names:
            raise ValueError(f"no link {name!r:.60}{suggest(name, names)}")
    roots = [name for name in names if name not in children]
    if len(roots) > 1:
        raise ValueError(
            f"links must form one tree, but {list_names(roots)} have no joint"
        )
    # Parent and joint of each link but the root.
    above = dict(zip(children, zip(parents, joints, strict=True), strict=True))
    base = _pose_in_root("base_link", above)
    links = {}
    for name, element in zip(names, elements, strict=True):
        # base_link need not be the root of the tree.
        pose = base.inverse() @ _pose_in_root(name, above)
        parent, joint = above.get(name, ("", Element("joint")))
        links[name] = Link(
            element,
            pose,
            parent,
            joint.get("type", ""),
            pose.rotation @ _read_triple(joint, "axis", "xyz", "1 0 0"),
        )
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
    """Return `Chassis` fields of mass, center, moments of all links, or ValueError."""
    masses: list[float] = []
    centers = []
    tensors = []
    for link in links.values():
        inertial = link.element.find("inertial")
        if inertial is None:
            continue
        pose = link.pose @ _read_origin(inertial)
        masses += _read(_child(inertial, "mass"), "value")
        centers.append(pose.offset)
        inertia = _child(inertial, "inertia")
        moments = [[_read(inertia, key) for key in row] for row in _MOMENTS]
        tensor = np.array(moments).reshape(3, 3)
        tensors.append(pose.rotation @ tensor @ pose.rotation.T)
    mass = sum(masses)
    if mass <= 0.0 or min(masses) < 0.0:
        raise ValueError("no link has a mass, or a mass is below 0")
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
    """Return wheels' `Chassis` fields and, in words, what is missing, or ValueError."""
    names = [name for name in links if _WHEEL.search(name) and not _CASTER.search(name)]
    wheels = [name for name in names if links[name].joint_type == "continuous"]
    if not wheels and names:
        return {}, f"no wheels: no continuous joint turns {list_names(names)}"
    if not wheels:
        return {}, "no wheels: no link has wheel, tire or tyre in its name"
    sizes = np.array([_read_size(links[name]) for name in wheels])
    x, y, z, radius, width = sizes.T
    for name, size in zip(wheels, sizes, strict=True):
        problem = _find_misplacement(links, name)
        # A driven wheel has a partner on the other side; one in the middle is a caster.
        mirrored = size[:3] * [1.0, -1.0, 1.0]
        off_m = np.abs(sizes[:, :3] - mirrored).max(axis=1).min()
        if off_m > _LARGEST_SHIFT_M or abs(size[1]) <= _LARGEST_SHIFT_M:
            problem = problem or "has no partner on the other side"
        if problem:
            raise ValueError(
                f"wheel {name!r:.60} {problem}; if it is a caster, name it so and give "
                "casters_m"
            )
    # A wheel whose radius is unknown is like the others.
    radius = np.where(radius > 0.0, radius, radius.max())
    for what, values_m in (("y", np.abs(y)), ("z", z), ("radius", radius)):
        if np.ptp(values_m) > _LARGEST_SHIFT_M:
            raise ValueError(
                f"{list_names(wheels)} must be alike, but have {what} "
                f"{values_m.round(4).tolist()} m; name casters so and give casters_m"
            )
    fields = {
        "track_m": float(np.ptp(y)),
        "wheel_z_m": float(z.mean()),
        "wheelbase_m": float(np.ptp(x)),
        "axle_x_m": 0.5 * float(x.max() + x.min()),
    }
    if radius.any():
        fields["wheel_radius_m"] = float(radius[0])
    if width.any():
        fields["wheel_width_m"] = float(width.max())
        return fields, ""
    size_name = "width" if radius.any() else "size"
    return fields, (
        f"no {size_name} of the wheels: none has a cylinder for its collision"
    )


def _read_size(wheel: Link) -> list[float]:
    """Return center x, y, z in base_link, radius and width (m; 0 if unknown).

    They are those of its largest collision cylinder or sphere, else of the link.
    """
    size = [*wheel.pose.offset.tolist(), 0.0, 0.0]
    for collision in wheel.element.iterfind("collision"):
        for shape in collision.iterfind("geometry/*"):
            (radius,) = _read(shape, "radius", "0")
            if radius > size[3]:
                # A wheel may be beside the origin of its link.
                center = wheel.pose @ _read_origin(collision)
                size = [*center.offset, radius, *_read(shape, "length", "0")]
    return size


def _find_misplacement(links: dict[str, Link], name: str) -> str:
    """Return in words that a wheel's axis is not y or that it is steered, else ""."""
    axis = links[name].axis
    if abs(axis[1]) <= _ALONG * np.linalg.norm(axis):
        return f"turns about {axis.round(3).tolist()}, not about y of base_link"
    parent = links[name].parent
    while parent in links:
        joint = links[parent]
        is_turning = joint.joint_type in ("continuous", "revolute")
        is_upright = abs(joint.axis[2]) > _ALONG * np.linalg.norm(joint.axis)
        # Exports may have wrong axes, but their names say what they are.
        if is_turning and (is_upright or "steer" in parent.lower()):
            return f"is steered, by the joint of {parent!r:.60}"
        parent = joint.parent
    return ""


def _read_origin(parent: Element) -> Transform:
    """Return the pose in an element's <origin>, the identity if it has none."""
    roll, pitch, yaw = _read_triple(parent, "origin", "rpy")
    offset = _read_triple(parent, "origin", "xyz")
    return Transform(np.array(offset), rotation_matrix(roll, pitch, yaw))


def _read_triple(
    parent: Element, tag: str, key: str, default: str = "0 0 0"
) -> list[float]:
    """Return a child attribute's three numbers; WorldError for anything else."""
    child = parent.find(tag)
    return _read(Element(tag) if child is None else child, key, default, 3)


def _read(
    element: Element, key: str, default: str | None = None, count: int = 1
) -> list[float]:
    """Return the numbers of an attribute; WorldError for anything else."""
    return read_numbers(element.get(key, default), count, f"{key} of <{element.tag}>")


def _child(parent: Element, tag: str) -> Element:
    """Return the first child element with a tag; ValueError if there is none."""
    child = parent.find(tag)
    if child is None:
        raise ValueError(f"<{parent.tag} name={parent.get('name')!r}> without <{tag}>")
    return child
