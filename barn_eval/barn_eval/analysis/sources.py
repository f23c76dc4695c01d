"""Read results folders: their trials, configuration, worlds and tasks."""

import math
from collections.abc import Iterable, Iterator, Mapping, Sequence
from contextlib import suppress
from dataclasses import dataclass, replace
from functools import cache, cached_property
from pathlib import Path
from typing import Any

import numpy as np

from barn_eval.results.bags import BAGS
from barn_eval.results.commands import parse_commands_line
from barn_eval.results.folder import read_results, select_scored
from barn_eval.results.row_table import RowTable, column, take
from barn_eval.results.rows import COMMANDS_FILE, TRACKS_FILE, TrialLines
from barn_eval.results.run_file import RunFile
from barn_eval.results.table_files import TABLE_SYSTEM, is_table_file, read_table_file
from barn_eval.results.tracks import SPEEDS, parse_track_line
from barn_eval.trials.identity import first_difference
from barn_eval.trials.result import Rows, RowsByPlanner, TrialResult
from barn_eval.trials.run_config import RunConfig
from barn_eval.trials.system import SUITE_NAME, System, system_in
from barn_sim.config import chassis_in, robot_of
from barn_worlds.base.arrays import Floats
from barn_worlds.base.config import as_dict, from_dict
from barn_worlds.base.errors import BarnError, ConfigError, suggest
from barn_worlds.datasets.dataset import open_dataset, select_worlds
from barn_worlds.geometry.footprint import Footprint
from barn_worlds.robots.contact import contact_footprint
from barn_worlds.robots.files import name_unless_standard
from barn_worlds.robots.robot import Chassis
from barn_worlds.worlds.world import World

_SIDE_BY_SIDE = "; barn report shows measured and simulated trials side by side"


@dataclass(frozen=True, eq=False)
class Source:
    """A results folder, or a table in its place."""

    path: Path

    kind: str
    """Whether it is a "run" of one planner, a "campaign" of several or a "table"."""

    results: Rows
    """Scored trials by world, repetition and planner."""

    configuration: Mapping[str, Any]
    """Configuration of the run as plain data, which may be from another version."""

    sessions: tuple[Mapping[str, Any], ...]
    """Versions, commit and machine of each session."""

    planned: int | None
    """Number of trials of the whole run, None if unknown."""

    @cached_property
    def tracks(self) -> Mapping[str, str]:
        """Lines of tracks by trial; none for a table."""
        return self._lines(TRACKS_FILE)

    @cached_property
    def commands(self) -> Mapping[str, str]:
        """Lines of kept commands by trial; none for a table."""
        return self._lines(COMMANDS_FILE)

    def _lines(self, name: str) -> Mapping[str, str]:
        """Return the lines of a file in the folder by trial; none for a table."""
        return {} if self.kind == "table" else TrialLines(self.path / name)

    @cached_property
    def run_config(self) -> RunConfig:
        """Configuration as an object; BarnError if this version cannot read it."""
        return from_dict(RunConfig, dict(self.configuration), str(self.path))

    @cached_property
    def chassis(self) -> Chassis:
        """Body of the robot, from the configuration; ConfigError if that is invalid."""
        return chassis_in(self.configuration.get("simulator"))

    @cached_property
    def commanded_mps(self) -> Mapping[str, float]:
        """Fastest command [m/s] of each planner that declares no speed cap; {} if observed."""
        return _fastest_commands(self)

    def describe_commanded(self, planner: str) -> str:
        """Return a sentence on a planner's undeclared speed cap, and how to declare it."""
        cap_mps = self.commanded_mps[planner]
        declaration = f"--set {planner}.max_speed_mps={cap_mps:g} declares it"
        if self.run_config.planner(planner).registered:
            declaration = "speed_cap of its PlannerEntry declares it"
        return (
            f"{planner} declares no speed cap, so its fastest command counts, {cap_mps:g}"
            f" m/s; {declaration}."
        )

    @cached_property
    def comparable_results(self) -> Rows:
        """The trials, where an undeclared speed cap is set to the fastest command.

        Their rows have the robot's limit, by which a slow planner looks inefficient.
        """
        if not self.commanded_mps:
            return self.results
        return RowTable.of(self._capped_results())

    def _capped_results(self) -> Iterator[TrialResult]:
        """Yield all trials, with cap, bound and efficiency by `commanded_mps` if it has one."""
        period_s = self.run_config.protocol.longest_look_s
        for result in self.results:
            cap_mps = self.commanded_mps.get(result.planner)
            yield result if cap_mps is None else cap_result(result, cap_mps, period_s)

    @property
    def robot(self) -> str:
        """Name of the robot, empty for the Jackal."""
        return name_unless_standard(self.chassis)

    @property
    def system(self) -> System:
        """What its trials ran in; ConfigError if that is invalid."""
        return system_in(self.configuration)

    @cached_property
    def outline(self) -> Footprint:
        """Footprint [m] in base_link of the robot's parts that can touch obstacles."""
        return contact_footprint(self.chassis)

    def bag(self, trial_id: str) -> Path:
        """Return the path FOLDER/bags/TRIAL_ID, which need not exist."""
        return self.path / BAGS / trial_id


