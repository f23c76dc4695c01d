"""A run as a user requests it, from a YAML file, from options or from Python."""

import os
from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass, field, fields, replace
from functools import partial
from numbers import Integral
from pathlib import Path
from typing import Any

from barn_eval.results.folder import default_folder
from barn_eval.results.run_file import WORLDS
from barn_eval.running.options import RunOptions
from barn_eval.running.planner_choices import (
    apply_parameters,
    give_inputs,
    package_command,
    pop_texts,
    read_planner,
    read_planners,
)
from barn_eval.running.planner_objects import PlannerObject, split_planner_objects
from barn_eval.trials.protocol import (
    CHALLENGE,
    Protocol,
    check_protocol_name,
    load_protocol,
)
from barn_eval.trials.ros_config import RosConfig
from barn_eval.trials.run_config import ExecutionConfig, RunConfig
from barn_eval.trials.spec import TrialSpec, simulator_config
from barn_sim.config import robot_of
from barn_worlds.base.config import as_plain, from_dict, read_selection, replace_dotted
from barn_worlds.base.errors import ConfigError, format_value, suggest
from barn_worlds.base.files import parse_yaml, read_yaml
from barn_worlds.datasets.dataset import Dataset, open_dataset
from barn_worlds.robots.files import load_robot
from barn_worlds.robots.robot import Robot
from barn_worlds.worlds.world import World

SCHEMA_VERSION = 1
_EXECUTION_KEYS = tuple(item.name for item in fields(ExecutionConfig))
_KEYS = (*RunOptions.__annotations__, "execution", "sweep")


@dataclass(frozen=True)
class RunRequest:
    """A run and the folder of its results."""

    config: RunConfig
    execution: ExecutionConfig
    out: Path

    # Worlds by number that replace the data set.
    worlds: Mapping[int, World] | None = None

    # Planners that are Python objects, by name.
    planner_objects: Mapping[str, PlannerObject] = field(default_factory=dict)

    def __post_init__(self) -> None:
        """Raise ConfigError for a planner's name or a path that is not allowed."""
        self.config.require_own_names()
        # The system refuses such a path with an error that names no option.
        if "\0" in str(self.out):
            raise ConfigError(
                f"out {format_value(str(self.out))}: a path cannot contain a NUL"
            )

    @property
    def dataset(self) -> Dataset:
        """The run's `worlds`, else the configured data set opened, or WorldError."""
        if self.worlds is None:
            return open_dataset(self.config.dataset)
        readers = {
            number: partial(self.worlds.__getitem__, number) for number in self.worlds
        }
        return Dataset(Path(WORLDS).stem, readers)

    def trials(self) -> list[TrialSpec]:
        """Return specifications of all trials of the run, done or not, in order."""
        return self.config.trials(dataset=self.dataset)

    def split_into_routes(self, courses: Sequence[Sequence[float]]) -> "RunRequest":
        """Return a copy in which each route of a world is a world, or the run itself.

        `courses` are routes as numbers for `parse_course`, and `config.routes` are
        drawn. Without either, the run itself is returned.
        """
        config = self.config
        if config.course and self.dataset.maps:
            # It takes the place of all routes of a map.
            courses = [config.course]
            config = replace(config, course=())
        if not courses and not config.routes:
            return self
        worlds = self.dataset.split_into_routes(
            robot_of(config.simulator), courses, config.routes, config.seed
        )
        config = replace(config, dataset=_worlds_file(self.out))
        return replace(self, config=config, worlds=worlds)

    def in_folder(self, out: Path) -> "RunRequest":
        """Return a copy of the run with another results folder; move nothing."""
        config = self.config
        if self.worlds is not None:
            config = replace(config, dataset=_worlds_file(out))
        return replace(self, config=config, out=out)


def _pop_courses(content: dict[str, Any], where: str) -> list[tuple[float, ...]]:
    """Remove and return several courses; else return [] and unwrap a single one."""
    courses = content.get("course")
    if not isinstance(courses, Sequence) or not all(
        isinstance(course, Sequence) and not isinstance(course, str)
        for course in courses
    ):
        return []
    if len(courses) < 2:
        content["course"] = next(iter(courses), ())
        return []
    del content["course"]
    return [
        from_dict(RunConfig, {"course": course}, f"{where}course").course
        for course in courses
    ]


def _worlds_file(out: Path) -> str:
    """Return the path of worlds.npz in the results folder `out`, absolute, as text.

    A run keeps worlds there that came as Python objects.
    """
    return str((out / WORLDS).absolute())


