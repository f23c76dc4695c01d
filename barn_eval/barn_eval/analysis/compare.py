"""Comparisons of planners on the worlds and seeds that they share."""

from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace
from itertools import chain, combinations
from pathlib import Path
from typing import Any

import numpy as np

from barn_eval.analysis.measures import (
    COMPARED,
    MEASURES,
    Measure,
    metric_of,
    with_motion,
)
from barn_eval.analysis.planners import spelling
from barn_eval.analysis.significance import holm
from barn_eval.analysis.sources import (
    Source,
    by_planner,
    chosen_planners,
    notes_on,
    read_source,
    require_same_task,
)
from barn_eval.analysis.statistics import Columns, Paired, paired, rank_correlation
from barn_eval.analysis.text_table import joined
from barn_eval.results.folder import read_results
from barn_eval.results.store import LOGS
from barn_eval.running.command_files import read_node_parameters
from barn_eval.trials.identity import NOT_SET, flatten
from barn_eval.trials.result import Rows, RowsByPlanner
from barn_metrics.bootstrap import Interval
from barn_planners.registry import planner_config
from barn_worlds.base.config import as_dict
from barn_worlds.base.errors import BarnError, ConfigError
from barn_worlds.datasets.dataset import open_dataset

_NAMED = 5  # of the parameters that differ


@dataclass(frozen=True)
class PairedMeasure:
    """The comparison of A and B by one measure, named by key and title, over the trials that both have a value for.

    p_holm: the p-value after Holm for all pairs that are compared together, that of `paired` if there is one only.
    """

    key: str
    measure: str
    unit: str
    larger_is_better: bool
    paired: Paired
    p_holm: float


@dataclass(frozen=True)
class Comparison:
    """A and B on what they share, under one protocol and task (its fingerprint).

    metric: key of the measure that the protocol ranks planners by. rank_correlation: Spearman's, of the counted time
    per metre over worlds. available: how many worlds the data set has, 0 if unknown. pairs: how many are compared
    together. notes: what to know of the folders, such as that one is not finished. robot: its name, empty for the
    Jackal. parameters: in which the planners are known to differ, in a sentence.
    """

    a: str
    b: str
    protocol: str
    task: str
    metric: str
    trials_a: int
    trials_b: int
    rows: tuple[PairedMeasure, ...]
    rank_correlation: Interval
    available: int
    pairs: int = 1
    notes: tuple[str, ...] = ()
    robot: str = ""
    parameters: str = ""

    @property
    def worlds(self) -> int:
        """The number of worlds with a pair of trials that the metric is known of."""
        return self.row(self.metric).paired.worlds

    def row(self, key: str) -> PairedMeasure:
        """Return the comparison by one measure."""
        return next(row for row in self.rows if row.key == key)

    def columns(self) -> list[dict[str, Any]]:
        """Return a row of a table per measure."""
        return [
            {"a": self.a, "b": self.b, "measure": row.key, "unit": row.unit}
            | {"mean_a": row.paired.mean_a, "mean_b": row.paired.mean_b}
            | row.paired.difference.columns("difference")
            | {
                "p": row.paired.p,
                "p_holm": row.p_holm,
                "p_a_better": row.paired.improvement.estimate,
            }
            | {"worlds": row.paired.worlds, "trials": row.paired.trials}
            for row in self.rows
        ]


def compare(
    a: Rows,
    b: Rows,
    label_a: str = "",
    label_b: str = "",
    keys: Sequence[str] = COMPARED,
) -> Comparison:
    """Compare the results of one planner with those of another, or of the same one under other settings.

    keys: of the measures; the metric of the protocol is among them in any case. Raises BarnError for results that
    cannot be paired: of different protocols, of worlds that are not the same, of other seeds, or with no trial in
    common.
    """
    check_pairs(a, b)
    of_a, of_b = a[0], b[0]  # each side is of one planner, both are of one task
    first, second = (
        columns(one, MEASURES["normalised_time_s_per_m"]) for one in (a, b)
    )
    metric = metric_of(a).key
    compared = with_motion(keys if metric in keys else (metric, *keys), a, b)
    return Comparison(
        label_a or of_a.planner,
        label_b or of_b.planner,
        of_a.protocol,
        of_a.task,
        metric,
        len(a),
        len(b),
        tuple(_row(a, b, MEASURES[key]) for key in compared),
        rank_correlation((first.values, first.worlds), (second.values, second.worlds)),
        worlds_of(a),
    )


