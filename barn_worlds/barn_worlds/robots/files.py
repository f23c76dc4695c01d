"""Robots from files: those that come with the suite, and one's own. docs/robots.md describes the format."""

from collections.abc import Mapping
from importlib import resources
from pathlib import Path
from typing import Any

import yaml

from barn_worlds.base.config import as_dict, from_dict
from barn_worlds.base.errors import ConfigError, format_value, suggest
from barn_worlds.base.text_files import read_yaml
from barn_worlds.robots.robot import Chassis, Robot
from barn_worlds.robots.urdf import chassis_of

SCHEMA_VERSION = 1
ENDINGS = (".yaml", ".yml")
_MULTIPLIER = "wheel_separation_multiplier"
# What a file must say of the drive and the lidar: other robots' defaults would be those of the Jackal.
_NEEDED = (
    "drive.max_speed_m_s", "drive.max_acceleration_m_s2", "drive.max_yaw_rate_rad_s",
    "drive.max_yaw_acceleration_rad_s2", "lidar.beams", "lidar.angle_min_rad", "lidar.angle_max_rad",
    "lidar.range_min_m", "lidar.range_max_m", "lidar.rate_hz", "lidar.noise_m", "lidar.mount_x_m", "lidar.mount_z_m",
)  # fmt: skip


def shipped_robots() -> dict[str, Path]:
    """Return the files of the robots that come with the package, by name."""
    folder = Path(str(resources.files("barn_worlds"))) / "data" / "robots"
    return {file.stem: file for file in sorted(folder.glob("*.yaml"))}


def load_robot(robot: str | Path) -> Robot:
    """Return the robot of that name, or of a YAML file; ConfigError in one line for what is not one."""
    text = str(robot)
    if text in ROBOTS:
        return ROBOTS[text]
    if not text.endswith(ENDINGS):
        raise ConfigError(
            f"unknown robot {format_value(text)}{suggest(text, ROBOTS)}; or name a file that ends in .yaml"
        )
    return _read(Path(robot))


def robot_text(robot: Robot) -> str:
    """Return the YAML file of a robot, from which `load_robot` makes an equal one."""
    content = as_dict(robot)
    name = content["chassis"].pop("name")
    return yaml.safe_dump(
        {"schema_version": SCHEMA_VERSION, "name": name, **content}, sort_keys=False
    )


def _read(path: Path) -> Robot:
    content = read_yaml(path, SCHEMA_VERSION)
    name = content.pop("name", None)
    if not isinstance(name, str) or not name:
        raise ConfigError(
            f"{path}: name must be the name of the robot, got {format_value(name)}"
        )
    chassis, drive = (_section(content, key, path) for key in ("chassis", "drive"))
    of_urdf = {}
    if "urdf" in content:
        urdf = content.pop("urdf")
        if not isinstance(urdf, str) or Path(urdf).name != urdf:
            raise ConfigError(
                f"{path}: urdf must name a file beside it, got {format_value(urdf)}"
            )
        of_urdf = chassis_of(path.parent / urdf)
    content["chassis"] = {"name": name, **of_urdf, **chassis}
    content["drive"] = {_MULTIPLIER: 1.0, **drive}
    robot = from_dict(Robot, content, str(path))
    multiplier = [f"drive.{_MULTIPLIER}"] if robot.chassis.kind == "skid_steer" else []
    given = {
        f"{section}.{key}"
        for section, keys in (("lidar", content["lidar"]), ("drive", drive))
        for key in keys
    }
    for key in (*_NEEDED, *multiplier):
        if key not in given:
            raise ConfigError(f"{path}: missing key {key!r}")
    return robot


def _section(content: dict[str, Any], key: str, path: Path) -> dict[str, Any]:
    given = content.get(key)
    if not isinstance(given, dict):
        raise ConfigError(
            f"{path}: {key} must be a mapping of names to values, got {format_value(given)}"
        )
    return given


ROBOTS: Mapping[str, Robot] = {
    name: _read(file) for name, file in shipped_robots().items()
}


STANDARD = load_robot("jackal")


def other_name(chassis: Chassis) -> str:
    """Return the name of a robot, empty if it is the one that is meant where none is named."""
    return "" if chassis == STANDARD.chassis else chassis.name
