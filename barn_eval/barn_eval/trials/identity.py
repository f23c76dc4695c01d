"""What makes two trials comparable: the task and the planner's configuration, each with a fingerprint."""

import hashlib
import json
from collections.abc import Iterator, Mapping
from functools import cache
from typing import Any

from barn_eval.trials.protocol import Protocol
from barn_sim.body.model import description_text
from barn_sim.config import SimulatorConfig
from barn_worlds.base.config import as_dict
from barn_worlds.robots.robot import Chassis

NOT_SET = "not set"


@cache
def robot_sha256(chassis: Chassis) -> str:
    """Return SHA-256 of a robot's description."""
    return hashlib.sha256(description_text(chassis).encode()).hexdigest()


def task_content(
    protocol: Protocol, simulator: SimulatorConfig, urdf_sha256: str | None = None
) -> dict[str, Any]:
    """Return what decides a task apart from its world as plain data: protocol, simulator and robot, all resolved."""
    described = urdf_sha256 or robot_sha256(simulator.chassis)
    return {
        "protocol": as_dict(protocol),
        "simulator": as_dict(simulator),
        "robot": described,
    }


def fingerprint(content: Mapping[str, Any]) -> str:
    """Return a short name of plain data: equal data have equal names."""
    return hashlib.sha256(json.dumps(content, sort_keys=True).encode()).hexdigest()[:12]


def task_line(protocol: str, task_fingerprint: str, robot_name: str = "") -> str:
    """Return what a task is called: the first line of what is printed of it. robot_name: empty for the standard one."""
    driven = f"robot {robot_name}, " if robot_name else ""
    return f"protocol {protocol}, {driven}task {task_fingerprint or 'not recorded'}"


def first_difference(
    a: Mapping[str, Any], b: Mapping[str, Any]
) -> tuple[str, Any, Any] | None:
    """Return the first dotted key by which plain data differ, with both values, or None; MISSING for one not there."""
    there, here = dict(flatten(a)), dict(flatten(b))
    found = (
        (key, there.get(key, NOT_SET), here.get(key, NOT_SET)) for key in here | there
    )
    return next((one for one in found if one[1] != one[2]), None)


def flatten(content: object, name: str = "") -> Iterator[tuple[str, Any]]:
    """Yield the values of nested mappings and lists by dotted key; empty ones are values themselves."""
    pairs = (
        content.items()
        if isinstance(content, dict)
        else enumerate(content)
        if isinstance(content, list)
        else ()
    )
    for key, value in pairs:
        yield from flatten(value, f"{name}.{key}" if name else str(key))
    if not isinstance(content, (dict, list)) or not content:
        yield name, content
