"""ROS parameters of a planner that a command starts: read and changed in its words."""

import shlex
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

from barn_eval.running.planner_choices import split_command
from barn_eval.running.setting_folders import format_setting_value
from barn_worlds.base.errors import ConfigError, suggest
from barn_worlds.base.files import read_bytes
from barn_worlds.base.text_files import dump_yaml, parse_yaml
from barn_worlds.base.yaml_scalars import RosLoader


@dataclass(frozen=True)
class Parameter:
    """A parameter in a ROS parameter file."""

    # Name of its node, dotted below namespaces.
    node: str

    # Dotted name, through nested groups.
    name: str

    # Mapping in the content of the file that holds its value.
    group: dict[str, Any]

    # Key of the value in `group`; it may have dots itself.
    key: str


@dataclass(frozen=True)
class ParameterFile:
    """A ROS parameter file that a command names."""

    # Place of its path among the words of the command.
    word: int

    path: str

    content: dict[str, Any]


def change_command(
    command: str, values: Mapping[str, Any], copy: Path
) -> tuple[str, dict[Path, bytes]]:
    """Return a command with other ROS parameters, and the files it needs as bytes.

    Nothing is written; values go into copies of its parameter files, else after `-p`.

    Args:
        command: Command of the planner.
        values: Values by parameter, "NAME" or "NODE.NAME".
        copy: Path for the changed copy of a parameter file. If the command names
            several, the stem of each follows that of `copy`.

    Returns:
        The command, and the content of each parameter file that it needs.

    Raises:
        ConfigError: If the command names parameter files and none has the parameter.
    """
    words = split_command(command)
    files = _read_parameter_files(words)
    if not files:
        for key, value in values.items():
            if "--ros-args" not in words:
                words.append("--ros-args")
            words += ["-p", f"{key}:={format_setting_value(value)}"]
        return shlex.join(words), {}

    # A parameter changes in the file that ROS takes it from.
    changed: dict[Path, ParameterFile] = {}
    for key, value in values.items():
        file, parameter = _find_parameter(files, key)
        parameter.group[parameter.key] = value
        path = copy
        if len(files) > 1:
            path = copy.with_stem(f"{copy.stem}_{Path(file.path).stem}")
        changed[path.absolute()] = file
    for path, file in changed.items():
        words[file.word] = str(path)
    # Several parameters of one file change in one copy.
    contents = {
        path: dump_yaml(file.content).encode() for path, file in changed.items()
    }
    return shlex.join(words), contents


def read_parameters(command: str, keys: Sequence[str]) -> dict[str, Any]:
    """Return values of ROS parameters from the YAML files that a command names.

    Args:
        command: Command of the planner.
        keys: Parameters, "NAME" or "NODE.NAME".

    Returns:
        Values by key; empty if the command names no parameter file.

    Raises:
        ConfigError: If no file has a parameter.
    """
    files = _read_parameter_files(split_command(command))
    values: dict[str, Any] = {}
    # Without a file, the values are only in the node itself.
    for key in keys if files else ():
        _, parameter = _find_parameter(files, key)
        values[key] = parameter.group[parameter.key]
    return values


def _read_parameter_files(words: Sequence[str]) -> list[ParameterFile]:
    """Read the YAML file behind each --params-file among a command's words."""
    files = []
    for place, word in enumerate(words[1:], 1):
        if words[place - 1] != "--params-file":
            continue
        content = parse_yaml(read_bytes(Path(word)), word, RosLoader)
        if not isinstance(content, dict):
            raise ConfigError(f"{word}: must be a mapping of nodes to ros__parameters")
        files.append(ParameterFile(place, word, content))
    return files


def _find_parameter(
    files: Sequence[ParameterFile], key: str
) -> tuple[ParameterFile, Parameter]:
    """Return the only parameter "NAME" or "NODE.NAME", and the last file that has it.

    ConfigError if no file has it, or one has several.
    """
    # For the hint at a similar name.
    names: set[str] = set()
    # ROS lets a later file override an earlier one.
    for file in reversed(files):
        matches: dict[tuple[str, str], Parameter] = {}
        for parameter in _iterate_parameters(file.content):
            full_name = f"{parameter.node}.{parameter.name}"
            names |= {parameter.name, full_name}
            if key in (parameter.name, full_name):
                matches[parameter.node, parameter.name] = parameter
        if len(matches) > 1:
            raise ConfigError(
                f"{file.path}: has several parameters {key!r}; name the node"
            )
        for parameter in matches.values():
            return file, parameter
    paths = ", ".join(file.path for file in files)
    raise ConfigError(f"{paths}: has no parameter {key!r}{suggest(key, sorted(names))}")


def _iterate_parameters(
    content: Mapping[str, Any], namespace: str = ""
) -> Iterator[Parameter]:
    """Yield the parameters of all nodes in a file's content, also below namespaces."""
    for name, value in content.items():
        if not isinstance(value, dict):
            continue
        parameters = value.get("ros__parameters")
        if isinstance(parameters, dict):
            yield from _iterate_group(f"{namespace}{name}", parameters)
        else:
            yield from _iterate_parameters(value, f"{namespace}{name}.")


def _iterate_group(
    node: str, group: dict[str, Any], prefix: str = ""
) -> Iterator[Parameter]:
    """Yield the parameters of one node; those of nested groups have dotted names."""
    for key, value in group.items():
        if isinstance(value, dict):
            yield from _iterate_group(node, value, f"{prefix}{key}.")
        else:
            yield Parameter(node, f"{prefix}{key}", group, key)
