"""What a user asks for, by a file, by options or from Python, and the experiment that it makes.

Keys, all optional: the fields of `RunConfig`; `execution`, with those of `ExecutionConfig`, which also stand for themselves;
`out`; `robot`, which `simulator` holds then; and short forms of `planners`, `protocol` and `simulator`.
"""

import re
import shlex
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, fields, replace
from functools import partial
from pathlib import Path
from typing import Any

from barn_eval.results.folder import default_folder
from barn_eval.results.run_file import WORLDS
from barn_eval.running.command_files import command_files
from barn_eval.trials.protocol import (
    CHALLENGE,
    Protocol,
    check_protocol_name,
    load_protocol,
)
from barn_eval.trials.ros_config import RosConfig
from barn_eval.trials.run_config import (
    COMPUTE_KEYS,
    ExecutionConfig,
    PlannerChoice,
    RunConfig,
)
from barn_eval.trials.spec import TrialSpec, simulator_config
from barn_planners.registry import planner_entry, planner_names
from barn_worlds.base.config import fields_of, from_dict, replace_dotted
from barn_worlds.base.errors import ConfigError, format_value, suggest
from barn_worlds.base.text_files import parse_yaml, read_yaml
from barn_worlds.datasets.dataset import Dataset
from barn_worlds.robots.files import load_robot
from barn_worlds.robots.robot import Robot
from barn_worlds.worlds.world import World

Values = Mapping[str, Any]
Given = Mapping[int, World] | None  # worlds in place of a data set, by number
SCHEMA_VERSION = 1
_CAP = "max_speed_mps"
_EXECUTION = tuple(field.name for field in fields(ExecutionConfig))
_KEYS = (*(field.name for field in fields(RunConfig)), *_EXECUTION)
_KEYS += ("execution", "out", "planner_command", "robot", "sweep")
_NAMED_COMMAND = re.compile(r"([A-Za-z0-9][A-Za-z0-9_.-]*)=(.*)", re.DOTALL)


@dataclass(frozen=True)
class Request:
    """An experiment as it was asked for, and the folder it goes to."""

    experiment: RunConfig
    execution: ExecutionConfig
    out: Path
    worlds: Given = None

    def __post_init__(self) -> None:
        if "\0" in str(self.out):
            raise ConfigError(
                f"out {format_value(str(self.out))}: a path cannot hold a NUL"
            )

    def trials(self) -> list[TrialSpec]:
        """Return the trials of the experiment."""
        if self.worlds is None:
            return self.experiment.trials()
        readers = {
            number: partial(self.worlds.__getitem__, number) for number in self.worlds
        }
        return self.experiment.trials(dataset=Dataset(Path(WORLDS).stem, readers))


def read_request(
    path: Path | None,
    options: Values,
    settings: Values | None = None,
    worlds: Given = None,
) -> Request:
    """Return what a YAML file asks for, with what `options` give in place of it; an option None does not count.

    Short forms: `planners` as texts "name" or "name:preset", one or several joined by commas, as an option also a name
    of one that the file has a command for; `protocol` and `robot` a name or a file; `simulator`, `ros` dotted names of
    what to change; `planner_command` one, or some "NAME=COMMAND". settings: parameters by planner, "planner.name",
    or name where there is one planner. worlds: in place of a data set. ConfigError in one line for what is not allowed.
    """
    content: dict[str, Any] = {"out": default_folder()} | (
        read_yaml(path, SCHEMA_VERSION) if path else {}
    )
    where, listed = f"{path}: " if path else "", content.get("planners")
    content |= {name: value for name, value in options.items() if value is not None}
    if isinstance(listed, list) and isinstance(
        asked := options.get("planners"), (str, list, tuple)
    ):
        started = [
            _planner(one, where)
            for one in listed
            if isinstance(one, dict) and "command" in one
        ]
        named: dict[Any, Any] = {one.name: one for one in started}
        names = (
            [one.strip() for one in asked.split(",")]
            if isinstance(asked, str)
            else asked
        )
        content["planners"] = [
            named.get(one, one) if isinstance(one, str) else one for one in names
        ]
    for key in content:
        if key not in _KEYS:
            raise ConfigError(
                f"{where}unknown key {format_value(key)}{suggest(key, _KEYS)}"
            )
    content.pop(
        "sweep", None
    )  # of `sweep.py`, which asks for one experiment after the other
    out = Path(
        _given(
            content.pop("out") or None,
            (str, Path),
            f"{where}out must name a folder for the results",
        )
    )
    execution = _changes(content.pop("execution", None), f"{where}execution")
    execution |= {name: content.pop(name) for name in _EXECUTION if name in content}
    if "compute" in execution:  # which changes results, and so is the experiment's
        content.setdefault("compute", execution.pop("compute"))
    if worlds is not None:
        content["dataset"] = str((out / WORLDS).absolute())
    experiment = _experiment(content, settings or {}, where)
    request = Request(
        experiment,
        from_dict(ExecutionConfig, execution, f"{where}execution"),
        out,
        worlds,
    )
    if experiment.mode == "ros" and request.execution.engine != "local":
        raise ConfigError(
            f"{where}mode ros needs engine local, got {request.execution.engine!r}"
        )
    return request


