"""Reads robots from files: those that come with the suite, and yours.

docs/robots.md describes the format.
"""

from collections.abc import Mapping
from dataclasses import MISSING, fields
from pathlib import Path
from typing import Any

from barn_worlds.base.config import as_dict, from_dict
from barn_worlds.base.errors import ConfigError, format_value, suggest
from barn_worlds.base.files import dump_yaml, package_data, read_yaml
from barn_worlds.robots.robot import Chassis, Robot
from barn_worlds.robots.urdf import read_chassis

SCHEMA_VERSION = 1
ENDINGS = (".yaml", ".yml")
# The defaults are those of the Jackal, which would be wrong for any other robot.
_REQUIRED_KEYS = (
    "drive.max_speed_m_s",
    "drive.max_acceleration_m_s2",
    "drive.max_yaw_rate_rad_s",
    "drive.max_yaw_acceleration_rad_s2",
    "drive.wheel_separation_multiplier",
    "lidar.beams",
    "lidar.angle_min_rad",
    "lidar.angle_max_rad",
    "lidar.range_min_m",
    "lidar.range_max_m",
    "lidar.rate_hz",
    "lidar.noise_m",
    "lidar.mount_x_m",
    "lidar.mount_z_m",
)
# What a URDF file or the file of the robot must give.
_CHASSIS_KEYS = tuple(
    item.name
    for item in fields(Chassis)
    if item.default is MISSING and item.name != "name"
)


def find_robot_files() -> dict[str, Path]:
    """Return the .yaml files of the robots that come with the package, by name."""
    files = package_data("barn_worlds").glob("robots/*.yaml")
    return {file.stem: file for file in sorted(files)}


def load_robot(robot: str | Path) -> Robot:
    """Return the robot with a shipped name, or that in a .yaml; ConfigError if none.

    Raises:
        ConfigError: If there is no such robot or the file does not describe one.
    """
    if not isinstance(robot, (str, Path)):
        raise ConfigError(f"a robot must be a name or path, got {format_value(robot)}")
    name = str(robot)
    if name in ROBOTS:
        return ROBOTS[name]
    if not name.endswith(ENDINGS):
        raise ConfigError(
            f"unknown robot {format_value(name)}{suggest(name, ROBOTS)}; "
            "or name a file that ends in .yaml"
        )
    return _read_robot(Path(robot))


def robot_yaml(robot: Robot) -> str:
    """Return a robot as YAML text, from which `load_robot` makes an equal one."""
    content = as_dict(robot)
    # A file has the name at its top, a robot in its chassis.
    name = content["chassis"].pop("name")
    content = {"schema_version": SCHEMA_VERSION, "name": name, **content}
    return dump_yaml(content)


def _read_robot(path: Path) -> Robot:
    """Return the robot in a YAML file, gaps filled by its URDF; ConfigError if bad."""
    content = read_yaml(path, SCHEMA_VERSION)
    name = content.pop("name", None)
    if not isinstance(name, str) or not name:
        raise ConfigError(
            f"{path}: name must be the name of the robot, got {format_value(name)}"
        )
    chassis = _read_section(content, "chassis", path)
    drive = _read_section(content, "drive", path)
    if "urdf" in content:
        urdf = content.pop("urdf")
        if not isinstance(urdf, str) or Path(urdf).name != urdf:
            raise ConfigError(
                f"{path}: urdf must name a file beside it, got {format_value(urdf)}"
            )
        # Keys of the YAML file win over what the URDF gives.
        from_urdf, lack = read_chassis(path.parent / urdf)
        chassis = from_urdf | chassis
        missing = [f"'chassis.{key}'" for key in _CHASSIS_KEYS if key not in chassis]
        if missing:
            raise ConfigError(
                f"{path}: missing key {', '.join(missing)}; {urdf} gives "
                f"{', '.join(from_urdf)}; {lack or 'give it here'}"
            )
    if chassis.get("kind") != "skid_steer":
        # Only wheels that skid need a multiplier.
        drive = {"wheel_separation_multiplier": 1.0, **drive}
    content["chassis"] = {"name": name, **chassis}
    content["drive"] = drive
    robot = from_dict(Robot, content, str(path))

    for required_key in _REQUIRED_KEYS:
        section, _, key = required_key.partition(".")
        if key not in content[section]:
            raise ConfigError(f"{path}: missing key {required_key!r}")
    return robot


def _read_section(content: dict[str, Any], key: str, path: Path) -> dict[str, Any]:
    """Return the mapping under a key of a robot's file; ConfigError if it is none."""
    section = content.get(key)
    if not isinstance(section, dict):
        raise ConfigError(
            f"{path}: {key} must be a mapping of names to values, "
            f"got {format_value(section)}"
        )
    return section


# Read at import: every configuration of the suite starts from one of them.
ROBOTS: Mapping[str, Robot] = {
    name: _read_robot(file) for name, file in find_robot_files().items()
}
STANDARD_ROBOT = load_robot("jackal")


def name_unless_standard(chassis: Chassis) -> str:
    """Return the robot name of a chassis, empty for the standard robot, the Jackal."""
    return "" if chassis == STANDARD_ROBOT.chassis else chassis.name
