"""Runs and campaigns on disk, and the planners in them, each with a label and a colour of its own."""

from collections import Counter
from collections.abc import Callable, Iterable, Mapping, Sequence
from dataclasses import dataclass, field, replace
from functools import cache, cached_property
from pathlib import Path
from statistics import median
from typing import Any

from barn_eval.analysis.planners import colours, spelling
from barn_eval.results.bags import BAGS
from barn_eval.results.folder import read_results, select_scored
from barn_eval.results.rows import TrackFile
from barn_eval.results.run_file import RunFile
from barn_eval.running.setting_folders import expand_sweeps
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
from barn_sim.config import chassis_in, robot_of
from barn_worlds.base.config import from_dict
from barn_worlds.base.errors import BarnError, ConfigError, suggest
from barn_worlds.datasets.dataset import open_dataset, select_worlds
from barn_worlds.geometry.footprint import Footprint
from barn_worlds.robots.contact import contact_footprint
from barn_worlds.robots.files import other_name
from barn_worlds.robots.robot import Chassis
from barn_worlds.worlds.course import fit_to_robot
from barn_worlds.worlds.world import World

_NAMED = 5  # trials made at a second attempt that a message names


@dataclass(frozen=True, eq=False)
class Source:
    """One folder of results, in the order of the plan.

    configuration: of its run.json, as plain data; sessions: versions, commit and machine of each; planned: number of
    trials that it is to have, None where that cannot be told. tracks: lines of those that were kept, by trial.
    """

    path: Path
    kind: str
    results: tuple[TrialResult, ...]
    configuration: Mapping[str, Any]
    sessions: tuple[Mapping[str, Any], ...]
    planned: int | None
    tracks: Mapping[str, str] = field(default_factory=dict)

    @cached_property
    def experiment(self) -> RunConfig:
        """What was run; BarnError if this version does not read the configuration."""
        return from_dict(RunConfig, dict(self.configuration), str(self.path))

    @cached_property
    def chassis(self) -> Chassis:
        """Body of the robot; ConfigError if the configuration says what is not allowed."""
        return chassis_in(self.configuration.get("simulator"))

    @property
    def robot(self) -> str:
        """Name of the robot; empty for the standard one."""
        return other_name(self.chassis)

    @cached_property
    def outline(self) -> Footprint:
        """Footprint of what can touch of the robot."""
        return contact_footprint(self.chassis)

    def bag(self, trial_id: str) -> Path:
        """Return where the bag of a trial is, if it was kept."""
        return self.path / BAGS / trial_id


@dataclass(frozen=True, eq=False)
class Entry:
    """The trials of one planner of one source, under a label and colour that no other entry of the report has."""

    label: str
    colour: str
    source: Source
    planner: str
    results: tuple[TrialResult, ...]


def read_source(path: Path, rows: Rows | None = None) -> Source:
    """Return the results of an experiment, finished or not; ConfigError or BarnError in one line if there is none.

    rows: of the folder, where they have been read already; there may be none yet, and tracks are left out then.
    """
    run = RunFile.read(path)
    results = read_results(path) if rows is None else select_scored(run, path, rows)
    names = _named(run.config)
    names += sorted({one.planner for one in results}.difference(names))
    # in the order of the plan, so that nothing tells which worker was faster
    results.sort(key=lambda one: (one.world, one.repetition, names.index(one.planner)))
    return Source(
        path,
        "campaign" if len(_named(run.config)) > 1 else "run",
        tuple(results),
        run.config,
        run.sessions,
        _planned(run.config),
        TrackFile(path).read() if rows is None else {},
    )


def notes_on(source: Source, results: Rows) -> list[str]:
    """Return what to know of a folder and results of it: unfinished, late commands, planners that are too slow."""
    trials, planned = len(source.results), source.planned
    partial = (
        f"{source.path} is partial: {trials} of {planned} trials"
        if planned and planned > trials
        else ""
    )
    return [
        *filter(
            None,
            (
                partial,
                _late_text(source.path, results),
                assumed_text(source.path, results),
            ),
        )
    ]


