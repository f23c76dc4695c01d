"""Comparisons of two planners on the worlds and seeds that they share."""

from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace
from itertools import combinations
from pathlib import Path
from typing import Any, TypeAlias

import numpy as np

from barn_eval.analysis.entries import Entry
from barn_eval.analysis.measures import (
    COMPARED,
    MEASURES,
    Measure,
    ranking_measure,
    with_moving_measures,
)
from barn_eval.analysis.notes import list_notes
from barn_eval.analysis.planners import spelling
from barn_eval.analysis.significance import holm
from barn_eval.analysis.sources import (
    Source,
    group_by_planner,
    read_source,
    require_same_task,
    select_planners,
)
from barn_eval.analysis.statistics import (
    Paired,
    TrialValues,
    compare_pairs,
    rank_correlation,
)
from barn_eval.analysis.text_table import join_names
from barn_eval.results.row_table import column, row_keys
from barn_eval.results.store import LOGS
from barn_eval.running.command_files import read_node_parameters
from barn_eval.trials.identity import NOT_SET, flatten
from barn_eval.trials.result import Rows, RowsByPlanner
from barn_metrics.bootstrap import Interval
from barn_planners.registry import planner_config
from barn_worlds.base.config import as_dict
from barn_worlds.base.errors import BarnError, ConfigError
from barn_worlds.datasets.dataset import open_dataset

_MAX_NAMED_PARAMETERS = 5
# Fields that paired trials must share, and their names in messages.
_SHARED_FIELDS = {
    "protocol": "protocols",
    "task": "tasks (protocol, simulator or robot)",
    "world_checksum": "worlds of the same number",
    "simulator_seed": "simulator seeds",
}

Selection: TypeAlias = tuple[Source, RowsByPlanner]
"""A results folder, and its scored rows by planner."""


@dataclass(frozen=True)
class PairedMeasure:
    """A and B compared by one measure, over trials in which both have a value."""

    key: str
    measure: str
    unit: str
    larger_is_better: bool
    paired: Paired

    p_holm: float
    """The p-value, adjusted by Holm for all pairs that are compared together."""


@dataclass(frozen=True)
class Comparison:
    """A and B compared on the trials that both have, under one protocol and task."""

    a: str
    b: str
    protocol: str

    task: str
    """Fingerprint of the task."""

    metric: str
    """Key of the measure that ranks planners under the protocol."""

    trials_a: int
    trials_b: int
    rows: Sequence[PairedMeasure]

    rank_correlation: Interval
    """Spearman's correlation of the counted time per meter over worlds."""

    available: int
    """Number of worlds in the data set, 0 if unknown."""

    pairs: int = 1
    """Number of pairs that are compared together."""

    notes: Sequence[str] = ()
    """Cautions about the folders, such as that a run is not finished."""

    robot: str = ""
    """Name of the robot, empty for the Jackal."""

    parameters: str = ""
    """A sentence that names the parameters in which the planners differ."""

    @property
    def worlds(self) -> int:
        """Number of worlds in which both have a value of the ranking measure."""
        return self.row(self.metric).paired.worlds

    def row(self, key: str) -> PairedMeasure:
        """Return the row of a measure by its key; StopIteration if there is none."""
        return next(row for row in self.rows if row.key == key)

    def columns(self) -> list[dict[str, Any]]:
        """Return a dict per measure: names, means, difference, p-values and counts."""
        rows: list[dict[str, Any]] = []
        for row in self.rows:
            paired = row.paired
            rows.append(
                {
                    "a": self.a,
                    "b": self.b,
                    "measure": row.key,
                    "unit": row.unit,
                    "mean_a": paired.mean_a,
                    "mean_b": paired.mean_b,
                    **paired.difference.columns("difference"),
                    "p": paired.p,
                    "p_holm": row.p_holm,
                    "p_a_better": paired.improvement.estimate,
                    "worlds": paired.worlds,
                    "trials": paired.trials,
                }
            )
        return rows