def read_request(file: Path | None, options: Mapping[str, object]) -> RunRequest:
    """Return the run of a YAML file and options, which win; ConfigError if invalid.

    Args:
        file: YAML file with keys of `RunOptions`. `execution` may group those of
            `ExecutionConfig`, and `sweep` is left to `read_sweep`.
        options: `RunOptions`, which replace those of the file; None does not count.

    Raises:
        ConfigError: If a key is not known or a value is not allowed.
    """
    where = f"{file}: " if file else ""
    content: dict[str, Any] = read_yaml(file, SCHEMA_VERSION) if file else {}
    changes, worlds, planner_objects = _take_objects(options)
    if "planners" in changes:
        changes["planners"] = _reuse_commands(
            changes["planners"], content.get("planners"), where
        )
    # Later ones win: the default, then the file, then the options.
    content = {"out": default_folder()} | content | changes
    for key in content:
        if key not in _KEYS:
            raise ConfigError(
                f"{where}unknown key {format_value(key)}{suggest(key, _KEYS)}"
            )
    # `read_sweep` reads it: it makes several requests of this one.
    content.pop("sweep", None)

    out = content.pop("out")
    if not isinstance(out, (str, Path)) or not str(out):
        raise ConfigError(
            f"{where}out must name a folder for the results, got {format_value(out)}"
        )
    out = Path(out)
    execution = _pop_mapping(content, "execution", where)
    for key in _EXECUTION_KEYS:
        if key in content:
            execution[key] = content.pop(key)
    # `compute` changes results, so it belongs to the run, not to its execution.
    if "compute" in execution:
        content.setdefault("compute", execution.pop("compute"))
    if worlds is not None:
        content["dataset"] = _worlds_file(out)

    courses = _pop_courses(content, where)
    request = RunRequest(
        _read_config(content, where),
        from_dict(ExecutionConfig, execution, f"{where}execution"),
        out,
        worlds,
        planner_objects,
    )
    request = request.split_into_routes(courses)
    if request.config.mode == "ros":
        return replace(request, execution=_check_for_ros(request.execution, where))
    return request


def _check_for_ros(execution: ExecutionConfig, where: str) -> ExecutionConfig:
    """Return the execution, one worker if ROS_DOMAIN_ID is set; ConfigError if unfit.

    Raises:
        ConfigError: If the engine is not local, or if there are several workers on one
            domain, which would hear each other's simulators.
    """
    if execution.engine != "local":
        raise ConfigError(
            f"{where}mode ros needs engine local, got {execution.engine!r}"
        )
    domain = os.environ.get("ROS_DOMAIN_ID")
    if not domain:
        return execution
    if execution.workers > 1:
        raise ConfigError(
            f"{where}workers: must be 1 with ROS_DOMAIN_ID {domain}, got"
            f" {execution.workers}; use --workers 1, or leave ROS_DOMAIN_ID unset"
        )
    return replace(execution, workers=1)


def _take_objects(
    options: Mapping[str, object],
) -> tuple[dict[str, Any], dict[int, World] | None, dict[str, PlannerObject]]:
    """Return plain options, World objects by number or None, planner objects by name.

    Planner objects with one worker run in this process.
    """
    plain: dict[str, Any] = {
        key: as_plain(value) for key, value in options.items() if value is not None
    }
    # Configuration is plain data, as run.json keeps it.
    for key in ("dataset", "protocol"):
        if isinstance(plain.get(key), Path):
            plain[key] = str(plain[key])

    worlds: dict[int, World] | None = None
    if not isinstance(plain.get("worlds", ""), str):
        plain["worlds"], worlds = _read_worlds(plain["worlds"])

    planner_objects: dict[str, PlannerObject] = {}
    if "planners" in plain:
        plain["planners"], planner_objects = split_planner_objects(plain["planners"])
    # One worker needs no other process, so that a debugger reaches the planner.
    if planner_objects and plain.get("workers") == 1:
        plain.setdefault("engine", "inline")
    return plain, worlds, planner_objects


