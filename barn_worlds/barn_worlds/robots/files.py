"""Robots from files: those that come with the suite, and one's own. docs/robots.md describes the format."""

from collections.abc import Iterator, Mapping
from dataclasses import fields
from functools import cache
from importlib import resources
from pathlib import Path
from typing import Any

import yaml

from barn_worlds.base.config import as_dict, from_dict
from barn_worlds.base.errors import ConfigError, shown, suggest
from barn_worlds.base.text_files import read_yaml
from barn_worlds.robots.robot import KINDS, Robot
from barn_worlds.robots.urdf import chassis_of

SCHEMA_VERSION = 1
ENDINGS = (".yaml", ".yml")
# What a file must say of the drive and the lidar: other robots' defaults would be those of the Jackal.
_NEEDED = {
    "drive": ("max_speed_m_s", "max_acceleration_m_s2", "max_yaw_rate_rad_s", "max_yaw_acceleration_rad_s2"),
    "lidar": (
        "beams", "angle_min_rad", "angle_max_rad", "range_min_m", "range_max_m", "rate_hz", "noise_m", "mount_x_m",
        "mount_z_m",
    ),
}  # fmt: skip


def shipped_robots() -> dict[str, Path]:
    """Return the files of the robots that come with the package, by name."""
    folder = Path(str(resources.files("barn_worlds"))) / "data" / "robots"
    return {file.stem: file for file in sorted(folder.glob("*.yaml"))}


def load_robot(robot: str | Path) -> Robot:
    """Return the robot of that name, or of a YAML file; ConfigError in one line for what is not one.

    A robot that cannot be simulated, such as a holonomic one, is refused with the reason.
    """
    text = str(robot)
    if text in shipped_robots():
        return _load_shipped(text)
    if not text.endswith(ENDINGS):
        raise ConfigError(
            f"unknown robot {shown(text)}{suggest(text, shipped_robots())}; or name a file that ends in .yaml"
        )
    return _read(Path(robot))


def robot_text(robot: Robot) -> str:
    """Return the YAML file of a robot, from which `load_robot` makes an equal one."""
    content = as_dict(robot)
    name = content["chassis"].pop("name")
    multiplier = {"wheel_separation_multiplier": robot.drive.wheel_separation_multiplier}
    content["drive"] = {**content["drive"], **multiplier}
    return yaml.safe_dump({"schema_version": SCHEMA_VERSION, "name": name, **content}, sort_keys=False)


class _Shipped(Mapping[str, Robot]):
    """The robots that come with the package and can be simulated, each read when it is asked for."""

    def __getitem__(self, name: str) -> Robot:
        if name not in shipped_robots() or _refusal(shipped_robots()[name]):
            raise KeyError(name)
        return _load_shipped(name)

    def __iter__(self) -> Iterator[str]:
        return iter([name for name, file in shipped_robots().items() if not _refusal(file)])

    def __len__(self) -> int:
        return len(list(iter(self)))


ROBOTS: Mapping[str, Robot] = _Shipped()


def refusals() -> dict[str, str]:
    """Return why those of the package's robots that cannot be simulated are refused, by name."""
    found = {name: _refusal(file) for name, file in shipped_robots().items()}
    return {name: why for name, why in found.items() if why}


@cache
def _load_shipped(name: str) -> Robot:
    return _read(shipped_robots()[name])


@cache
def _refusal(file: Path) -> str:
    return _why_not(read_yaml(file, SCHEMA_VERSION))


def _read(path: Path) -> Robot:
    content = read_yaml(path, SCHEMA_VERSION)
    name, chassis = content.pop("name", None), content.get("chassis")
    if not isinstance(name, str) or not name:
        raise ConfigError(f"{path}: name must be the name of the robot, got {shown(name)}")
    if not isinstance(chassis, dict):
        raise ConfigError(f"{path}: chassis must be a mapping of names to values, got {shown(chassis)}")
    if why := _why_not({"name": name, **content}):
        raise ConfigError(f"{path.name if path in shipped_robots().values() else path}: {why}")
    if "lidars" in content or isinstance(content.get("lidar"), list):
        raise ConfigError(f"{path}: lidar must be one lidar, a mapping: robots with several cannot be simulated")
    given = {} if "urdf" not in content else chassis_of(_beside(path, content.pop("urdf")))
    content["chassis"] = {"name": name, **given, **chassis}
    _require(content, path)
    return from_dict(Robot, content, str(path))


def _why_not(content: Mapping[str, Any]) -> str:
    """Return why a robot cannot be simulated for the kind of its drive; an empty text if it can."""
    chassis = content.get("chassis")
    if not isinstance(chassis, dict) or chassis.get("kind") != "holonomic":
        return ""
    return (
        f"robot {shown(content.get('name'))} is holonomic: it drives sideways, which the simulator's wheels and the "
        f"planners' commands have no place for, so it cannot be simulated; drives are {', '.join(KINDS)}"
    )


def _beside(path: Path, urdf: object) -> Path:
    if not isinstance(urdf, str) or Path(urdf).name != urdf:
        raise ConfigError(f"{path}: urdf must name a file beside it, got {shown(urdf)}")
    return path.parent / urdf


def _require(content: dict[str, Any], path: Path) -> None:
    """Raise ConfigError for what a file must say although the classes have defaults; set the multiplier of no skid."""
    known = {item.name for item in fields(Robot)}
    for section, names in _NEEDED.items():
        given = content.get(section)
        if given is None and set(content) <= known:
            raise ConfigError(f"{path}: missing key {section!r}")
        if isinstance(given, dict) and _known(given, section):
            for name in names:
                if name not in given:
                    raise ConfigError(f"{path}: missing key '{section}.{name}'")
    drive = content.get("drive")
    if isinstance(drive, dict) and "wheel_separation_multiplier" not in drive:
        if content["chassis"].get("kind") == "skid_steer":
            raise ConfigError(f"{path}: missing key 'drive.wheel_separation_multiplier' of a skid-steer robot")
        drive["wheel_separation_multiplier"] = 1.0


def _known(given: dict[str, Any], section: str) -> bool:
    """Tell whether all keys are known: a misspelt one is named as such, not as missing."""
    kind = next(item.type for item in fields(Robot) if item.name == section)
    return isinstance(kind, type) and set(given) <= {item.name for item in fields(kind)}