def compare(
    a: Rows,
    b: Rows,
    label_a: str = "",
    label_b: str = "",
    keys: Sequence[str] = COMPARED,
) -> Comparison:
    """Compare A and B on shared trials, p_holm not adjusted yet; BarnError if unpaired.

    Args:
        a: Results of A.
        b: Results of B.
        label_a: Name of A in tables. By default the planner's name.
        label_b: Name of B in tables. By default the planner's name.
        keys: Keys of measures. The ranking measure is always compared, and measures of
            moving obstacles are if both planners met some.

    Raises:
        BarnError: If the results cannot be paired: their protocols, worlds or seeds
            differ, or they have no trial in common.
    """
    require_pairs(a, b)
    measure = ranking_measure(a)
    # Conclusions rest on the ranking measure, whichever others are asked for.
    if measure.key not in keys:
        keys = (measure.key, *keys)
    nobody_failed = all(column(rows, "scores.success").all() for rows in (a, b))
    compared_rows = []
    for key in with_moving_measures(keys, a, b):
        compared = MEASURES[key]
        larger = compared.better == "larger"
        tested = compared
        # Without failures, times of successes equal the counted times, and equal figures
        # must not have two p-values.
        if key == "traversal_time_s" and nobody_failed:
            tested = MEASURES["scored_time_s"]
        paired = compare_pairs(
            trial_values(a, tested), trial_values(b, tested), larger_is_better=larger
        )
        compared_rows.append(
            PairedMeasure(
                key=key,
                measure=compared.title,
                unit=compared.unit,
                larger_is_better=larger,
                paired=paired,
                # `adjust_by_holm` corrects it once it knows the number of pairs.
                p_holm=paired.p,
            )
        )

    time_per_meter = MEASURES["normalised_time_s_per_m"]
    times_a = trial_values(a, time_per_meter)
    times_b = trial_values(b, time_per_meter)
    # A correlation over worlds needs no equal noise, so trials without a pair count, too.
    correlation = rank_correlation(
        (times_a.values, times_a.worlds), (times_b.values, times_b.worlds)
    )
    return Comparison(
        a=label_a or a[0].planner,
        b=label_b or b[0].planner,
        protocol=a[0].protocol,
        task=a[0].task,
        metric=measure.key,
        trials_a=len(a),
        trials_b=len(b),
        rows=compared_rows,
        rank_correlation=correlation,
        available=count_available_worlds(a),
    )


def count_available_worlds(results: Rows) -> int:
    """Return the number of worlds in the first result's data set, 0 if unknown."""
    try:
        return len(open_dataset(results[0].dataset).world_numbers)
    # A data set that is a file on another machine must not stop an analysis.
    except (BarnError, IndexError, OSError):
        return 0


def adjust_by_holm(comparisons: Sequence[Comparison]) -> list[Comparison]:
    """Return copies of comparisons with `p_holm` and `pairs` set for all of them.

    Holm's correction is per measure, over all pairs. All comparisons must have the same
    measures.
    """
    adjusted = []
    # Each measure is a separate question, so there is no correction over measures.
    for rows in zip(*(comparison.rows for comparison in comparisons), strict=True):
        p_values = holm([row.paired.p for row in rows])
        pairs = zip(rows, p_values, strict=True)
        adjusted.append([replace(row, p_holm=p) for row, p in pairs])

    return [
        replace(comparison, rows=rows, pairs=len(comparisons))
        for comparison, *rows in zip(comparisons, *adjusted, strict=True)
    ]


def compare_folders(
    a: Path,
    b: Path | None = None,
    *,
    keys: Sequence[str] = COMPARED,
    progress: Callable[[float], None] = lambda _: None,
    selections: Sequence[Selection] = (),
) -> list[Comparison]:
    """Compare planners of one or two folders pairwise, after Holm; BarnError if none.

    If both folders hold several planners and none is selected, planners of the same name
    are compared and their labels name the folder.

    Args:
        a: A results folder, or FOLDER:PLANNER; its run may be unfinished.
        b: Another one. By default, the planners of `a` are compared with each other.
        keys: Keys of measures.
        progress: Called with the share of pairs done, 0 to 1.
        selections: What `read_selections` returned for `a` and `b`, if read before.

    Raises:
        ConfigError: If there is nothing to compare.
        BarnError: As for `compare`.
    """
    selections = selections or read_selections(a, b)
    source_a, groups_a = selections[0]
    source_b, groups_b = selections[-1]
    # Before tasks are compared, so that a wrong planner is reported first.
    pairs = _pair_planners(a, b, list(groups_a), list(groups_b))
    require_same_task([source_a.path, source_b.path])
    place_a, place_b = (item.path.resolve().name for item in (source_a, source_b))
    if place_a == place_b:
        place_a = str(source_a.path)
        place_b = str(source_b.path)

    comparisons = []
    entries: dict[str, Entry] = {}
    for done, (planner_a, planner_b) in enumerate(pairs, 1):
        label_a = planner_a
        label_b = planner_b
        if planner_a == planner_b:
            label_a = f"{spelling(planner_a)} ({place_a})"
            label_b = f"{spelling(planner_b)} ({place_b})"
        entry_a = Entry(label_a, "", source_a, planner_a, groups_a[planner_a])
        entry_b = Entry(label_b, "", source_b, planner_b, groups_b[planner_b])
        entries |= {label_a: entry_a, label_b: entry_b}
        comparisons.append(compare_entries(entry_a, entry_b, keys))
        progress(done / len(pairs))

    notes = list_notes(list(entries.values()))
    return [
        replace(comparison, notes=notes, robot=source_a.robot)
        for comparison in adjust_by_holm(comparisons)
    ]