def named_command(text: str) -> tuple[str, str]:
    """Return what the planner of "NAME=COMMAND" or "COMMAND" is called, and the command."""
    named = _NAMED_COMMAND.fullmatch(text)
    return (named[1], named[2]) if named else (planner_name(text), text)


def planner_name(command: str) -> str:
    """Return what the planner that a command starts is called: its script, module, launch file or node."""
    words = command_words(command)
    if words[3:] and Path(words[1]).name == "in_workspace.sh":
        words = words[3:]
    while words[1:] and (Path(words[0]).name == "env" or "=" in words[0]):
        words = words[1:]
    program, rest = (
        Path(words[0]).name,
        [word for word in words[1:] if not word.startswith("-") and ":=" not in word],
    )
    if re.fullmatch(r"python[\d.]*", program) and rest:
        program = next((word for word in rest if word.endswith(".py")), rest[0])
    elif program == "ros2" and rest[1:]:
        program = rest[:3][-1]
    name = (
        re.sub(r"[^A-Za-z0-9_-]+", "_", Path(program).name.partition(".")[0]).strip(
            "_-"
        )[:60]
        or "planner"
    )
    if name in planner_names():
        own = f"{name!r} is one of the suite's own"
        raise ConfigError(
            f"planner command {format_value(command)}: give its planner a name; {own}"
        )
    return name


def command_words(command: str) -> list[str]:
    """Return the words of a planner's command; ConfigError if there are none."""
    try:
        words = shlex.split(command)
    except ValueError as error:
        raise ConfigError(f"planner command {format_value(command)}: {error}") from None
    if not words:
        raise ConfigError(
            f"planner command must name a program, got {format_value(command)}"
        )
    return words


def parse_settings(settings: Sequence[str], option: str) -> dict[str, Any]:
    """Return texts "key=value" as a mapping; values are read as YAML. ConfigError for anything else."""
    changes: dict[str, Any] = {}
    for setting in settings:
        key, equals, value = setting.partition("=")
        if not equals or not key.strip() or key.strip() in changes:
            raise ConfigError(
                f"{option} {format_value(setting)}: must be key=value, each key given once"
            )
        changes[key.strip()] = parse_yaml(value, f"{option} {format_value(setting)}")
    return changes


def _given(value: object, kinds: type | tuple[type, ...], rule: str) -> Any:
    if not isinstance(value, kinds):
        raise ConfigError(f"{rule}, got {format_value(value)}")
    return value


def _changes(value: object, key: str) -> dict[str, Any]:
    return dict(
        _given(value or {}, Mapping, f"{key} must be a mapping of parameters to values")
    )


def _experiment(content: dict[str, Any], settings: Values, where: str) -> RunConfig:
    rule = "must be a name or a YAML file"
    rules = _given(
        content.pop("protocol", CHALLENGE), (str, Protocol), f"{where}protocol {rule}"
    )
    rules = load_protocol(rules) if isinstance(rules, str) else rules
    check_protocol_name(rules, f"{where}protocol ")
    robot = content.pop("robot", None)
    if robot is not None and not isinstance(robot, Robot):
        robot = load_robot(_given(robot, (str, Path), f"{where}robot {rule}"))
    simulator, ros = (
        _changes(content.pop(key, None), f"{where}{key}")
        for key in ("simulator", "ros")
    )
    if "bags" in ros:
        raise ConfigError(f"{where}ros.bags is given by bags (--bags)")
    planners = _planners(
        content.pop("planners", None), content.pop("planner_command", None), where
    )
    return replace(
        from_dict(RunConfig, content, where.rstrip(": ") or "options"),
        planners=_with_settings(planners, settings, where),
        protocol=rules,
        simulator=simulator_config(rules, simulator, robot),
        ros=replace_dotted(RosConfig(), ros, f"{where}ros"),
    )


