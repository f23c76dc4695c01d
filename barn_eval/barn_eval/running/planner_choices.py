"""Planners of a run: from names, files and commands, with their parameters."""

import re
import shlex
from collections.abc import Mapping, Sequence
from dataclasses import replace
from pathlib import Path
from typing import Any

from barn_eval.running.command_files import hash_command_files
from barn_eval.running.planner_packages import PREFIX, find_packaged
from barn_eval.trials.run_config import COMPUTE_KEYS, PlannerChoice
from barn_planners.registry import planner_entry, planner_names
from barn_worlds.base.config import fields_of, from_dict
from barn_worlds.base.errors import ConfigError, format_value, suggest

_NAME = "[A-Za-z0-9][A-Za-z0-9_.-]*"
_NAMED_COMMAND = re.compile(f"({_NAME})=(.*)", re.DOTALL)
_SPEED_CAP = "max_speed_mps"


def read_planners(
    entries: Any, commands: Sequence[str], where: str
) -> list[PlannerChoice]:
    """Return planners with commands set or added; the default if neither is given.

    Args:
        entries: Texts as in `read_planner` joined by commas, or a list of those,
            mappings and `PlannerChoice` objects. None stands for the default planner,
            or for the planners of `commands`.
        commands: "NAME=COMMAND" texts, or one "COMMAND" for the only planner. A name
            that `entries` does not have adds a planner.
        where: Beginning of error messages, such as "file.yaml: ".

    Raises:
        ConfigError: If an entry or a command is not allowed.
    """
    names = entries.split(",") if isinstance(entries, str) else entries
    if not isinstance(names, (list, tuple, type(None))):
        raise ConfigError(
            f"{where}planners must be a list of names, got {format_value(names)}"
        )
    planners = [read_planner(entry, where) for entry in names or ()]

    for text in commands:
        # A command without a name belongs to the only planner, if there is one.
        if _NAMED_COMMAND.fullmatch(text) or not planners:
            name, command = parse_planner_command(text)
        else:
            name, command = planners[0].name, text
        # Nobody could tell which planner such a command belongs to.
        if command == text and (len(planners) > 1 or len(commands) > 1):
            raise ConfigError(
                f"planner command {format_value(text)}: give it as NAME=COMMAND if"
                " there are several planners"
            )
        _set_command(planners, name, command)

    if not planners and entries is None:
        return [PlannerChoice()]
    return planners


def pop_texts(content: dict[str, Any], option: str, where: str) -> list[str]:
    """Remove an option and return its texts, [] without it; ConfigError if not texts.

    Args:
        content: Options by name, changed in place.
        option: Name of the option, which may be None, one text or a list of texts.
        where: Beginning of error messages.

    Raises:
        ConfigError: If the option is something else.
    """
    value = content.pop(option, None)
    texts = () if value is None else value
    if isinstance(value, str):
        texts = [value]
    if not isinstance(texts, (list, tuple)) or not all(
        isinstance(text, str) for text in texts
    ):
        raise ConfigError(
            f"{where}{option} must be a text or a list of texts,"
            f" got {format_value(value)}"
        )
    return list(texts)


def package_command(text: str) -> str:
    """Return the text of --planner-package as a command: "package:" before DIR."""
    return re.sub(rf"({_NAME}=)?", rf"\1{PREFIX}", text, count=1)


def give_inputs(
    planners: Sequence[PlannerChoice], inputs: Sequence[str], where: str
) -> list[PlannerChoice]:
    """Return planners with lines for standard input; ConfigError if a text fits none.

    Args:
        planners: The planners of a run.
        inputs: "NAME=TEXT" texts, or one "TEXT" for the only planner. A backslash and n
            stand for the end of a line.
        where: Beginning of error messages.

    Raises:
        ConfigError: If a text names no planner.
    """
    names = [planner.name for planner in planners]
    content: dict[str, str] = {}
    for text in inputs:
        match = _NAMED_COMMAND.fullmatch(text)
        name, lines = match.groups() if match else (names[0], text)
        if name not in names or (match is None and len(names) > 1):
            raise ConfigError(
                f"{where}planner input {format_value(text)}: must be NAME=TEXT, where"
                f" NAME is a planner{suggest(name, names)}"
            )
        content[name] = lines.replace("\\n", "\n").rstrip("\n") + "\n"
    return [
        replace(planner, input=content.get(planner.name, planner.input))
        for planner in planners
    ]


