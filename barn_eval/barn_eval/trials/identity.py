"""What makes trials comparable: task and planner configuration, with fingerprints."""

import hashlib
import json
import math
from collections.abc import Iterator, Mapping
from dataclasses import replace
from functools import cache
from typing import Any

from barn_eval.trials.protocol import Protocol
from barn_eval.trials.system import SUITE, System
from barn_sim.body.model import description_text
from barn_sim.config import PHYSICS_VERSION, SimulatorConfig
from barn_worlds.base.config import as_dict
from barn_worlds.base.files import as_mapping
from barn_worlds.robots.files import ROBOTS, STANDARD_ROBOT
from barn_worlds.robots.robot import Chassis

# Versions of code that decides results beside any configuration, by the key that each
# has in a task. A version rises whenever its code gives different results.
CODE_VERSIONS: Mapping[str, int] = {"physics": PHYSICS_VERSION}

# Stands for a value that plain data do not have.
NOT_SET = "not set"

# Name of a user's robot in a fingerprint, where the content decides, not the name.
_OWN_ROBOT = "own"


@cache
def robot_sha256(chassis: Chassis) -> str:
    """Return the SHA-256, in hex, of a robot's URDF, without the name of a user's robot."""
    if chassis.name not in ROBOTS:
        chassis = replace(chassis, name=_OWN_ROBOT)
    return named_robot_sha256(chassis)


def named_robot_sha256(chassis: Chassis) -> str:
    """Return the SHA-256, in hex, of a robot's URDF, its name included."""
    return hashlib.sha256(description_text(chassis).encode()).hexdigest()


def task_content(
    protocol: Protocol, simulator: SimulatorConfig, system: System = SUITE
) -> dict[str, Any]:
    """Return what a task fingerprint hashes: protocol, simulator, robot, code versions.

    Args:
        protocol: Rules of the trials.
        simulator: Configuration of the simulator.
        system: What trials run in. The suite's own simulator adds nothing.
    """
    config = {"protocol": as_dict(protocol), "simulator": as_dict(simulator)}
    if system.is_observed:
        config["system"] = as_dict(system)
    return plain_task(config, robot_sha256(simulator.chassis), CODE_VERSIONS)


def plain_task(
    config: Mapping[str, Any], robot: str, code_versions: Mapping[str, Any]
) -> dict[str, Any]:
    """Return what a task fingerprint hashes, from a configuration as in run.json.

    Nothing is checked.

    Args:
        config: Configuration with protocol and simulator, and the system if it is not
            the suite's; other keys do not matter.
        robot: SHA-256 of the robot's description.
        code_versions: `CODE_VERSIONS` of the suite that drove the trials.
    """
    content = {
        "protocol": config.get("protocol"),
        "simulator": without_own_name(config.get("simulator")),
        "robot": robot,
    }
    if "system" in config:
        content["system"] = config["system"]
    # The versions come from a file: a key among them must not stand for the protocol.
    return dict(code_versions) | content


def without_own_name(simulator: Any) -> Any:
    """Return a simulator's plain data, with "own" for the name of a user's robot."""
    chassis = as_mapping(as_mapping(simulator).get("chassis"))
    if str(chassis.get("name", STANDARD_ROBOT.name)) in ROBOTS:
        return simulator
    return simulator | {"chassis": chassis | {"name": _OWN_ROBOT}}


def fingerprint(content: Mapping[str, Any]) -> str:
    """Return 12 hex digits of the SHA-256 of plain data as JSON with sorted keys."""
    text = json.dumps(content, sort_keys=True)
    return hashlib.sha256(text.encode()).hexdigest()[:12]


def task_line(protocol: str, task_fingerprint: str, robot_name: str = "") -> str:
    """Return text that names a task: protocol, robot unless standard, fingerprint.

    Args:
        protocol: Name of the protocol.
        task_fingerprint: Fingerprint of the task, empty in rows that do not have it.
        robot_name: Name of the robot, empty for the standard one.
    """
    robot = f"robot {robot_name}, " if robot_name else ""
    return f"protocol {protocol}, {robot}task {task_fingerprint or 'not recorded'}"


def first_difference(
    a: Mapping[str, Any],
    b: Mapping[str, Any],
    tolerance: float = 0.0,
    ignored: tuple[str, ...] = (),
) -> tuple[str, Any, Any] | None:
    """Return the first dotted key at which plain data differ, and both values, or None.

    Args:
        a: Plain data.
        b: Plain data, whose keys come first.
        tolerance: How far apart numbers count as equal, absolutely and relatively.
        ignored: Beginnings of dotted keys that may differ.

    Returns:
        The dotted key, the value in `a` and the value in `b`, NOT_SET for one that is
        missing; None if nothing differs.
    """
    values_a = dict(flatten(a))
    values_b = dict(flatten(b))
    for key in values_b | values_a:
        value_a = values_a.get(key, NOT_SET)
        value_b = values_b.get(key, NOT_SET)
        is_equal = value_a == value_b
        if isinstance(value_a, float) and isinstance(value_b, float):
            is_equal = math.isclose(
                value_a, value_b, rel_tol=tolerance, abs_tol=tolerance
            )
        if not is_equal and not key.startswith(ignored):
            return key, value_a, value_b
    return None


def flatten(content: object, name: str = "") -> Iterator[tuple[str, Any]]:
    """Yield dotted key and value of each leaf; empty dicts and lists are leaves.

    In a list, the index is the key.

    Args:
        content: Plain data. Empty mappings and lists in it are values themselves.
        name: Dotted key of the content itself.
    """
    children = dict(enumerate(content)) if isinstance(content, list) else content
    if not isinstance(children, dict) or not children:
        yield name, content
        return
    for key, value in children.items():
        yield from flatten(value, f"{name}.{key}" if name else str(key))