def _planners(given: object, commands: object, where: str) -> tuple[PlannerChoice, ...]:
    """Return planners from a text of names joined by commas, or a list of names, mappings and choices.

    commands: of planners that are started by them, each "NAME=COMMAND", or one "COMMAND" for the only one. A name that
    is not among the planners is added to them; without planners, a command gives its own a name.
    """
    listed = (
        given.split(",") if isinstance(given, str) else () if given is None else given
    )
    listed = _given(listed, (list, tuple), f"{where}planners must be a list of names")
    found = {number: _planner(entry, where) for number, entry in enumerate(listed)}
    texts = [commands] if isinstance(commands, str) else commands or ()
    if not isinstance(texts, (list, tuple)) or not all(
        isinstance(text, str) for text in texts
    ):
        raise ConfigError(
            f"{where}planner_command must be a text or a list of texts, got {format_value(commands)}"
        )
    for one in texts:
        name, command = (
            named_command(one)
            if _NAMED_COMMAND.fullmatch(one) or not found
            else (found[0].name, one)
        )
        if command == one and (len(found) > 1 or len(texts) > 1):
            raise ConfigError(
                f"planner command {format_value(one)}: give it as NAME=COMMAND where there are several planners"
            )
        files = command_files(command_words(command))
        number = next(
            (number for number, there in found.items() if there.name == name),
            len(found),
        )
        found[number] = replace(
            found.get(number, PlannerChoice(name)), command=command, files=files
        )
    return tuple(found.values()) if found or given is not None else (PlannerChoice(),)


def _planner(entry: Any, where: str) -> PlannerChoice:
    if isinstance(entry, PlannerChoice):
        return entry
    if isinstance(entry, str):
        name, _, preset = entry.strip().partition(":")
        return PlannerChoice(name, preset)
    made = from_dict(PlannerChoice, entry, f"{where}planners")
    if not made.command:
        return made
    name = made.name if "name" in entry else planner_name(made.command)
    return replace(made, name=name, files=command_files(command_words(made.command)))


def _with_settings(
    planners: Sequence[PlannerChoice], settings: Values, where: str
) -> tuple[PlannerChoice, ...]:
    found = {planner.name: planner.overrides for planner in planners}
    for key, value in settings.items():
        name, changes = _setting(key, value, planners)
        if name not in found:
            hint = suggest(name, found)
            raise ConfigError(
                f"{where}parameters of planner {format_value(name)}, which is not among them{hint}"
            )
        found[name] = {**found[name], **changes}
    return tuple(_changed(planner, found[planner.name], where) for planner in planners)


def _changed(planner: PlannerChoice, changes: Values, where: str) -> PlannerChoice:
    """Return a planner with its parameters; of one that the suite does not make, the only one is its speed cap."""
    about = f"{where}planner {planner.name!r}: "
    own: dict[str, Any] = {"overrides": dict(changes)}
    for key, value in changes.items():
        computing, name = key.startswith("compute."), key.removeprefix("compute.")
        if computing and name not in COMPUTE_KEYS:
            raise ConfigError(
                f"{about}unknown parameter {key!r}{suggest(name, COMPUTE_KEYS)}"
            )
        if computing or (key == _CAP and not planner.registered):
            own[name] = float(
                _given(value, (int, float), f"{about}{key} must be a number")
            )
            del own["overrides"][key]
    return replace(planner, **own)


def _setting(
    key: str, value: object, planners: Sequence[PlannerChoice]
) -> tuple[str, Values]:
    """Return the planner that a setting is of, and its parameters.

    A key may be a planner's name, with a mapping of its parameters; "planner.parameter"; or, of an only planner, the
    parameter alone. Where that can be read in two ways, as `dwa.max_speed_mps` of DWA, it is a parameter if there is
    one of that name.
    """
    names = [planner.name for planner in planners]
    if isinstance(value, Mapping) and (key in names or len(names) > 1):
        return key, value
    named = next((name for name in names if key.startswith(f"{name}.")), "")
    if len(names) == 1 and (not named or _is_parameter(key, names[0])):
        return names[0], {key: value}
    named = named or key.partition(".")[0]
    return named, {key.removeprefix(f"{named}."): value}


def _is_parameter(key: str, planner: str) -> bool:
    presets = planner_entry(planner).presets if planner in planner_names() else {}
    return any(
        f"{name}.".startswith(f"{key}.")
        for preset in presets.values()
        for name, _, _ in fields_of(preset)
    )