def read_source(path: Path, rows: Rows | None = None) -> Source:
    """Read a table, or a folder's run.json and scored rows, sorted; ConfigError if no run.

    Args:
        path: The folder, or a table file.
        rows: Its rows, if they have been read already; may be empty.

    Raises:
        ConfigError: If the folder holds no run, or results of another task.
        BarnError: If a file cannot be read.
    """
    if is_table_file(path):
        results: Rows = RowTable.of(read_table_file(path))
        order = np.lexsort((column(results, "repetition"), column(results, "world")))
        results = take(results, order)
        configuration = {"system": as_dict(TABLE_SYSTEM)}
        return Source(path, "table", results, configuration, (), None)
    if rows is None:
        rows = read_results(path)
    run_file = RunFile.read(path)
    results = select_scored(run_file, rows)

    choices = planner_choices(run_file.config)
    planners = [str(choice.get("name")) for choice in choices]
    kind = "campaign" if len(planners) > 1 else "run"
    # A merged or edited folder may have rows of planners that run.json lacks.
    names = column(results, "planner").tolist()
    planners += sorted(set(names).difference(planners))
    places = [planners.index(name) for name in names]
    # In the order of the schedule, not in that of the workers.
    order = np.lexsort(
        (places, column(results, "repetition"), column(results, "world"))
    )
    return Source(
        path=path,
        kind=kind,
        results=take(results, order),
        configuration=run_file.config,
        sessions=run_file.sessions,
        planned=_count_planned_trials(run_file.config),
    )


def cap_result(result: TrialResult, cap_mps: float, period_s: float) -> TrialResult:
    """Return a copy of a row with another speed cap, bound and efficiency.

    Args:
        result: The row.
        cap_mps: The speed cap, above 0.
        period_s: `longest_look_s` of its protocol.
    """
    scores = result.scores
    least_s = scores.least_time_s
    if not (result.speed_cap_mps and least_s):
        return replace(result, speed_cap_mps=cap_mps)
    # The bound is a length divided by the cap, minus a period that is not on the clock.
    at_limit_s = least_s + period_s
    least_s = at_limit_s * result.speed_cap_mps / cap_mps - period_s
    efficiency = scores.efficiency
    if scores.success and scores.traversal_time_s:
        efficiency = least_s / scores.traversal_time_s
    scores = replace(scores, least_time_s=least_s, efficiency=efficiency)
    return replace(result, speed_cap_mps=cap_mps, scores=scores)


def _fastest_commands(source: Source) -> dict[str, float]:
    """Return the fastest command or motion [m/s] of planners without a cap; {} if observed.

    Speeds are rounded up to 1 mm/s: rounding errors in other trials of a folder must not
    change the efficiency, and a planner must not exceed what it declares. Planners
    without kept commands, or with only zero commands, are left out.
    """
    speeds_mps: dict[str, float] = {}
    # In observed trials, something else than the planner may limit the speed.
    if source.system.is_observed:
        return speeds_mps
    # Folders of other versions, or with planners that are not installed, keep their caps.
    with suppress(BarnError):
        for choice in source.run_config.planners:
            if not source.run_config.resolve_planner(choice).declared_mps:
                speeds_mps[choice.name] = 0.0
    if not speeds_mps:
        return {}

    lines = source.commands
    for result in source.results:
        planner = result.planner
        trial_id = result.trial_id
        if planner not in speeds_mps:
            continue
        speeds: Floats = np.zeros(1)
        if trial_id in lines:
            _, commands = parse_commands_line(lines[trial_id], trial_id)
            speeds = commands[:, 0]
        elif trial_id in source.tracks:
            # Free-running trials keep only samples, so the motion counts as well.
            _, track = parse_track_line(source.tracks[trial_id], trial_id)
            speeds = track.samples[:, SPEEDS]
        fastest_mps = float(np.nanmax(np.abs(speeds), initial=0.0))
        # The robot's own limit holds for larger commands.
        fastest_mps = min(fastest_mps, result.speed_cap_mps or math.inf)
        speeds_mps[planner] = max(speeds_mps[planner], fastest_mps)
    return {
        planner: math.ceil(1000.0 * speed - 1e-6) / 1000.0
        for planner, speed in speeds_mps.items()
        if speed > 0.0
    }