def _late_text(path: Path, results: Rows) -> str:
    """Return how many trials in a folder are marked, for late commands or a second attempt; empty if none is."""
    late = sum(result.wall_clock.is_late for result in results)
    text = (
        f"{late} of {len(results)} trials in {path} are marked: more than {MAX_MISSED_SHARE:.0%} of their control periods"
        " had no command in time, so they tell of the machine as well as of the planner"
    )
    again = [result for result in results if result.wall_clock.attempts > 1]
    named = ", ".join(
        f"{one.trial_id}: {one.wall_clock.retry_note}" for one in again[:_NAMED]
    )
    more = f" and {len(again) - _NAMED} more" if len(again) > _NAMED else ""
    repeated = f"{len(again)} of {len(results)} trials in {path} were not made at the first attempt: {named}{more}"
    return "; ".join(filter(None, (text if late else "", repeated if again else "")))


def compute_way(results: Rows) -> str:
    """Return in words what trials of a planner charge for its computing; those of unlike ways are not ranked together.

    One that declares its computing, or nothing, must fit what it declares or the control period on the reference
    computer, in the median of its trials; else the text says so. Empty for rows of versions that did not say.
    """
    ways = {COMPUTE_MODE_LABELS[result.compute] for result in results if result.compute}
    computers = [
        one.wall_clock.computer
        for one in results
        if one.wall_clock.computer is not None
    ]
    return describe_computer(median(computers) if computers else 0.0) or " and ".join(
        sorted(ways)
    )


def assumed_text(path: Path, results: Rows) -> str:
    """Return which planners of a folder do not fit the control period and are not charged for it; empty if none."""
    ways = (
        (spelling(name), compute_way(one)) for name, one in by_planner(results).items()
    )
    return "; ".join(
        f"{name} in {path}: {way}" for name, way in ways if way.startswith("its score")
    )


def read_entries(paths: Sequence[Path]) -> list[Entry]:
    """Return the planners of all folders, in the order given; ConfigError if a folder is named twice.

    The folder of a sweep stands for those of its settings.
    """
    paths = expand_sweeps(paths)
    for path, count in Counter(path.resolve() for path in paths).items():
        if count > 1:
            raise ConfigError(f"{path}: is named twice")
    return entries_of([read_source(path) for path in paths])


def entries_of(sources: Sequence[Source]) -> list[Entry]:
    """Return the planners of all sources, told apart."""
    groups = (
        (source, *one)
        for source in sources
        for one in by_planner(source.results).items()
    )
    return labelled(
        [
            Entry("", "", source, planner, tuple(results))
            for source, planner, results in groups
        ]
    )


def labelled(entries: Sequence[Entry]) -> list[Entry]:
    """Return entries with labels and colours by which they are told apart beside each other.

    Entries of one planner have in their labels the settings in which they differ, or else their folders.
    """
    planners = [entry.planner for entry in entries]
    same = {
        planner: [one for one in entries if one.planner == planner]
        for planner in planners
    }
    choices: tuple[Callable[[Entry], str], ...] = (
        lambda one: _differing(one, same[one.planner]),
        lambda one: (
            f" ({one.source.path.resolve().name})" if len(same[one.planner]) > 1 else ""
        ),
        lambda one: f" ({one.source.path})",
    )
    told = [[spelling(one.planner) + more(one) for one in entries] for more in choices]
    labels = next((one for one in told if len(set(one)) == len(one)), told[-1])
    marks = zip(entries, labels, colours(planners), strict=True)
    return [
        replace(entry, label=label, colour=colour) for entry, label, colour in marks
    ]


