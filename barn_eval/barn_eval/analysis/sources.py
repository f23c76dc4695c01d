"""Results folders, and the planners in them with their labels and colors."""

import math
from collections import Counter
from collections.abc import Callable, Iterable, Iterator, Mapping, Sequence
from contextlib import suppress
from dataclasses import dataclass, field, replace
from functools import cache, cached_property
from pathlib import Path
from statistics import median
from typing import Any, NamedTuple

import numpy as np

from barn_eval.analysis.planners import assign_colors, spelling
from barn_eval.results.bags import BAGS
from barn_eval.results.commands import count_equal_commands, parse_commands_line
from barn_eval.results.folder import read_results, select_scored
from barn_eval.results.rows import COMMANDS_FILE, read_tracks, read_trial_lines
from barn_eval.results.run_file import CLAIMED, SUBMISSION_FILE, RunFile
from barn_eval.results.table_files import (
    TABLE_SYSTEM,
    is_table_file,
    read_table_file,
)
from barn_eval.results.tracks import SPEEDS, parse_track_line
from barn_eval.running.setting_folders import expand_sweeps, parse_folder_name
from barn_eval.trials.identity import first_difference
from barn_eval.trials.result import (
    COMPUTE_MODE_LABELS,
    MAX_MISSED_SHARE,
    Rows,
    RowsByPlanner,
    TrialResult,
    describe_computer,
)
from barn_eval.trials.run_config import RunConfig
from barn_eval.trials.system import System, system_in
from barn_planners.registry import planner_names
from barn_sim.config import chassis_in, robot_of
from barn_worlds.base.arrays import Floats
from barn_worlds.base.config import as_dict, from_dict
from barn_worlds.base.errors import BarnError, ConfigError, suggest
from barn_worlds.datasets.dataset import open_dataset, select_worlds
from barn_worlds.geometry.footprint import Footprint
from barn_worlds.robots.contact import contact_footprint
from barn_worlds.robots.files import name_unless_standard
from barn_worlds.robots.robot import Chassis
from barn_worlds.worlds.course import fit_to_robot
from barn_worlds.worlds.world import World

_MAX_NAMED_TRIALS = 5
# The slowest class of speed caps; each class is twice as fast as the one before.
_SLOWEST_CLASS_MPS = 0.5


@dataclass(frozen=True, eq=False)
class Source:
    """One results folder."""

    path: Path

    kind: str
    """Whether it is a "run" of one planner, a "campaign" of several or a "table"."""

    results: tuple[TrialResult, ...]
    """Scored trials by world, repetition and planner."""

    configuration: Mapping[str, Any]
    """Configuration of the run as plain data, which may be of another version."""

    sessions: tuple[Mapping[str, Any], ...]
    """Versions, commit and machine of each session."""

    planned: int | None
    """Number of trials of the whole run, None if unknown."""

    tracks: Mapping[str, str] = field(default_factory=dict)
    """Lines of tracks by trial."""

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
        if planner in planner_names():
            declaration = "speed_cap of its PlannerEntry declares it"
        return (
            f"{planner} declares no top speed: its fastest command counts, {cap_mps:g}"
            f" m/s; {declaration}."
        )

    @cached_property
    def comparable_results(self) -> tuple[TrialResult, ...]:
        """The trials; those without a declared speed cap as if it were the fastest command.

        Rows have the robot's limit there, by which a slow robot looks inefficient.
        """
        results = []
        for result in self.results:
            if result.planner not in self.commanded_mps:
                results.append(result)
                continue
            period_s = self.run_config.protocol.longest_look_s
            cap_mps = self.commanded_mps[result.planner]
            results.append(cap_result(result, cap_mps, period_s))
        return tuple(results)

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


