"""All that a report says: figures, computed once for tables and drawings, and how its results are made again."""

import itertools
import json
import math
import shlex
from collections.abc import Callable, Mapping, Sequence
from contextlib import suppress
from dataclasses import dataclass, replace
from functools import partial
from typing import Any

import yaml

from barn_eval.analysis.compare import (
    Comparison,
    changed_parameters,
    compare,
    holm_adjusted,
)
from barn_eval.analysis.difficulty import Band, Difficulty, bands
from barn_eval.analysis.measures import (
    COMPARED,
    DRIVEN,
    MEASURES,
    SCORED,
    metric_of,
    with_motion,
)
from barn_eval.analysis.significance import ALPHA, holm
from barn_eval.analysis.sources import Entry, Source
from barn_eval.analysis.summary import Summary, summarise
from barn_eval.analysis.tables import (
    bands_table,
    comparison_table,
    headline_table,
    measures_table,
    outcomes_table,
)
from barn_eval.analysis.text_table import TextTable, joined
from barn_eval.analysis.verdict import (
    Conclusion,
    rank_results,
    results_verdict,
    verdict,
)
from barn_eval.trials.protocol import PROTOCOLS
from barn_eval.trials.ros_config import RosConfig
from barn_eval.trials.spec import simulator_config
from barn_sim.config import robot_of
from barn_worlds.base.config import Checked, as_dict, fields_of
from barn_worlds.base.errors import BarnError, ConfigError
from barn_worlds.robots.files import ROBOTS

Jobs = Sequence[Callable[[], Any]]
MOST_PAIRS = 45  # of ten entries; more would be no table to read
_ALIKE = 3  # pairs without a clear difference that are named
_IN = ("success", "traversal_time_s", "min_clearance_m", "contact_s")


@dataclass(frozen=True)
class Refusal:
    """Two entries that cannot be compared, and why."""

    a: str
    b: str
    why: str


@dataclass(frozen=True)
class Overview:
    """What a report says in figures; summaries in the order of entries.

    verdict: by the metric, None where `refusals` says why there is none. where, why: planners differ, and in what.
    """

    summaries: tuple[Summary, ...]
    order: Difficulty
    bands: tuple[Band, ...]
    comparisons: tuple[Comparison, ...]
    refusals: tuple[Refusal, ...]
    verdict: Conclusion | None
    where: Mapping[str, str]
    why: Sequence[str]


def analyse(
    entries: Sequence[Entry],
    order: Difficulty,
    run: Callable[[Jobs], list[Any]],
    columns: Sequence[str] = (),
) -> Overview:
    """Return what a report says in figures of at least one entry, all of one task.

    run: calls jobs, the longest first, and returns what they return. columns: keys of more measures.
    """
    pairs = list(itertools.combinations(entries, 2))[:MOST_PAIRS]
    keys = tuple(
        dict.fromkeys(
            (
                *with_motion(SCORED + DRIVEN, *(entry.results for entry in entries)),
                *columns,
            )
        )
    )
    compared = tuple(dict.fromkeys((*COMPARED, *columns)))
    jobs: list[Callable[[], Any]] = [
        partial(_compared, a, b, compared) for a, b in pairs
    ]
    jobs += [partial(summarise, entry.results, keys) for entry in entries]
    *found, in_bands = run([*jobs, partial(bands, entries, order)])
    summaries = tuple(found[len(pairs) :])
    comparisons = holm_adjusted([one for one in found if isinstance(one, Comparison)])
    told = None
    with suppress(BarnError):
        told = results_verdict({entry.label: entry.results for entry in entries})
    return Overview(
        summaries,
        order,
        tuple(in_bands),
        comparisons,
        tuple(one for one in found if isinstance(one, Refusal)),
        told,
        where(entries, in_bands) if told else {},
        why(comparisons),
    )


def where(entries: Sequence[Entry], bands: Sequence[Band]) -> dict[str, str]:
    """Return by the name of each band what its worlds say of all planners, by tests that share one correction (Holm).

    Nothing for one planner. Planners must have done the same task.
    """
    if len(entries) < 2 or not bands:
        return {}
    measure = metric_of(entries[0].results)
    found = {}
    for band in bands:
        inside = set(band.worlds)
        own = {
            entry.label: [one for one in entry.results if one.world in inside]
            for entry in entries
        }
        with suppress(ConfigError):  # no trial in it that all have
            found[band.name] = rank_results(own, measure)
    adjusted = iter(
        holm([one.differences[pair].p for one in found.values() for pair in one.p])
    )
    ranked = {
        name: replace(one, p={pair: next(adjusted) for pair in one.p})
        for name, one in found.items()
    }
    return {name: verdict(one, measure).short for name, one in ranked.items()}