def compare_entries(a: Entry, b: Entry, keys: Sequence[str]) -> Comparison:
    """Compare two entries' results and parameters, before Holm; errors as in `compare`.

    Args:
        a: Trials of A, with the label that tables show.
        b: Trials of B.
        keys: Keys of measures.
    """
    comparison = compare(a.results, b.results, a.label, b.label, keys)
    return replace(comparison, parameters=describe_parameter_changes(a, b))


def _pair_planners(
    a: Path, b: Path | None, names_a: list[str], names_b: list[str]
) -> list[tuple[str, str]]:
    """Return pairs (planner of A, planner of B) to compare; ConfigError if none.

    Without B, these are all pairs within A. With B, they are the only planner of each
    folder, or planners of the same name.
    """
    if b is None:
        if len(names_a) < 2:
            raise ConfigError(
                f"{a}: has only one planner, {', '.join(names_a)}; name a second folder"
            )
        return list(combinations(names_a, 2))

    if len(names_a) == len(names_b) == 1:
        return [(names_a[0], names_b[0])]
    pairs = [(name, name) for name in names_a if name in names_b]
    if not pairs:
        raise ConfigError(
            f"{a} has {', '.join(names_a)} and {b} has {', '.join(names_b)}: "
            "select planners as FOLDER:PLANNER"
        )
    return pairs


def read_selections(a: Path, b: Path | None = None) -> list[Selection]:
    """Return what `read_selection` reads from `a` and, if given, from `b`."""
    return [read_selection(path) for path in (a, b) if path]


def read_selection(path: Path) -> Selection:
    """Read FOLDER[:PLANNER,...]; return (source, rows by planner); BarnError if none.

    Args:
        path: FOLDER, FOLDER:PLANNER or FOLDER:PLANNER,PLANNER. A table may take the
            place of the folder.

    Raises:
        BarnError: If the folder has no results.
        ConfigError: If a planner has no results in it.
    """
    planners: list[str] = []
    # A folder may have a colon in its name, so an existing path is taken as it is.
    if not path.exists() and ":" in path.name:
        folder, _, names = str(path).rpartition(":")
        path = Path(folder)
        planners = names.split(",")
    source = read_source(path)
    groups = group_by_planner(source.comparable_results)
    return source, select_planners(path, groups, planners)


def label_groups(selections: Sequence[Selection]) -> RowsByPlanner:
    """Return rows by planner's display name, with the path if two folders have it."""
    names: list[str] = []
    for _, groups in selections:
        names += groups
    results_by_label: dict[str, Rows] = {}
    for source, groups in selections:
        for name, results in groups.items():
            label = spelling(name)
            if names.count(name) > 1:
                label = f"{label} ({source.path})"
            results_by_label[label] = results
    return results_by_label


def trial_values(results: Rows, measure: Measure) -> TrialValues:
    """Return a value per trial; all are NaN if failures count and a value is missing.

    The arrays are in the order of the results. A value is also NaN if the trial failed
    and the measure is of successes only. Penalties of failures are left out unless all
    values are finite.

    Args:
        results: Results of one planner.
        measure: A measure of the catalog.
    """
    worlds = column(results, "world").astype(np.int64)
    repetitions = column(results, "repetition").astype(np.int64)
    trials = TrialValues(measure.values(results), worlds, repetitions)
    failure_values = measure.failure_values(results)
    if failure_values is None:
        return trials
    if np.isnan(trials.values).any():
        # With values missing, the mean would be mostly that of failures.
        return replace(trials, values=np.full(len(worlds), np.nan))
    if not np.isfinite([trials.values, failure_values]).all():
        return trials
    return replace(
        trials,
        failures=(column(results, "scores.success") == 0).astype(np.int64),
        as_failure=failure_values,
        best=measure.best,
    )