@dataclass(frozen=True, eq=False)
class Entry:
    """The trials of one planner of one folder, under a label and color of their own."""

    label: str
    color: str
    source: Source
    planner: str
    results: tuple[TrialResult, ...]

    @property
    def setting(self) -> dict[str, float | str]:
        """Swept parameter values from the folder's name; empty for other folders."""
        return parse_folder_name(self.source.path)

    def where(self, holds: Callable[[TrialResult], bool]) -> "Entry":
        """Return a copy of the entry with the results for which `holds` is true."""
        return replace(self, results=tuple(filter(holds, self.results)))


class BoardClass(NamedTuple):
    """What planners must share, beside their task, to be ranked together."""

    protocol: str
    system: str
    speed_class_mps: float
    computing: str

    @property
    def speed_text(self) -> str:
        """The speed class in words; empty for rows of versions without caps."""
        if not self.speed_class_mps:
            return ""
        return f"up to {self.speed_class_mps:g} m/s"

    def difference(self, other: "BoardClass") -> str:
        """Return how this class differs from another, in words; empty if equal."""
        if self.protocol != other.protocol:
            return f"{self.protocol} protocol"
        if self.system != other.system:
            return self.system or "the suite's simulator"
        if self.speed_class_mps != other.speed_class_mps:
            return self.speed_text or "unknown speed"
        if self.computing != other.computing:
            return self.computing or "unknown computing"
        return ""


def board_class(entry: Entry) -> BoardClass:
    """Return what decides with whom an entry can be ranked.

    Raises:
        ConfigError: Its trials have several protocols.
    """
    protocols = {result.protocol for result in entry.results}
    if len(protocols) > 1:
        raise ConfigError(
            f"{entry.source.path}: {entry.planner} has trials of several protocols"
        )
    return BoardClass(
        protocol=protocols.pop(),
        system=entry.source.system.label,
        speed_class_mps=_speed_class_mps(entry.results),
        computing=computing_of(entry.results).class_name,
    )


def _speed_class_mps(results: Rows) -> float:
    """Return the upper end [m/s] of the speed class of one planner's highest cap.

    The classes end at 0.5 m/s, 1 m/s, 2 m/s and so on, and below 0.5 m/s at halves of
    it. Rows of versions without caps are in class 0.
    """
    # A planner that is faster in some worlds belongs among the faster ones.
    cap_mps = max(result.speed_cap_mps or 0.0 for result in results)
    if not cap_mps:
        return 0.0
    # A cap at the end of a class belongs to it in spite of rounding.
    doublings = math.ceil(math.log2(cap_mps / _SLOWEST_CLASS_MPS) - 1e-9)
    return _SLOWEST_CLASS_MPS * 2.0**doublings


def find_mixture(entries: Sequence[Entry]) -> Iterator[str]:
    """Yield sentences on what entries that are compared do not have in common.

    That is their class and the suite's commit; their tasks are equal.
    """
    classes = {entry.label: board_class(entry) for entry in entries}
    if len(set(classes.values())) > 1:
        texts = []
        for label, shared in classes.items():
            words = filter(None, (shared.speed_text, shared.computing))
            texts.append(f"{label} {', '.join(words)}")
        yield f"Compared across classes that boards rank apart: {'; '.join(texts)}."

    folders: dict[str, Path] = {}
    for entry in entries:
        for session in entry.source.sessions:
            commit = str(session.get("commit") or "unknown")
            folders.setdefault(commit, entry.source.path)
    if len(folders) > 1:
        texts = [f"{commit[:12]} in {path}" for commit, path in folders.items()]
        yield f"Commits differ: {', '.join(texts)}."


def list_notes(entries: Sequence[Entry]) -> list[str]:
    """Return all warnings on entries that are compared."""
    notes = list(find_mixture(entries))
    results: dict[Source, list[TrialResult]] = {}
    for entry in entries:
        results.setdefault(entry.source, []).extend(entry.results)
    for source, rows in results.items():
        notes += notes_on(source, rows)
    notes += _find_equal_planners(results)
    # One folder may have been read twice.
    return list(dict.fromkeys(notes))