def why(comparisons: Sequence[Comparison]) -> list[str]:
    """Return a sentence on each pair: in which measures they differ clearly, which not; many without any share one."""
    texts, alike = [], []
    for one in comparisons:
        clear, unclear = [], []
        for row in (row for row in one.rows if row.key in (one.metric, *_IN)):
            measure, pair = MEASURES[row.key], row.paired
            if row.p_holm <= ALPHA:
                means = f"{measure.number(pair.mean_a)} against {measure.number(pair.mean_b)}{measure.after}"
                clear.append(f"{row.measure} ({means})")
            else:
                unclear.append(row.measure)
        told = [f"differ clearly in {joined(clear)}"] if clear else []
        if unclear:
            told.append(
                ("not" if clear else "do not differ clearly")
                + f" in {joined(unclear, 'or')}"
            )
        texts.append(f"{one.a} and {one.b} {', '.join(told)}.")
        alike += [] if clear else texts[-1:]
    few = (
        comparisons if len(comparisons) <= _ALIKE else ()
    )  # labels of many settings say what differs
    changed = [
        f"{one.a} and {one.b}: {one.parameters}" for one in few if one.parameters
    ]
    if len(alike) <= _ALIKE:
        return texts + changed
    others = "The other" if len(texts) > len(alike) else "All"
    rest = f"{others} {len(alike)} pairs do not {alike[0].partition(' do not ')[2]}"
    return [*(text for text in texts if text not in alike), rest, *changed]


def tables(
    entries: Sequence[Entry], found: Overview, columns: Sequence[str] = ()
) -> list[TextTable]:
    """Return all tables, the headline first, which has the measures named by columns, where there are any."""
    labels, summaries = [entry.label for entry in entries], found.summaries
    metric = metric_of(entries[0].results)
    keys = [key for key in summaries[0].means if key not in SCORED]
    driven = [
        key
        for key in keys
        if any(math.isfinite(one[key].estimate) for one in summaries)
    ]
    made = [
        headline_table(labels, summaries, metric, columns),
        measures_table(labels, summaries, driven),
    ]
    if found.bands:
        made.append(bands_table(labels, found.bands))
    made += [
        comparison_table(one, f"paired_{index}")
        for index, one in enumerate(found.comparisons, 1)
    ]
    return [*made, outcomes_table(labels, summaries)]


def _compared(a: Entry, b: Entry, keys: Sequence[str]) -> Comparison | Refusal:
    try:
        found = compare(a.results, b.results, a.label, b.label, keys)
        return replace(
            found,
            parameters=changed_parameters(a.source, a.planner, b.source, b.planner),
        )
    except BarnError as error:
        return Refusal(a.label, b.label, str(error))


@dataclass(frozen=True)
class Repeat:
    """A command; the protocol as YAML where it is none of the suite's own; what the command cannot say."""

    command: str
    protocol_yaml: str = ""
    note: str = ""


def repeat(source: Source) -> Repeat:
    """Return how the results of a source are made again."""
    try:
        experiment = source.experiment
    except BarnError as error:
        return Repeat(
            "",
            note=f"this version of the suite does not read the configuration: {error}",
        )
    words = [
        "barn",
        "run",
        "--dataset",
        experiment.dataset,
        "--worlds",
        experiment.worlds,
    ]
    words += [
        "--repetitions",
        str(experiment.repetitions),
        "--seed",
        str(experiment.seed),
        "--mode",
        experiment.mode,
    ]
    names = [
        f"{one.name}:{one.preset}" if one.preset else one.name
        for one in experiment.planners
    ]
    words += ["--planners", ",".join(names), "--bags", experiment.bags]
    for one in experiment.planners:
        words += _settings(
            "--set",
            {f"{one.name}.{key}": value for key, value in one.overrides.items()},
        )
        words += (
            ["--planner-command", f"{one.name}={one.command}"] if one.command else []
        )
    protocol, notes = experiment.protocol, []
    own = PROTOCOLS.get(protocol.name) == protocol
    words += ["--protocol", protocol.name if own else "protocol.yaml"]
    if live := [one.name for one in experiment.planners if one.source]:
        notes.append(f"Given as Python objects, not by a command: {', '.join(live)}.")
    robot = None
    if name := source.robot:
        robot = ROBOTS.get(name)
        shipped = robot is not None and robot.chassis == source.chassis
        words += ["--robot", name if shipped else f"{name}.yaml"]
        if not shipped:
            robot = robot_of(experiment.simulator)
            notes.append(
                f"Robot {name} is from a file, which is not kept with results."
            )
    words += _settings(
        "--sim", _changed(experiment.simulator, simulator_config(protocol, None, robot))
    )
    words += [
        *_settings("--ros", _changed(experiment.ros, RosConfig())),
        "--out",
        "results",
    ]
    text = (
        ""
        if own
        else yaml.safe_dump({"schema_version": 1} | as_dict(protocol), sort_keys=False)
    )
    return Repeat(shlex.join(words), text, " ".join(notes))


def _changed(config: Checked, standard: Checked) -> dict[str, Any]:
    """Return the fields of a configuration that differ from the standard one, by dotted name."""
    known = {name: value for name, _, value in fields_of(standard)}
    return {name: value for name, _, value in fields_of(config) if known[name] != value}


def _settings(option: str, values: Mapping[str, Any]) -> list[str]:
    return [
        word
        for key, value in values.items()
        for word in (option, f"{key}={json.dumps(value)}")
    ]