def worlds_of(results: Rows) -> int:
    """Return how many worlds the data set of results has, 0 where it is not at hand."""
    try:
        return len(open_dataset(results[0].dataset).world_numbers)
    except (BarnError, IndexError, OSError):
        return 0


def holm_adjusted(comparisons: Sequence[Comparison]) -> tuple[Comparison, ...]:
    """Return comparisons by the same measures with their p-values after Holm, for each measure over all pairs."""
    adjusted = [
        holm([row.paired.p for row in rows])
        for rows in zip(*(one.rows for one in comparisons), strict=True)
    ]
    made = []
    for pair, one in enumerate(comparisons):
        rows = tuple(
            replace(row, p_holm=adjusted[measure][pair])
            for measure, row in enumerate(one.rows)
        )
        made.append(replace(one, rows=rows, pairs=len(comparisons)))
    return tuple(made)


def compare_folders(
    a: Path,
    b: Path | None = None,
    *,
    keys: Sequence[str] = COMPARED,
    progress: Callable[[float], None] = lambda _: None,
) -> list[Comparison]:
    """Compare the results of two folders, each FOLDER or FOLDER:PLANNER, finished or not, or the planners of one.

    Where both hold several planners and none is chosen, planners of the same name are compared; their labels have the
    folder. keys: of the measures. progress: gets the share of the pairs that is done. ConfigError if nothing is left to
    compare, BarnError as `compare`.
    """
    (source_a, first), (source_b, second) = chosen = (
        selected_results(a),
        selected_results(b or a),
    )
    pairs: list[tuple[str, ...]]
    if b is None:
        pairs = list(combinations(first, 2))
    elif len(first) == len(second) == 1:
        pairs = [(*first, *second)]
    else:
        pairs = [(name, name) for name in first if name in second]
    if not pairs:
        if b is None:
            raise ConfigError(
                f"{a}: has one planner only, {', '.join(first)}; name a second folder"
            )
        raise ConfigError(
            f"{a} has {', '.join(first)} and {b} has {', '.join(second)}: name them as FOLDER:PLANNER"
        )
    folders = [source_a.path, source_b.path]
    require_same_task(folders)
    places = list(dict.fromkeys(path.resolve().name for path in folders))
    places = places if len(places) == 2 else list(map(str, folders))
    found = []
    for done, (one, other) in enumerate(pairs, 1):
        name_a, name_b = (
            (f"{spelling(one)} ({place})" for place in places)
            if one == other
            else (one, other)
        )
        made = compare(first[one], second[other], name_a, name_b, keys)
        found.append(
            replace(made, parameters=changed_parameters(source_a, one, source_b, other))
        )
        progress(done / len(pairs))
    notes = (
        notes_on(source, [*chain.from_iterable(groups.values())])
        for source, groups in chosen
    )
    told = tuple(dict.fromkeys(chain.from_iterable(notes)))
    return [
        replace(one, notes=told, robot=source_a.robot) for one in holm_adjusted(found)
    ]


def selected_results(path: Path) -> tuple[Source, RowsByPlanner]:
    """Return a folder, given as FOLDER, FOLDER:PLANNER or FOLDER:PLANNER,PLANNER, with the results of these planners.

    BarnError if the folder has no results, ConfigError if a planner has none in it.
    """
    chosen: list[str] = []
    if not path.exists() and ":" in path.name:
        folder, _, names = str(path).rpartition(":")
        path, chosen = Path(folder), names.split(",")
    source = read_source(path, read_results(path))
    return source, chosen_planners(path, by_planner(source.results), chosen)