def require_same_task(folders: Sequence[Path]) -> None:
    """Raise ConfigError unless all folders' run.json have one task.

    The task is protocol, simulator, robot and system.

    Raises:
        ConfigError: If two tasks differ; the message names the first different key.
    """
    first, *others = folders
    task = _read_task(first)
    for folder in others:
        other_task = _read_task(folder)
        # Robots that differ only in name are the same.
        if other_task["tasks"] == task["tasks"]:
            continue
        for what, content in task.items():
            change = first_difference(content, other_task[what])
            if change is not None:
                key, value, other_value = change
                hint = ""
                if what == "systems" and SUITE_NAME in (value, other_value):
                    hint = _SIDE_BY_SIDE
                raise ConfigError(
                    f"different {what} cannot be compared: {key} is {value!r} in"
                    f" {first}, {other_value!r} in {folder}{hint}"
                )


def _read_task(path: Path) -> dict[str, dict[str, Any]]:
    """Return a folder's or table's task as plain data: robots, systems, then tasks.

    The keys are words for messages. Robots and systems come first, because a message
    about one of their inner keys would not name them.
    """
    task: dict[str, Any] = {"simulator": None, "system": as_dict(TABLE_SYSTEM)}
    simulator: Any = None
    if not is_table_file(path):
        run_file = RunFile.read(path)
        task = run_file.task()
        simulator = run_file.config.get("simulator")
    return {
        "robots": {"robot": chassis_in(simulator).name},
        "systems": as_dict(system_in(task)),
        "tasks": task,
    }


def group_by_planner(results: Rows) -> RowsByPlanner:
    """Return results by planner name, in order of first appearance."""
    planners = column(results, "planner")
    groups = {}
    for planner in dict.fromkeys(planners.tolist()):
        groups[planner] = take(results, planners == planner)
    return groups


def select_planners(
    path: Path, groups: RowsByPlanner, names: Sequence[str]
) -> RowsByPlanner:
    """Return results of named planners, of all without names; ConfigError if unknown.

    Args:
        path: The folder, for messages.
        groups: Its results by planner.
        names: The planners; all planners if empty.

    Raises:
        ConfigError: If the folder has no such planner.
    """
    for name in names:
        if name not in groups:
            raise ConfigError(f"{path}: no planner {name!r}{suggest(name, groups)}")
    return {name: groups[name] for name in names or groups}


def read_worlds(
    results: Iterable[tuple[TrialResult, Source]],
) -> dict[str, World | str]:
    """Return by checksum the world, or why it is missing, for the first result with it.

    Args:
        results: Results, each with its folder.
    """
    # A data set is read as a whole, and all results may have the same one.
    open_once = cache(open_dataset)
    worlds: dict[str, World | str] = {}
    for result, source in results:
        # By checksum, because folders may have different worlds of one number.
        checksum = result.world_checksum
        if checksum in worlds:
            continue
        dataset = str(source.configuration.get("dataset", result.dataset))
        try:
            world = open_once(dataset).load(result.world)
            if world.checksum != checksum:
                # Trials of other robots ran in this world with a course that fits them.
                run = source.run_config
                fitted = open_once(dataset).for_robot(
                    robot_of(run.simulator), run.course
                )
                world = fitted.load(result.world)
        except (BarnError, OSError) as error:
            worlds[checksum] = f"its world cannot be read: {error}"
            continue
        if world.checksum == checksum:
            worlds[checksum] = world
        else:
            worlds[checksum] = (
                f"world {result.world} of {dataset} has changed since the trial"
            )
    return worlds


def planner_choices(
    configuration: Mapping[str, Any], planner: str = ""
) -> list[dict[str, Any]]:
    """Return well-formed planner mappings of a configuration, of one name if given.

    Args:
        configuration: Configuration of a run as plain data.
        planner: Name of the only planner to return; empty for all.
    """
    choices = []
    # Pages must show a folder even if its run.json was edited by hand.
    planners = configuration.get("planners")
    for choice in planners if isinstance(planners, list) else ():
        if isinstance(choice, dict) and planner in ("", choice.get("name")):
            choices.append(choice)
    return choices


def _count_planned_trials(configuration: Mapping[str, Any]) -> int | None:
    """Return worlds * repetitions * planners of a configuration, None if unknown."""
    try:
        dataset = open_dataset(str(configuration["dataset"]))
        worlds = select_worlds(str(configuration["worlds"]), dataset.world_numbers)
        repetitions = int(configuration["repetitions"])
        planners = len(configuration.get("planners", (None,)))
    except (BarnError, KeyError, TypeError, ValueError, OSError):
        return None
    return len(worlds) * repetitions * planners