def _find_equal_planners(results: Mapping[Source, Rows]) -> Iterator[str]:
    """Yield a sentence for two planners that succeed by equal commands."""
    trials = []
    for source, rows in results.items():
        # A table of results has no commands.
        if source.path.is_file():
            continue
        lines = read_trial_lines(source.path / COMMANDS_FILE)
        for row in rows:
            if row.scores.success and row.trial_id in lines:
                shared = (row.world_checksum, row.simulator_seed)
                trials.append((shared, row.planner, lines[row.trial_id]))
    for pair, count in count_equal_commands(trials).items():
        yield f"{' and '.join(pair)} have equal commands in {count} trials."


def read_source(path: Path, rows: Rows | None = None) -> Source:
    """Read run.json, scored rows and tracks of a results folder, finished or not.

    Args:
        path: The folder, or a file with anybody's table.
        rows: Its rows, if they have been read already. There may be none yet. Tracks
            are not read then.

    Raises:
        ConfigError: The folder holds no run, or results of another task.
        BarnError: A file cannot be read.
    """
    if is_table_file(path):
        results = sorted(
            read_table_file(path), key=lambda result: (result.world, result.repetition)
        )
        configuration = {"system": as_dict(TABLE_SYSTEM)}
        return Source(path, "table", tuple(results), configuration, (), None)
    run_file = RunFile.read(path)
    tracks: Mapping[str, str] = {}
    if rows is None:
        results = read_results(path)
        tracks = read_tracks(path)
    else:
        results = select_scored(run_file, rows)

    choices = planner_choices(run_file.config)
    planners = [str(choice.get("name")) for choice in choices]
    kind = "campaign" if len(planners) > 1 else "run"
    # A merged or edited folder may have rows of planners that run.json lacks.
    planners += sorted({result.planner for result in results}.difference(planners))
    # In the order of the schedule, so that nothing shows which worker was faster.
    results.sort(
        key=lambda result: (
            result.world,
            result.repetition,
            planners.index(result.planner),
        )
    )
    return Source(
        path=path,
        kind=kind,
        results=tuple(results),
        configuration=run_file.config,
        sessions=run_file.sessions,
        planned=_count_planned_trials(run_file.config),
        tracks=tracks,
    )


def notes_on(source: Source, results: Rows) -> list[str]:
    """Return warnings on results: missing trials, late commands, slow planners.

    Args:
        source: The folder.
        results: Some or all of its results.
    """
    notes = []
    trials = len(source.results)
    if source.planned and source.planned > trials:
        notes.append(f"{source.path} is partial: {trials} of {source.planned} trials")
    notes += _describe_observations(source.path, results)
    notes.append("; ".join(_find_disturbances(source.path, results)))
    for planner in group_by_planner(results):
        if planner in source.commanded_mps:
            notes.append(source.describe_commanded(planner))
    notes.append(assumption_text(source.path, results))
    if (source.path / SUBMISSION_FILE).exists():
        notes.append(f"{source.path} only claims {', '.join(CLAIMED)}.")
    return [note for note in notes if note]