def _differing(entry: Entry, others: Sequence[Entry]) -> str:
    """Return the settings of an entry's planner that others of the planner have not, in brackets."""
    own, known = _settings(entry), [_settings(other) for other in others]
    names = [
        f"{key.rpartition('.')[2]}={own[key]}"
        for key in own
        if any(one.get(key) != own[key] for one in known)
    ]
    return f" ({', '.join(names)})" if names else ""


def _settings(entry: Entry) -> dict[str, Any]:
    """Return what was set of an entry's planner, however malformed its configuration."""
    planners = entry.source.configuration.get("planners")
    listed = planners if isinstance(planners, list) else ()
    own = next(
        (
            one
            for one in listed
            if isinstance(one, dict) and one.get("name") == entry.planner
        ),
        {},
    )
    overrides = own.get("overrides")
    named = {key: own[key] for key in ("preset", "max_speed_mps") if own.get(key)}
    return named | (overrides if isinstance(overrides, dict) else {})


def require_same_task(folders: Sequence[Path]) -> None:
    """Raise ConfigError naming the first key by which the tasks of folders of results differ.

    A task is everything but worlds and planners: protocol, simulator, robot.
    """
    (first, known), *others = [
        (folder, RunFile.read(folder).task()) for folder in folders
    ]
    for folder, task in others:
        one, other = (chassis_in(found["simulator"]).name for found in (known, task))
        if one != other:
            raise ConfigError(
                f"different robots cannot be compared: {one} in {first}, {other} in {folder}"
            )
        if found := first_difference(known, task):
            key, old, new = found
            raise ConfigError(
                f"different tasks cannot be compared: {key} is {old!r} in {first}, {new!r} in {folder}"
            )


def by_planner(results: Iterable[TrialResult]) -> RowsByPlanner:
    """Return the results of each planner, planners in the order in which they come."""
    groups: dict[str, list[TrialResult]] = {}
    for result in results:
        groups.setdefault(result.planner, []).append(result)
    return groups


def chosen_planners(
    path: Path, groups: RowsByPlanner, names: Sequence[str]
) -> RowsByPlanner:
    """Return the results of some planners of a folder, of all without names; ConfigError for one it does not have."""
    for name in names:
        if name not in groups:
            raise ConfigError(f"{path}: has no planner {name!r}{suggest(name, groups)}")
    return {name: groups[name] for name in names or groups}


def read_worlds(
    results: Iterable[tuple[TrialResult, Source]],
) -> dict[str, World | str]:
    """Return the worlds of results, each given with its source, by checksum; a text says why there is none."""
    opened = cache(open_dataset)
    found: dict[str, World | str] = {}
    for result, source in results:
        if result.world_checksum in found:
            continue
        world: World | str
        dataset = str(source.configuration.get("dataset", result.dataset))
        try:
            world = opened(dataset).load(result.world)
            if world.checksum != result.world_checksum:
                world = fit_to_robot(
                    world,
                    robot_of(source.experiment.simulator),
                    source.experiment.course,
                )
            if world.checksum != result.world_checksum:
                world = f"world {result.world} of {dataset} is not the one it ran in any more"
        except (BarnError, OSError) as error:
            world = f"its world cannot be read: {error}"
        found[result.world_checksum] = world
    return found


def _named(configuration: Mapping[str, Any]) -> list[str]:
    """Return the names of the planners of a configuration, however malformed."""
    planners = configuration.get("planners")
    return (
        [str(one.get("name")) for one in planners if isinstance(one, dict)]
        if isinstance(planners, list)
        else []
    )


def _planned(configuration: Mapping[str, Any]) -> int | None:
    try:
        worlds = select_worlds(
            str(configuration["worlds"]),
            open_dataset(str(configuration["dataset"])).world_numbers,
        )
        return (
            len(worlds)
            * int(configuration["repetitions"])
            * len(configuration.get("planners", (None,)))
        )
    except (BarnError, KeyError, TypeError, ValueError, OSError):
        return None
