"""Settings: combinations of parameter values, each driven as a run of its own.

`barn run --sweep` and `--latency`, `barn tune` and `barn ab` drive settings.
"""

import hashlib
import itertools
import math
import re
import shlex
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass, field, replace
from pathlib import Path
from typing import Any

from barn_eval.running.command_files import hash_command_files
from barn_eval.running.planner_choices import apply_parameters, split_command
from barn_eval.running.request import SCHEMA_VERSION, RunRequest
from barn_eval.running.setting_folders import LATENCY, format_setting_value
from barn_worlds.base.errors import ConfigError, format_value, suggest
from barn_worlds.base.files import (
    dump_yaml,
    parse_yaml,
    read_bytes,
    read_yaml,
    write_bytes,
)
from barn_worlds.base.yaml_scalars import RosLoader

MAX_SETTINGS = 400
# Folder of the ROS parameter files that settings need.
PARAMETERS = "parameters"

# Values of each parameter.
Sweep = Mapping[str, Sequence[Any]]


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
    """Return a command with other ROS parameters, and files for it, not yet written.

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
    """Return ROS parameters in a command's files; {} without files, else all or raise.

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
    """Return the YAML file after each --params-file; ConfigError if no mapping."""
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
    """Return a key's last file and its parameter; ConfigError if none or several."""
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
    raise ConfigError(f"{paths}: no parameter {key!r}{suggest(key, sorted(names))}")


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


@dataclass(frozen=True)
class Setting:
    """One combination of parameter values and the run that drives it."""

    name: str

    # Values by the short names of the parameters.
    values: Mapping[str, Any]

    request: RunRequest

    # Content of the ROS parameter files that the planner command names.
    parameter_files: Mapping[Path, bytes] = field(default_factory=dict)

    def write_parameter_files(self) -> None:
        """Write the planner's ROS parameter files; call before the run starts."""
        for path, content in self.parameter_files.items():
            write_bytes(path, content)


def make_setting(base: RunRequest, values: Mapping[str, Any], name: str) -> Setting:
    """Return a run whose first planner has other parameters; ConfigError if unknown.

    Args:
        base: The run to change.
        values: Values by parameter. For a planner of the suite, these are its dotted
            parameters. For one that a command starts, they are ROS parameters: `-p`
            sets them or, with a `--params-file`, a changed copy of that file does.
        name: Name of the setting, and of its folder below that of `base`.

    Raises:
        ConfigError: If the planner has no such parameter.
    """
    planner, *others = base.config.planners
    files: dict[Path, bytes] = {}
    if planner.command:
        copy = base.out / PARAMETERS / f"{name}.yaml"
        command, files = change_command(planner.command, values, copy)
        # The content is hashed, not the file: before the run starts it does not exist,
        # and when the run resumes it does.
        hashes = {
            str(path): hashlib.sha256(content).hexdigest()
            for path, content in files.items()
        }
        files_by_name = hash_command_files(split_command(command)) | hashes
        planner = replace(planner, command=command, files=files_by_name)
    else:
        (planner,) = apply_parameters([planner], values, "")
    config = replace(base.config, planners=(planner, *others))
    # Raises for a parameter that the planner does not have.
    config.resolve_planner(planner)

    request = replace(base, config=config).in_folder(base.out / name)
    return Setting(name, values, request, files)


def grid(base: RunRequest, sweep: Sweep) -> list[Setting]:
    """Return a setting per combination of values or delay; ConfigError if not allowed.

    Args:
        base: The run to change.
        sweep: Values by parameter of the only planner, as `make_setting` takes them;
            or the key "latency" alone, with the delays of all planners' commands [s].

    Raises:
        ConfigError: If the run has several planners, a value is not allowed or comes
            twice, or there are more than `MAX_SETTINGS` combinations.
    """
    _require_values(sweep)
    # A delay is no parameter of a planner, so it applies to several alike.
    if list(sweep) == [LATENCY]:
        return [_make_delayed(base, delay_s) for delay_s in _delays_s(sweep[LATENCY])]

    planners = base.config.planners
    if len(planners) != 1:
        names = ", ".join(planner.name for planner in planners)
        raise ConfigError(f"a sweep needs exactly one planner, got {names}")

    short_names = _short_names(list(sweep))
    settings = []
    for combination in itertools.product(*sweep.values()):
        values = dict(zip(sweep, combination, strict=True))
        short_values = dict(zip(short_names, combination, strict=True))
        name = ",".join(
            f"{key}={format_setting_value(value)}"
            for key, value in short_values.items()
        )
        # Values may have characters that folder names cannot have.
        folder = re.sub(r"[^A-Za-z0-9_.=,+-]", "_", name)
        setting = make_setting(base, values, folder)
        settings.append(replace(setting, name=name, values=short_values))
    # Two settings in one folder would overwrite each other.
    if len({setting.request.out for setting in settings}) < len(settings):
        raise ConfigError("a sweep must not contain a value twice")
    return settings