def _describe_observations(path: Path, results: Rows) -> Iterator[str]:
    """Yield a sentence per system that was observed, and one on unknown contacts."""
    systems = {row.observed.system for row in results if row.observed}
    for system in sorted(systems):
        yield f"{path}: trials of {system} were observed, not driven again"
    unknown = sum(result.measures.contacts is None for result in results)
    if unknown:
        yield (
            f"{path}: contacts of {unknown} of {len(results)} trials are unknown, as"
            " nobody reported them, so a success may have touched an obstacle"
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

    lines = read_trial_lines(source.path / COMMANDS_FILE)
    tracks = source.tracks or read_tracks(source.path)
    for result in source.results:
        trial_id = result.trial_id
        if result.planner not in speeds_mps:
            continue
        speeds: Floats = np.zeros(1)
        if trial_id in lines:
            _, commands = parse_commands_line(lines[trial_id], trial_id)
            speeds = commands[:, 0]
        elif trial_id in tracks:
            # Free-running trials keep samples only, so the motion counts as well.
            _, track = parse_track_line(tracks[trial_id], trial_id)
            speeds = track.samples[:, SPEEDS]
        fastest_mps = float(np.nanmax(np.abs(speeds), initial=0.0))
        speeds_mps[result.planner] = max(speeds_mps[result.planner], fastest_mps)
    return {planner: speed for planner, speed in speeds_mps.items() if speed > 0.0}


def _find_disturbances(path: Path, results: Rows) -> Iterator[str]:
    """Yield a sentence on trials with late commands and one on trials made again."""
    # Over ROS a busy machine delays commands, which no score can tell apart from a slow
    # planner.
    late = sum(result.wall_clock.is_late for result in results)
    if late:
        yield (
            f"{late} of {len(results)} trials in {path} are marked: more than "
            f"{MAX_MISSED_SHARE:.0%} of their control periods had no command in time, "
            "so they tell of the machine as well as of the planner"
        )

    repeated = [result for result in results if result.wall_clock.attempts > 1]
    if repeated:
        names = ", ".join(
            f"{result.trial_id}: {result.wall_clock.retry_note}"
            for result in repeated[:_MAX_NAMED_TRIALS]
        )
        rest = len(repeated) - _MAX_NAMED_TRIALS
        if rest > 0:
            names += f" and {rest} more"
        yield (
            f"{len(repeated)} of {len(results)} trials in {path} were not made at the "
            f"first attempt: {names}"
        )


@dataclass(frozen=True)
class Computing:
    """How trials of a planner charge its computing."""

    modes: tuple[str, ...]
    """Labels of the compute modes; none for rows of versions without them."""

    computer: float
    """Speed of the computer that the scores assume, 1 for the reference computer.

    It is the median over trials that charge nothing or what the planner declares, and 0
    if there is none.
    """

    @property
    def is_too_slow(self) -> bool:
        """Whether scores assume a computer faster than the reference computer."""
        return self.computer > 1.0

    @property
    def text(self) -> str:
        """The faster computer that scores assume, in words, or else the compute modes.

        Empty if neither is known. A computer no faster than the reference is not named.
        """
        return describe_computer(self.computer) or " and ".join(self.modes)

    @property
    def class_name(self) -> str:
        """Class of a board: a faster computer, or the compute modes in words."""
        if self.is_too_slow:
            return "computing on a faster computer"
        return self.text


def computing_of(results: Rows) -> Computing:
    """Return compute modes and median assumed computer speed of one planner's rows."""
    # Rows of one planner may differ if a folder was resumed with another option.
    modes = {
        COMPUTE_MODE_LABELS[result.compute] for result in results if result.compute
    }
    computers = []
    for result in results:
        if result.wall_clock.computer is not None:
            computers.append(result.wall_clock.computer)
    computer = 0.0
    if computers:
        # A median, since single trials may have met a busy machine.
        computer = median(computers)
    return Computing(tuple(sorted(modes)), computer)


def assumption_text(path: Path, results: Rows) -> str:
    """Return in one text which planners' scores assume a faster computer.

    Args:
        path: Folder of the results.
        results: Results of any planners.

    Returns:
        The text, empty if there is no such planner.
    """
    notes = []
    for planner, rows in group_by_planner(results).items():
        computing = computing_of(rows)
        if computing.is_too_slow:
            notes.append(f"{spelling(planner)} in {path}: {computing.text}")
    return "; ".join(notes)


def read_entries(paths: Sequence[Path]) -> list[Entry]:
    """Read results folders and sweeps; return a labeled entry per planner and folder.

    The folder of a sweep stands for the folders of its settings.

    Raises:
        ConfigError: A folder is named twice, holds no run or mixes tasks.
        BarnError: A file cannot be read.
    """
    folders = expand_sweeps(paths)
    # Twice the same trials would look like twice the evidence.
    for path, count in Counter(path.resolve() for path in folders).items():
        if count > 1:
            raise ConfigError(f"{path}: is named twice")
    return entries_of([read_source(path) for path in folders])


def entries_of(sources: Sequence[Source]) -> list[Entry]:
    """Return an entry per planner of each folder, with distinct labels and colors."""
    entries = []
    for source in sources:
        for planner, results in group_by_planner(source.comparable_results).items():
            entries.append(Entry("", "", source, planner, tuple(results)))
    return label_entries(entries)


def label_entries(entries: Sequence[Entry]) -> list[Entry]:
    """Return copies of entries with new labels and colors, distinct from each other.

    Entries of one planner are labeled by the settings in which they differ, or else by
    their folders.
    """
    by_setting = []
    by_name = []
    by_path = []
    for entry in entries:
        name = spelling(entry.planner)
        same_planner = [other for other in entries if other.planner == entry.planner]
        by_setting.append(name + _distinct_settings(entry, same_planner))
        folder = f" ({entry.source.path.resolve().name})"
        by_name.append(name + folder if len(same_planner) > 1 else name)
        by_path.append(f"{name} ({entry.source.path})")

    # Paths are distinct in any case; the shorter labels are tried first.
    for labels in (by_setting, by_name, by_path):
        if len(set(labels)) == len(entries):
            break
    colors = assign_colors([entry.planner for entry in entries])
    return [
        replace(entry, label=label, color=color)
        for entry, label, color in zip(entries, labels, colors, strict=True)
    ]


def _distinct_settings(entry: Entry, same_planner: Sequence[Entry]) -> str:
    """Return as " (KEY=VALUE, ...)" settings that differ among a planner's entries."""
    settings = _planner_settings(entry)
    other_settings = [_planner_settings(other) for other in same_planner]
    texts = []
    for key, value in settings.items():
        # What all have in common does not tell them apart.
        if any(other.get(key) != value for other in other_settings):
            texts.append(f"{key.rpartition('.')[2]}={value}")
    return f" ({', '.join(texts)})" if texts else ""


def _planner_settings(entry: Entry) -> dict[str, Any]:
    """Return preset, max_speed_mps and overrides of an entry's planner by key.

    What is missing or malformed in run.json is left out.
    """
    choices = planner_choices(entry.source.configuration, entry.planner)
    choice: dict[str, Any] = next(iter(choices), {})
    settings = {
        key: choice[key] for key in ("preset", "max_speed_mps") if choice.get(key)
    }
    overrides = choice.get("overrides")
    if isinstance(overrides, dict):
        settings |= overrides
    return settings


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
        for what, content in task.items():
            change = first_difference(content, other_task[what])
            if change is not None:
                key, value, other_value = change
                raise ConfigError(
                    f"different {what} cannot be compared: {key} is {value!r} in"
                    f" {first}, {other_value!r} in {folder}"
                )


def _read_task(path: Path) -> dict[str, dict[str, Any]]:
    """Return what trials of a folder or table share, by what a message calls it.

    Robots and systems come first: a message about one of their keys would not name
    them.
    """
    task: dict[str, Any] = {"simulator": None, "system": as_dict(TABLE_SYSTEM)}
    if not is_table_file(path):
        task = RunFile.read(path).task()
    return {
        "robots": {"robot": chassis_in(task["simulator"]).name},
        "systems": as_dict(system_in(task)),
        "tasks": task,
    }


def group_by_planner(results: Iterable[TrialResult]) -> RowsByPlanner:
    """Return lists of results by planner name, in order of first appearance."""
    groups: dict[str, list[TrialResult]] = {}
    for result in results:
        groups.setdefault(result.planner, []).append(result)
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
                robot = robot_of(source.run_config.simulator)
                world = fit_to_robot(world, robot, source.run_config.course)
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