def _read_config(content: dict[str, Any], where: str) -> RunConfig:
    """Return a run's configuration, taking keys off `content`; ConfigError if wrong."""
    protocol = content.pop("protocol", CHALLENGE)
    if isinstance(protocol, str):
        protocol = load_protocol(protocol)
    if not isinstance(protocol, Protocol):
        raise ConfigError(
            f"{where}protocol must be a name or a YAML file,"
            f" got {format_value(protocol)}"
        )
    # A changed protocol under a known name would be ranked with the real one.
    check_protocol_name(protocol, f"{where}protocol ")

    robot = content.pop("robot", None)
    if isinstance(robot, (str, Path)):
        robot = load_robot(robot)
    if not isinstance(robot, (Robot, type(None))):
        raise ConfigError(
            f"{where}robot must be a name or a YAML file, got {format_value(robot)}"
        )
    simulator = _pop_mapping(content, "simulator", where)
    ros = _pop_mapping(content, "ros", where)
    if "bags" in ros:
        raise ConfigError(f"{where}ros.bags is set by bags (--bags)")

    commands = pop_texts(content, "planner_command", where)
    for text in pop_texts(content, "planner_package", where):
        commands.append(package_command(text))
    planners = read_planners(content.pop("planners", None), commands, where)
    inputs = pop_texts(content, "planner_input", where)
    planners = give_inputs(planners, inputs, where)
    parameters = _pop_mapping(content, "settings", where)
    config = from_dict(RunConfig, content, where.rstrip(": ") or "options")
    return replace(
        config,
        planners=apply_parameters(planners, parameters, where),
        protocol=protocol,
        simulator=simulator_config(protocol, simulator, robot),
        ros=replace_dotted(RosConfig(), _join_remaps(ros), f"{where}ros"),
    )


def _join_remaps(ros: Mapping[str, Any]) -> dict[str, Any]:
    """Return settings of mode ros with `remap.scan: /front/scan` as rules of `remap`."""
    settings = {}
    rules = []
    for key, value in ros.items():
        if key == "remap" and isinstance(value, Mapping):
            rules += [f"{topic}:={name}" for topic, name in value.items()]
        elif key.startswith("remap."):
            rules.append(f"{key.removeprefix('remap.')}:={value}")
        else:
            settings[key] = value
    if rules:
        settings["remap"] = [*settings.get("remap", ()), *rules]
    return settings


def _reuse_commands(entries: list[Any], file_planners: object, where: str) -> list[Any]:
    """Return planners; a name that the file has a command for becomes its planner."""
    if not isinstance(file_planners, list):
        return entries
    commands: dict[object, object] = {}
    for entry in file_planners:
        if isinstance(entry, dict) and "command" in entry:
            planner = read_planner(entry, where)
            commands[planner.name] = planner
    return [
        commands.get(entry.strip(), entry) if isinstance(entry, str) else entry
        for entry in entries
    ]


def _read_worlds(worlds: Any) -> tuple[object, dict[int, World] | None]:
    """Return (worlds, None) or ("all", World objects by number); ConfigError if bad."""
    if isinstance(worlds, World):
        worlds = [worlds]
    if isinstance(worlds, Iterable) and not isinstance(worlds, Mapping):
        worlds = list(worlds)
        # Worlds that come without numbers are numbered in their order.
        if any(isinstance(world, World) for world in worlds):
            worlds = dict(enumerate(worlds))
    if not isinstance(worlds, Mapping):
        return read_selection(worlds, ConfigError), None

    by_number = {}
    for number, world in worlds.items():
        if isinstance(number, Integral) and isinstance(world, World):
            by_number[int(number)] = world
    if by_number and len(by_number) == len(worlds):
        return "all", by_number
    raise ConfigError(
        f"worlds must be World objects by number, got {format_value(worlds)}"
    )


def parse_parameters(texts: Sequence[str], option: str) -> dict[str, Any]:
    """Return values by name from "key=value" texts, read as YAML; ConfigError if wrong.

    Args:
        texts: The texts; values are read as YAML.
        option: The command-line option, for error messages.

    Raises:
        ConfigError: If a text has another form, or a key comes twice.
    """
    parameters: dict[str, Any] = {}
    for text in texts:
        key, equals, value = text.partition("=")
        key = key.strip()
        if not equals or not key or key in parameters:
            raise ConfigError(
                f"{option} {format_value(text)}: must be key=value, each key given once"
            )
        parameters[key] = parse_yaml(value, f"{option} {format_value(text)}")
    return parameters


def _pop_mapping(content: dict[str, Any], key: str, where: str) -> dict[str, Any]:
    """Remove a key and return its mapping, or {}; ConfigError if it is no mapping."""
    value = content.pop(key, None)
    if value is None:
        return {}
    if not isinstance(value, Mapping):
        raise ConfigError(
            f"{where}{key} must be a mapping of parameters to values,"
            f" got {format_value(value)}"
        )
    return dict(value)