def read_sweep(file: Path | None, texts: Sequence[str]) -> Sweep:
    """Return values by parameter from texts, else a YAML file, or {}; or ConfigError.

    Args:
        file: YAML file that may have a key `sweep`.
        texts: "KEY=V1,V2,..." texts.

    Raises:
        ConfigError: If a text or the key has another form.
    """
    if texts or file is None:
        return parse_sweep(texts)
    sweep = read_yaml(file, SCHEMA_VERSION).get("sweep") or {}
    if not isinstance(sweep, Mapping):
        raise ConfigError(
            f"{file}: sweep must be a mapping of parameters to lists of values,"
            f" got {format_value(sweep)}"
        )
    return sweep


def parse_sweep(texts: Sequence[str]) -> Sweep:
    """Return lists of values from "KEY=V1,V2,..." texts, as YAML; ConfigError if wrong.

    Raises:
        ConfigError: If a text has another form, or a key comes twice.
    """
    sweep: dict[str, list[Any]] = {}
    for text in texts:
        key, _, list_text = text.partition("=")
        key = key.strip()
        values = parse_yaml(f"[{list_text}]", f"--sweep {format_value(text)}")
        if not key or not values or not isinstance(values, list) or key in sweep:
            raise ConfigError(
                f"--sweep {format_value(text)}: must be KEY=V1,V2,..., each key given"
                " once"
            )
        sweep[key] = values
    return sweep


def _make_delayed(base: RunRequest, delay_s: float) -> Setting:
    """Return the setting in which all commands come `delay_s` late; 0: as they are."""
    config = base.config
    if delay_s:
        planners = [
            replace(
                planner,
                delay_s=delay_s,
                delay_p95_s=0.0,
                period_s=planner.compute.period_s,
            )
            for planner in config.planners
        ]
        config = replace(config, planners=tuple(planners))
    name = f"{LATENCY}={format_setting_value(delay_s)}"
    request = replace(base, config=config).in_folder(base.out / name)
    return Setting(name, {LATENCY: delay_s}, request)


def _delays_s(values: Sequence[Any]) -> list[float]:
    """Return delays as floats [s]; ConfigError for texts, booleans, repetitions."""
    is_number = not any(isinstance(value, (str, bool)) for value in values)
    if not is_number or len(set(values)) < len(values):
        raise ConfigError(
            "latency: must be delays in s, each named once,"
            f" got {format_value(list(values))}"
        )
    return [float(value) for value in values]


def _require_values(sweep: Sweep) -> None:
    """Raise ConfigError for values of a wrong type, or for too many settings."""
    for key, values in sweep.items():
        if not isinstance(values, Sequence) or isinstance(values, str) or not values:
            raise ConfigError(
                f"sweep of {format_value(key)}: must be a list of values,"
                f" got {format_value(values)}"
            )
        for value in values:
            if not isinstance(value, (str, bool, int, float)):
                raise ConfigError(
                    f"sweep of {format_value(key)}: a value must be a number, a string,"
                    f" true or false, got {value!r}"
                )
    # Before any setting is made, since a typo may ask for millions.
    count = math.prod(len(values) for values in sweep.values())
    if count > MAX_SETTINGS:
        raise ConfigError(
            f"a sweep may have at most {MAX_SETTINGS} settings, got {count}"
        )


def _short_names(keys: Sequence[str]) -> list[str]:
    """Return last parts of dotted names; if not unique, whole names, "=" as "_"."""
    last_parts = [key.rpartition(".")[2] for key in keys]
    # Two groups may have a parameter of the same name.
    if len(set(last_parts)) == len(keys):
        return last_parts
    return [key.replace("=", "_") for key in keys]
