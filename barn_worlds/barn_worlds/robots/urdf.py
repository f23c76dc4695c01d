"""What a robot's URDF gives: mass, centre of mass, inertia and wheels, of all links together.

The body is taken to be rigid. Plain URDF only: xacro must have been run.
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
from barn_worlds.base.errors import ConfigError, format_error
from barn_worlds.base.files import read_at_most

LARGEST_URDF_BYTES = 1024 * 1024
_MOST_LINKS = 1000


@dataclass(frozen=True, eq=False)
class Link:
    """A link at `offset` (3,) m, turned by `turn` (3, 3), in base_link; moves: its joint is continuous."""

    element: Element
    offset: Floats
    turn: Floats
    moves: bool


def chassis_of(path: Path) -> dict[str, Any]:
    """Return the fields of `Chassis` that a URDF file gives; ConfigError in one line if it is none.

    Wheels are the links with "wheel" in their names, but not "caster", that a continuous joint turns: their size is
    that of their collision cylinders. base_link's height is over the link base_footprint, if there is one.
    """
    try:
        root = fromstring(read_at_most(path, LARGEST_URDF_BYTES))
        links = links_of(root)
        ground = links.get("base_footprint")
        height = {"base_height_m": -float(ground.offset[2])} if ground else {}
        return _inertial(links) | _wheels(links) | height
    except (
        ParseError,
        DefusedXmlException,
        KeyError,
        ValueError,
        LookupError,
    ) as error:
        raise ConfigError(
            f"{path}: not a URDF that can be used: {format_error(error)}"
        ) from None
    except OSError as error:
        raise ConfigError(f"{path}: {error.strerror or error}") from None


def links_of(root: Element) -> dict[str, Link]:
    """Return the links of a URDF by name, placed in base_link; ValueError if they are no tree with that link."""
    links = {element.attrib["name"]: element for element in root.findall("link")}
    joints = {
        _child(joint, "child").attrib["link"]: (
            _child(joint, "parent").attrib["link"],
            joint,
        )
        for joint in root.findall("joint")
    }
    if "base_link" not in links or len(links) > _MOST_LINKS:
        raise ValueError(
            f"must have a link base_link, and no more than {_MOST_LINKS} links"
        )
    placed = {name: _in_root(name, joints) for name in links}
    base_offset, base_turn = placed["base_link"]
    moving = {
        name for name, (_, joint) in joints.items() if joint.get("type") == "continuous"
    }
    return {
        name: Link(
            links[name],
            base_turn.T @ (offset - base_offset),
            base_turn.T @ turn,
            name in moving,
        )
        for name, (offset, turn) in placed.items()
    }


def pose_of(parent: Element) -> tuple[Floats, Floats]:
    """Return position (3,) and rotation (3, 3) of an element's <origin>."""
    origin = parent.find("origin")
    attributes = {} if origin is None else origin.attrib
    return _numbers(attributes.get("xyz", "0 0 0")), rotation(
        *_numbers(attributes.get("rpy", "0 0 0")).tolist()
    )


def rotation(roll: float, pitch: float, yaw: float) -> Floats:
    """Return the matrix (3, 3) of roll, pitch and yaw about fixed axes."""
    made = np.eye(3)
    for axis, angle in enumerate((roll, pitch, yaw)):
        turn, i, j = np.eye(3), (axis + 1) % 3, (axis + 2) % 3
        turn[[i, j, j, i], [i, j, i, j]] = (
            math.cos(angle),
            math.cos(angle),
            math.sin(angle),
            -math.sin(angle),
        )
        made = turn @ made
    return made


def _in_root(
    name: str, joints: dict[str, tuple[str, Element]]
) -> tuple[Floats, Floats]:
    offset, turn = np.zeros(3), np.eye(3)
    for _ in range(_MOST_LINKS):
        if name not in joints:
            return offset, turn
        name, joint = joints[name]
        at, turned = pose_of(joint)
        offset, turn = at + turned @ offset, turned @ turn
    raise ValueError(f"joints make a ring at link {name!r}")


def _inertial(links: dict[str, Link]) -> dict[str, Any]:
    masses, centres, tensors = [], [], []
    for link in links.values():
        inertial = link.element.find("inertial")
        if inertial is not None:
            at, turn = pose_of(inertial)
            turn = link.turn @ turn
            masses.append(float(_child(inertial, "mass").attrib["value"]))
            centres.append(link.offset + link.turn @ at)
            tensors.append(turn @ _tensor(_child(inertial, "inertia")) @ turn.T)
    if not 0.0 < sum(masses) < math.inf:
        raise ValueError("no link has a mass, or one has none that is a number")
    centre = sum(
        (m * c for m, c in zip(masses, centres, strict=True)), np.zeros(3)
    ) / sum(masses)
    total = np.zeros((3, 3))
    for mass, at, tensor in zip(masses, centres, tensors, strict=True):
        away = at - centre
        total += tensor + mass * (np.dot(away, away) * np.eye(3) - np.outer(away, away))
    found = {
        "centre_of_mass_m": tuple(centre.tolist()),
        "inertia_kg_m2": tuple(np.diag(total).tolist()),
    }
    return {"mass_kg": sum(masses), **found}


def _wheels(links: dict[str, Link]) -> dict[str, Any]:
    wheels = [
        link
        for name, link in links.items()
        if link.moves and "wheel" in name and "caster" not in name
    ]
    if not wheels:
        return {}
    x, y, z = np.array([link.offset for link in wheels]).T
    front, rear = float(x.max()), float(x.min())
    found = {
        "track_m": float(np.ptp(y)),
        "wheel_z_m": float(z.mean()),
        "wheelbase_m": front - rear,
    }
    found["axle_x_m"] = 0.5 * (front + rear)
    cylinders = [
        one
        for link in wheels
        for one in link.element.findall("collision/geometry/cylinder")
    ]
    if cylinders:
        found["wheel_radius_m"] = float(cylinders[0].attrib["radius"])
        found["wheel_width_m"] = float(cylinders[0].attrib["length"])
    return found


def _tensor(inertia: Element) -> Floats:
    xx, yy, zz, xy, xz, yz = (
        float(inertia.attrib[f"i{key}"]) for key in ("xx", "yy", "zz", "xy", "xz", "yz")
    )
    return np.array([[xx, xy, xz], [xy, yy, yz], [xz, yz, zz]])


def _child(parent: Element, tag: str) -> Element:
    found = parent.find(tag)
    if found is None:
        raise ValueError(f"<{parent.tag} name={parent.get('name')!r}> without <{tag}>")
    return found


def _numbers(text: str) -> Floats:
    numbers = np.array([float(word) for word in text.split()])
    if numbers.shape != (3,) or not np.isfinite(numbers).all():
        raise ValueError(f"must be three numbers: {text!r}")
    return numbers