def groups_of(a: Path, b: Path | None = None) -> RowsByPlanner:
    """Return results by planner of one folder or two, given as for `selected_results`, each by its own name."""
    chosen = [selected_results(path) for path in (a, b) if path is not None]
    names = [name for _, groups in chosen for name in groups]
    return {
        spelling(name) + (f" ({source.path})" if names.count(name) > 1 else ""): results
        for source, groups in chosen
        for name, results in groups.items()
    }


def _row(a: Rows, b: Rows, measure: Measure) -> PairedMeasure:
    larger = measure.better == "larger"
    found = paired(columns(a, measure), columns(b, measure), larger_is_better=larger)
    return PairedMeasure(
        measure.key, measure.title, measure.unit, larger, found, found.p
    )


def columns(results: Rows, measure: Measure) -> Columns:
    """Return a measure of results as statistics take it."""
    worlds, repetitions = (
        np.array([getattr(one, of) for one in results], np.int64)
        for of in ("world", "repetition")
    )
    made = Columns(measure.values(results), worlds, repetitions)
    if (of_failure := measure.as_failure) is None:
        return made
    failures = np.array([not result.scores.success for result in results], np.int64)
    as_failure = np.array([of_failure(result) for result in results], np.float64)
    return replace(made, failures=failures, as_failure=as_failure, best=measure.best)


def check_pairs(a: Rows, b: Rows) -> None:
    """Raise BarnError if the two are not results of the same task, or have nothing in common."""
    first, second = (
        {(one.world, one.repetition): one for one in results} for results in (a, b)
    )
    if len(first) != len(a) or len(second) != len(b):
        raise BarnError(
            "results of several planners cannot be compared as one; choose a planner of each"
        )
    shared = first.keys() & second.keys()
    if not shared:
        raise BarnError("the two have no trial of the same world and repetition")
    for key in sorted(shared):
        one, other = first[key], second[key]
        for name, what in (
            ("protocol", "protocols"),
            ("task", "tasks (protocol, simulator or robot)"),
            ("world_checksum", "worlds of the same number"),
            ("simulator_seed", "simulator seeds"),
        ):
            values = getattr(one, name), getattr(other, name)
            if values[0] != values[1]:
                raise BarnError(
                    f"{one.trial_id} and {other.trial_id} have different {what}: {values[0]}, {values[1]}"
                )


def changed_parameters(a: Source, of_a: str, b: Source, of_b: str) -> str:
    """Return in a sentence what differs between two planners' parameters and files (SHA-256); empty if nothing does.

    Those of the registry by their presets and overrides, others as their nodes told them; of planners or nodes that are
    not of the same name, nothing is said, and of files of other names only where nothing else differs.
    """
    one, other = _parameters(a, of_a), _parameters(b, of_b)
    shared = {key.partition(" ")[0] for key in one} & {
        key.partition(" ")[0] for key in other
    }
    keys = [
        key
        for key in one | other
        if key.partition(" ")[0] in shared and one.get(key) != other.get(key)
    ]
    keys = [
        key
        for key in keys
        if not key.startswith("file ") or key in one.keys() & other.keys()
    ] or keys
    named = [
        f"{key} ({one.get(key, NOT_SET)} against {other.get(key, NOT_SET)})"
        for key in keys[:_NAMED]
    ]
    more = [f"{len(keys) - _NAMED} more"] if len(keys) > _NAMED else []
    return f"Parameters that differ: {joined([*named, *more])}." if named else ""


def _parameters(source: Source, planner: str) -> dict[str, Any]:
    try:
        (choice,) = (one for one in source.experiment.planners if one.name == planner)
        if not choice.registered:
            files = {
                f"file {name}": digest[:12] for name, digest in choice.files.items()
            }
            return files | read_node_parameters(source.path / LOGS, planner)
        setup = source.experiment.resolve_planner(choice)
        config = planner_config(planner, setup.preset, setup.overrides)
        return {f"{planner} {key}": value for key, value in flatten(as_dict(config))}
    except (BarnError, ValueError):
        return {}  # of another version of the suite, or of a planner that is not installed here
