"""Results folders: their trials, configuration, worlds and tasks."""

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
from barn_eval.results.table_files import (
    TABLE_SYSTEM,
    is_table_file,
    read_table_file,
)
from barn_eval.results.tracks import SPEEDS, parse_track_line
from barn_eval.trials.identity import first_difference
from barn_eval.trials.result import (
    Rows,
    RowsByPlanner,
    TrialResult,
)
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

_SIDE_BY_SIDE = "; barn report sets measured beside simulated trials"


@dataclass(frozen=True, eq=False)
class Source:
    """One results folder."""

    path: Path

    kind: str
    """Whether it is a "run" of one planner, a "campaign" of several or a "table"."""

    results: Rows
    """Scored trials by world, repetition and planner."""

    configuration: Mapping[str, Any]
    """Configuration of the run as plain data, which may be of another version."""

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
        """Fastest command of each planner that declares no speed cap, in m/s."""
        return _fastest_commands(self)

    def describe_commanded(self, planner: str) -> str:
        """Return a sentence on an undeclared speed cap, and how to declare it."""
        # Rounded up: a planner is held to what it declares.
        cap_mps = math.ceil(1000.0 * self.commanded_mps[planner]) / 1000.0
        declaration = f"--set {planner}.max_speed_mps={cap_mps:g} declares it"
        choices = self.run_config.planners
        if any(item.name == planner and item.registered for item in choices):
            declaration = "speed_cap of its PlannerEntry declares it"
        return (
            f"{planner} declares no top speed: its fastest command counts, {cap_mps:g}"
            f" m/s; {declaration}."
        )

    @cached_property
    def comparable_results(self) -> Rows:
        """The trials; those without a declared speed cap as if it were the fastest command.

        Rows have the robot's limit there, by which a slow robot looks inefficient.
        """
        if not self.commanded_mps:
            return self.results
        return RowTable.of(self._capped_results())

    def _capped_results(self) -> Iterator[TrialResult]:
        """Yield the trials with the caps of `commanded_mps`."""
        period_s = self.run_config.protocol.longest_look_s
        for result in self.results:
            cap_mps = self.commanded_mps.get(result.planner)
            if cap_mps is None:
                yield result
            else:
                yield cap_result(result, cap_mps, period_s)

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
        """Footprint [m] in base_link of the robot's parts that can touch something."""
        return contact_footprint(self.chassis)

    def bag(self, trial_id: str) -> Path:
        """Return the path FOLDER/bags/TRIAL_ID, whether or not there is a bag."""
        return self.path / BAGS / trial_id


def read_source(path: Path, rows: Rows | None = None) -> Source:
    """Read run.json and scored rows of a results folder, finished or not.

    Args:
        path: The folder, or a file with anybody's table.
        rows: Its rows, if they have been read already. There may be none yet.

    Raises:
        ConfigError: The folder holds no run, or results of another task.
        BarnError: A file cannot be read.
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
    # In the order of the schedule, so that nothing shows which worker was faster.
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
    """Return a row with another speed cap, and with the efficiency that follows.

    Args:
        result: The row.
        cap_mps: The speed cap, above 0.
        period_s: `longest_look_s` of its protocol.
    """
    scores = result.scores
    least_s = scores.least_time_s
    if not (result.speed_cap_mps and least_s):
        return replace(result, speed_cap_mps=cap_mps)
    # The least time is a length by the cap, less a period that is not on the clock.
    at_limit_s = least_s + period_s
    least_s = at_limit_s * result.speed_cap_mps / cap_mps - period_s
    efficiency = scores.efficiency
    if scores.success and scores.traversal_time_s:
        efficiency = least_s / scores.traversal_time_s
    scores = replace(scores, least_time_s=least_s, efficiency=efficiency)
    return replace(result, speed_cap_mps=cap_mps, scores=scores)


def _fastest_commands(source: Source) -> dict[str, float]:
    """Return the fastest command [m/s] by planner without a declared speed cap.

    Planners without kept commands, or with none but 0, are left out.
    """
    speeds_mps: dict[str, float] = {}
    # Of trials that the suite only observed, nobody knows who held what speed.
    if source.system.is_observed:
        return speeds_mps
    # Folders of other versions, and of planners that are not installed, keep their caps.
    with suppress(BarnError):
        for choice in source.run_config.planners:
            if not source.run_config.resolve_planner(choice).declared_mps:
                speeds_mps[choice.name] = 0.0
    if not speeds_mps:
        return {}

    lines = source.commands
    planners = column(source.results, "planner")
    for planner, trial_id in zip(
        planners, column(source.results, "trial_id"), strict=True
    ):
        if planner not in speeds_mps:
            continue
        speeds: Floats = np.zeros(1)
        if trial_id in lines:
            _, commands = parse_commands_line(lines[trial_id], trial_id)
            speeds = commands[:, 0]
        elif trial_id in source.tracks:
            # Free-running trials keep samples only, so the motion counts as well.
            _, track = parse_track_line(source.tracks[trial_id], trial_id)
            speeds = track.samples[:, SPEEDS]
        fastest_mps = float(np.nanmax(np.abs(speeds), initial=0.0))
        speeds_mps[planner] = max(speeds_mps[planner], fastest_mps)
    return {planner: speed for planner, speed in speeds_mps.items() if speed > 0.0}


def require_same_task(folders: Sequence[Path]) -> None:
    """Raise ConfigError unless all folders' run.json have one task.

    The task is protocol, simulator, robot and system.

    Raises:
        ConfigError: Two tasks differ; the message names the first key that does.
    """
    first, *others = folders
    task = _read_task(first)
    for folder in others:
        other_task = _read_task(folder)
        # Robots of other names are the same if nothing else differs.
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
    """Return what trials of a folder or table share, by what a message calls it.

    Robots and systems come first: a message about one of their keys would not name
    them.
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
    """Return the results of the named planners, or of all if no name is listed.

    Args:
        path: The folder, for messages.
        groups: Its results by planner.
        names: The planners; all planners if empty.

    Raises:
        ConfigError: The folder has no such planner.
    """
    for name in names:
        if name not in groups:
            raise ConfigError(f"{path}: has no planner {name!r}{suggest(name, groups)}")
    return {name: groups[name] for name in names or groups}


def read_worlds(
    results: Iterable[tuple[TrialResult, Source]],
) -> dict[str, World | str]:
    """Load the worlds of results; return them, or why one is missing, by checksum.

    Args:
        results: Results, each with its folder.

    Returns:
        Worlds by checksum; a text says why a world is missing.
    """
    # A data set is read as a whole, and all results may be of one.
    open_once = cache(open_dataset)
    worlds: dict[str, World | str] = {}
    for result, source in results:
        # By checksum, since one number may mean other worlds in other folders.
        checksum = result.world_checksum
        if checksum in worlds:
            continue
        dataset = str(source.configuration.get("dataset", result.dataset))
        try:
            world = open_once(dataset).load(result.world)
            if world.checksum != checksum:
                # Trials of other robots ran in the same world with a course to fit.
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
                f"world {result.world} of {dataset} is not the one it ran in any more"
            )
    return worlds


def planner_choices(
    configuration: Mapping[str, Any], planner: str = ""
) -> list[dict[str, Any]]:
    """Return the planner mappings in a run's plain configuration, skipping malformed.

    Args:
        configuration: Configuration of a run as plain data.
        planner: Name of the only planner that is asked for; empty for all.
    """
    choices = []
    # run.json may be edited by hand, and pages show a folder all the same.
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