def _set_command(planners: list[PlannerChoice], name: str, command: str) -> None:
    """Set a planner's command and its files' hashes in the list, or append one."""
    files = hash_command_files(split_command(command))
    for place, planner in enumerate(planners):
        if planner.name == name:
            planners[place] = replace(planner, command=command, files=files)
            return
    planners.append(PlannerChoice(name, command=command, files=files))


def read_planner(entry: Any, where: str) -> PlannerChoice:
    """Return the planner of a text or mapping, files of a command hashed, or as it is.

    Args:
        entry: "NAME", "NAME:PRESET", "NEW_NAME=NAME:PRESET" for a planner that is filed
            under another name, a mapping of `PlannerChoice` fields, or a
            `PlannerChoice`.
        where: Beginning of error messages.

    Raises:
        ConfigError: If the entry is no such mapping, or its command has no program.
    """
    if isinstance(entry, PlannerChoice):
        return entry
    if isinstance(entry, str):
        new_name, equals, text = entry.strip().rpartition("=")
        name, _, preset = text.partition(":")
        planner = PlannerChoice(name, preset)
        return rename_planner(planner, new_name) if equals else planner

    planner = from_dict(PlannerChoice, entry, f"{where}planners")
    if not planner.command:
        return planner
    return replace(
        planner,
        name=planner.name if "name" in entry else name_planner(planner.command),
        files=hash_command_files(split_command(planner.command)),
    )


def rename_planner(planner: PlannerChoice, name: str) -> PlannerChoice:
    """Return a copy of a planner whose results are filed under `name`."""
    if planner.name == name:
        return planner
    entry = planner.entry_name if planner.registered else ""
    return replace(planner, name=name, entry=entry)


def parse_planner_command(text: str) -> tuple[str, str]:
    """Return (name, command) of "NAME=COMMAND", or "COMMAND" named after its script."""
    match = _NAMED_COMMAND.fullmatch(text)
    if match:
        return match[1], match[2]
    return name_planner(text), text


def name_planner(command: str) -> str:
    """Return a name from a command's script or program; ConfigError for a suite name.

    Raises:
        ConfigError: If the command is empty, or the name is one of the registry's.
    """
    words = split_command(command)
    # Skip wrappers in front of the program: `bash in_workspace.sh SETUP`, then `env`
    # and assignments of variables.
    if words[3:] and Path(words[1]).name == "in_workspace.sh":
        words = words[3:]
    while words[1:] and (Path(words[0]).name == "env" or "=" in words[0]):
        words = words[1:]

    executable = find_packaged(words)
    program = executable.name if executable else Path(words[0]).name
    arguments = [
        word for word in words[1:] if not word.startswith("-") and ":=" not in word
    ]
    if re.fullmatch(r"python[\d.]*", program) and arguments:
        scripts = (word for word in arguments if word.endswith(".py"))
        # Options of Python come before its script, those of the planner behind.
        program = next(scripts, arguments[0])
    elif program == "ros2" and arguments[1:]:
        # ros2 run PACKAGE NODE, ros2 launch PACKAGE FILE or ros2 launch FILE
        program = arguments[:3][-1]

    # The name becomes a part of file names and of trial IDs.
    stem = Path(program).name.partition(".")[0]
    name = re.sub(r"[^A-Za-z0-9_-]+", "_", stem).strip("_-")[:60] or "planner"
    if name in planner_names():
        raise ConfigError(
            f"planner command {format_value(command)}: give its planner a name; {name!r} is a planner of the suite"
        )
    return name