def require_pairs(a: Rows, b: Rows) -> None:
    """Raise BarnError unless two planners' results share trials of equal task and seed.

    Args:
        a: Results of one planner.
        b: Results of the other.

    Raises:
        BarnError: If protocol, task, world or seed of a common trial differs, there is
            no common trial, or one side has several planners.
    """
    # In runs of equal seed, a repetition has the same simulator seed and noise.
    trials_a = trial_places(a)
    trials_b = trial_places(b)
    if len(trials_a) != len(a) or len(trials_b) != len(b):
        raise BarnError(
            "results of several planners cannot be compared as one; select one planner"
            " of each"
        )
    shared = trials_a.keys() & trials_b.keys()
    if not shared:
        raise BarnError("the two have no world and repetition in common")

    # In order, so that messages do not depend on hashes.
    keys = sorted(shared)
    places_a = [trials_a[key] for key in keys]
    places_b = [trials_b[key] for key in keys]
    first = len(keys)
    message = ""
    for name, description in _SHARED_FIELDS.items():
        values_a = column(a, name)[places_a]
        values_b = column(b, name)[places_b]
        different = np.flatnonzero(values_a != values_b)
        if len(different) and different[0] < first:
            first = different[0]
            trial_a = a[places_a[first]].trial_id
            trial_b = b[places_b[first]].trial_id
            message = (
                f"{trial_a} and {trial_b} have different {description}:"
                f" {values_a[first]}, {values_b[first]}"
            )
    if message:
        raise BarnError(message)


def trial_places(results: Rows) -> dict[tuple[int, int], int]:
    """Return the index of each trial by (world, repetition), the last if repeated."""
    keys = row_keys(results, ("world", "repetition"))
    return {(world, number): place for place, (world, number) in enumerate(keys)}


def describe_parameter_changes(a: Entry, b: Entry) -> str:
    """Return a sentence that names up to five differing parameters or files, or "".

    Registered planners are compared by presets and overrides, others by the parameters
    that their nodes reported and the SHA-256 of their files. Planners or nodes with
    different names are not compared. Files with different names are listed only if
    nothing else differs. Further differences are counted.

    Args:
        a: The first planner and its folder.
        b: The second planner.
    """
    values_a = _read_parameters(a.source, a.planner)
    values_b = _read_parameters(b.source, b.planner)
    # A key begins with the name of the planner or node that it belongs to.
    owners_a = {key.partition(" ")[0] for key in values_a}
    owners_b = {key.partition(" ")[0] for key in values_b}
    shared_owners = owners_a & owners_b
    changes = []
    comparable = []
    for key in values_a | values_b:
        is_shared = key.partition(" ")[0] in shared_owners
        if not is_shared or values_a.get(key) == values_b.get(key):
            continue
        value_a = values_a.get(key, NOT_SET)
        value_b = values_b.get(key, NOT_SET)
        changes.append(f"{key} ({value_a} against {value_b})")
        if not key.startswith("file ") or (key in values_a and key in values_b):
            comparable.append(changes[-1])
    changes = comparable or changes
    if not changes:
        return ""

    rest = len(changes) - _MAX_NAMED_PARAMETERS
    if rest > 0:
        changes[_MAX_NAMED_PARAMETERS:] = [f"{rest} more"]
    return f"Parameters that differ: {join_names(changes)}."


def _read_parameters(source: Source, planner: str) -> dict[str, Any]:
    """Return values by "PLANNER KEY", "NODE KEY" or "file NAME"; empty if unknown.

    They are unknown for folders of other versions and for planners not installed.
    """
    try:
        # Fails unless exactly one planner has the name.
        (choice,) = (c for c in source.run_config.planners if c.name == planner)
        if not choice.registered:
            files = {
                f"file {name}": digest[:12] for name, digest in choice.files.items()
            }
            # Nodes report parameters that launch files set and no file shows.
            return files | read_node_parameters(source.path / LOGS, planner)
        setup = source.run_config.resolve_planner(choice)
        name = choice.entry_name
        config = planner_config(name, setup.preset, setup.overrides)
    except (BarnError, ValueError):
        return {}
    return {f"{name} {key}": value for key, value in flatten(as_dict(config))}