def split_command(command: str) -> list[str]:
    """Return a command's words as a shell splits them; ConfigError if there are none.

    Raises:
        ConfigError: If it has none, or its quotes do not match.
    """
    try:
        words = shlex.split(command)
    except ValueError as error:
        raise ConfigError(f"planner command {format_value(command)}: {error}") from None
    if not words:
        raise ConfigError(
            f"planner command must name a program, got {format_value(command)}"
        )
    return words


def apply_parameters(
    planners: Sequence[PlannerChoice], parameters: Mapping[str, Any], where: str
) -> tuple[PlannerChoice, ...]:
    """Return planners with parameters over their own; ConfigError if a key is unknown.

    Args:
        planners: The planners of a run.
        parameters: Values by "PLANNER.PARAMETER", mappings by planner name or, for the
            only planner, values by parameter.
        where: Beginning of error messages.

    Raises:
        ConfigError: If a planner or parameter is not known, or a value not allowed.
    """
    values_by_planner = {planner.name: dict(planner.overrides) for planner in planners}
    for key, value in parameters.items():
        # Keys of a YAML file may be numbers, which no parameter is called.
        name, values = _find_planner(str(key), value, planners)
        if name not in values_by_planner:
            raise ConfigError(
                f"{where}parameters of planner {format_value(name)}, which is not part"
                f" of the run{suggest(name, values_by_planner)}"
            )
        overrides = {str(parameter): item for parameter, item in values.items()}
        values_by_planner[name] |= overrides
    return tuple(
        _set_parameters(planner, values_by_planner[planner.name], where)
        for planner in planners
    )


def _find_planner(
    key: str, value: object, planners: Sequence[PlannerChoice]
) -> tuple[str, Mapping[str, Any]]:
    """Return the planner's name in a parameter key, and its parameters by name.

    A key may be read in two ways: `dwa.max_speed_mps` of the only planner DWA is its
    parameter of that name, if there is one, and else its `max_speed_mps`.
    """
    names = [planner.name for planner in planners]
    # A group of parameters, such as {"dwa": {...}}, may also be a mapping.
    if isinstance(value, Mapping) and (key in names or len(names) > 1):
        return key, value

    # Names may have dots, so the first part of a key need not be the whole name.
    prefix = next((name for name in names if key.startswith(f"{name}.")), "")
    if len(names) == 1 and (not prefix or _has_parameter(planners[0].entry_name, key)):
        return names[0], {key: value}

    name = prefix or key.partition(".")[0]
    return name, {key.removeprefix(f"{name}."): value}


def _has_parameter(planner: str, key: str) -> bool:
    """Return whether a preset of a registry's planner has the parameter or group."""
    if planner not in planner_names():
        return False
    return any(
        f"{name}.".startswith(f"{key}.")
        for preset in planner_entry(planner).presets.values()
        for name, _, _ in fields_of(preset)
    )


def _set_parameters(
    planner: PlannerChoice, parameters: Mapping[str, Any], where: str
) -> PlannerChoice:
    """Return a planner with only these overrides; speed cap and compute set its fields.

    Speed cap (of a planner that a command starts) and "compute.KEY" become its fields.
    """
    overrides: dict[str, Any] = {}
    numbers: dict[str, Any] = {}
    for key, value in parameters.items():
        name = key.removeprefix("compute.")
        is_compute = name != key
        if is_compute and name not in COMPUTE_KEYS:
            raise ConfigError(
                f"{where}planner {planner.name!r}: unknown parameter {key!r}"
                f"{suggest(name, COMPUTE_KEYS)}"
            )
        # The suite does not make this planner: its speed cap is all that it knows.
        is_speed_cap = key == _SPEED_CAP and not planner.registered
        if not (is_compute or is_speed_cap):
            overrides[key] = value
        elif isinstance(value, (int, float)):
            numbers[name] = float(value)
        else:
            raise ConfigError(
                f"{where}planner {planner.name!r}: {key} must be a number,"
                f" got {format_value(value)}"
            )
    return replace(planner, overrides=overrides, **numbers)
