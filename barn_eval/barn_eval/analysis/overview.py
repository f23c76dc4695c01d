"""Compute the figures of a report, and the command that reproduces its results."""

import itertools
import json
import shlex
from collections.abc import Callable, Mapping, Sequence
from contextlib import suppress
from dataclasses import dataclass, replace
from functools import partial
from typing import Any

from barn_eval.analysis.compare import (
    Comparison,
    adjust_by_holm,
    compare_entries,
)
from barn_eval.analysis.difficulty import Band, WorldOrder, make_bands, rows_in_worlds
from barn_eval.analysis.entries import Entry
from barn_eval.analysis.measures import (
    COMPARED,
    DRIVEN,
    MEASURES,
    SCORED,
    SHOWN,
    ranking_measure,
    with_moving_measures,
)
from barn_eval.analysis.significance import ALPHA, holm
from barn_eval.analysis.sources import Source
from barn_eval.analysis.summary import Summary, finite_keys, summarize
from barn_eval.analysis.tables import (
    bands_table,
    comparison_table,
    headline_table,
    measures_table,
    outcomes_table,
)
from barn_eval.analysis.text_table import TextTable, join_names
from barn_eval.analysis.verdict import (
    Conclusion,
    conclude_ranking,
    conclude_results,
    rank_results,
)
from barn_eval.trials.protocol import PROTOCOLS
from barn_eval.trials.ros_config import RosConfig
from barn_eval.trials.spec import simulator_config
from barn_sim.config import robot_of
from barn_worlds.base.config import Checked, as_dict, fields_of
from barn_worlds.base.errors import BarnError, ConfigError
from barn_worlds.base.files import dump_yaml
from barn_worlds.robots.files import ROBOTS

Jobs = Sequence[Callable[[], Any]]

# All pairs of ten entries; nobody reads a table of more.
MAX_PAIRS = 45
# If more pairs than this have no significant difference, they share one sentence.
_MAX_NAMED_PAIRS = 3


@dataclass(frozen=True)
class Refusal:
    """Two entries that cannot be compared, and why."""

    a: str
    b: str
    why: str


@dataclass(frozen=True)
class Overview:
    """The figures of a report."""

    summaries: Sequence[Summary]
    """In the order of entries."""

    bands: Sequence[Band]
    comparisons: Sequence[Comparison]
    refusals: Sequence[Refusal]

    conclusion: Conclusion | None
    """By the ranking measure; None if `refusals` says why there is none."""

    where: Mapping[str, str]
    """By name of a band, a sentence on which planners differ in its worlds."""

    why: Sequence[str]
    """Sentences on the measures in which planners differ."""


def analyze(
    entries: Sequence[Entry],
    order: WorldOrder,
    run: Callable[[Jobs], list[Any]],
    keys: Sequence[str] = (),
) -> Overview:
    """Compute a report's figures in jobs that `run` calls; compare at most 45 pairs.

    Args:
        entries: Planners of one task, at least one.
        order: Their worlds from easy to difficult.
        run: Calls jobs, which have the longest first, and returns their results.
        keys: Keys of further measures.
    """
    # Comparisons take the longest, so they come first.
    pairs = list(itertools.combinations(entries, 2))[:MAX_PAIRS]
    groups = [entry.results for entry in entries]
    summary_keys = with_moving_measures(SCORED + DRIVEN, *groups)
    summary_keys = tuple(dict.fromkeys((*summary_keys, *keys)))
    compared_keys = tuple(dict.fromkeys((*COMPARED, *keys)))
    jobs: list[Callable[[], Any]] = [
        *(partial(_compare_entries, a, b, compared_keys) for a, b in pairs),
        *(partial(summarize, e.results, summary_keys, e.label) for e in entries),
        partial(make_bands, entries, order),
    ]
    *figures, bands = run(jobs)

    unadjusted = []
    refusals = []
    for figure in figures[: len(pairs)]:
        if isinstance(figure, Refusal):
            refusals.append(figure)
        else:
            unadjusted.append(figure)
    # The correction needs all pairs.
    comparisons = adjust_by_holm(unadjusted)
    conclusion = None
    # Without a conclusion, the refusals say why.
    with suppress(BarnError):
        results = {entry.label: entry.results for entry in entries}
        conclusion = conclude_results(results, comparisons)
    where = {}
    if conclusion:
        where = conclude_bands(entries, bands)
    return Overview(
        summaries=figures[len(pairs) :],
        bands=bands,
        comparisons=comparisons,
        refusals=refusals,
        conclusion=conclusion,
        where=where,
        why=explain_differences(comparisons),
    )


def conclude_bands(entries: Sequence[Entry], bands: Sequence[Band]) -> dict[str, str]:
    """Return by band a sentence on who leads, by Holm over all bands; {} for one planner.

    The tests of all bands share one correction (Holm).

    Args:
        entries: Planners of one task.
        bands: Bands of their worlds.

    Returns:
        A sentence by name of the band. Bands without common trials are left out; there
        are no sentences for a single planner.
    """
    if len(entries) < 2 or not bands:
        return {}
    measure = ranking_measure(entries[0].results)
    rankings = {}
    for band in bands:
        # Bands consist of worlds, not trials, so all planners have the same ones.
        results = {
            entry.label: rows_in_worlds(entry.results, band.worlds) for entry in entries
        }
        # A band may have no trial that all planners have.
        with suppress(ConfigError):
            rankings[band.name] = rank_results(results, measure)

    # One correction for all bands, because the more bands are tested, the more of them
    # differ by chance.
    p_values = []
    for ranking in rankings.values():
        p_values += [ranking.differences[pair].p for pair in ranking.p]
    adjusted = iter(holm(p_values))
    sentences = {}
    for name, ranking in rankings.items():
        p = {pair: next(adjusted) for pair in ranking.p}
        sentences[name] = conclude_ranking(replace(ranking, p=p), measure).short
    return sentences


def explain_differences(comparisons: Sequence[Comparison]) -> list[str]:
    """Return sentences on measures in which each pair differs or not, and on parameters.

    Many pairs without a significant difference share one sentence. Sentences on
    differing parameters follow, unless there are many pairs.
    """
    sentences = []
    different = []
    equal_claims = []
    for comparison in comparisons:
        claim, differs = _explain_difference(comparison)
        sentences.append(f"{comparison.a} and {comparison.b} {claim}.")
        if differs:
            different.append(sentences[-1])
        else:
            equal_claims.append(claim)

    parameters = []
    # Many pairs are settings, whose labels already say what differs.
    if len(comparisons) <= _MAX_NAMED_PAIRS:
        for comparison in comparisons:
            if comparison.parameters:
                names = f"{comparison.a} and {comparison.b}"
                parameters.append(f"{names}: {comparison.parameters}")
    if len(equal_claims) <= _MAX_NAMED_PAIRS:
        return sentences + parameters

    subject = "The other" if different else "All"
    summary = f"{subject} {len(equal_claims)} pairs {equal_claims[0]}."
    return [*different, summary, *parameters]


def _explain_difference(comparison: Comparison) -> tuple[str, bool]:
    """Return (predicate "differ clearly in ..." or "do not ...", whether they differ)."""
    clear = []
    unclear = []
    for row in comparison.rows:
        if row.key not in (comparison.metric, *SHOWN["sentences"]):
            continue
        if row.p_holm <= ALPHA:
            measure = MEASURES[row.key]
            mean_a = measure.number(row.paired.mean_a)
            mean_b = measure.number(row.paired.mean_b)
            clear.append(f"{row.measure} ({mean_a} against {mean_b}{measure.after})")
        else:
            unclear.append(row.measure)

    no_difference = f"in {join_names(unclear, 'or')}"
    claim = f"do not differ clearly {no_difference}"
    if clear:
        claim = f"differ clearly in {join_names(clear)}"
        if unclear:
            claim += f", not {no_difference}"
    return claim, bool(clear)


def make_tables(
    entries: Sequence[Entry], overview: Overview, keys: Sequence[str] = ()
) -> list[TextTable]:
    """Return a report's text tables: headline, measures, bands, pairs, outcomes.

    Args:
        entries: Planners of the report.
        overview: Its figures.
        keys: Keys of the measures of the headline. Default: rates, times and scores.
    """
    summaries = overview.summaries
    measure = ranking_measure(entries[0].results)
    other_keys = [key for key in summaries[0].means if key not in SCORED]
    tables = [
        headline_table(summaries, measure, keys),
        measures_table(summaries, finite_keys(summaries, other_keys)),
    ]
    if overview.bands:
        tables.append(bands_table(overview.bands))
    for number, comparison in enumerate(overview.comparisons, 1):
        tables.append(comparison_table(comparison, f"paired_{number}"))
    tables.append(outcomes_table(summaries))
    return tables


def _compare_entries(a: Entry, b: Entry, keys: Sequence[str]) -> Comparison | Refusal:
    """Return two entries' comparison and parameters, before Holm, or why there is none."""
    try:
        return compare_entries(a, b, keys)
    except BarnError as error:
        return Refusal(a.label, b.label, str(error))


@dataclass(frozen=True)
class Reproduction:
    """How to reproduce results; without a command, `note` says why not."""

    command: str

    protocol_yaml: str = ""
    """The protocol as YAML if it is not one of the suite's."""

    note: str = ""
    """What the command cannot express."""


def reproduce(source: Source) -> Reproduction:
    """Return command, protocol and notes that repeat a run, or a note on why not."""
    note = _why_not_reproduced(source)
    if note:
        return Reproduction("", note=note)

    run = source.run_config
    planners = []
    for planner in run.planners:
        text = planner.entry_text
        planners.append(f"{planner.name}={text}" if planner.entry else text)
    # The command names all that affects results; even defaults may change.
    words = ["barn", "run", "--dataset", run.dataset, "--worlds", run.worlds]
    words += ["--repetitions", str(run.repetitions), "--seed", str(run.seed)]
    words += ["--mode", run.mode, "--planners", ",".join(planners), "--bags", run.bags]
    notes = []
    for planner in run.planners:
        for key, value in planner.overrides.items():
            words += ["--set", f"{planner.name}.{key}={json.dumps(value)}"]
        if planner.command:
            words += ["--planner-command", f"{planner.name}={planner.command}"]

    # A user's protocol may have the name of one of the suite's.
    is_shipped_protocol = PROTOCOLS.get(run.protocol.name) == run.protocol
    protocol = run.protocol.name if is_shipped_protocol else "protocol.yaml"
    words += ["--protocol", protocol]
    objects = [planner.name for planner in run.planners if planner.source]
    if objects:
        names = ", ".join(objects)
        notes.append(f"These planners are Python objects, not commands: {names}.")

    robot = ROBOTS.get(source.robot)
    if source.robot:
        # The suite's robot of this name may have changed since.
        if robot is not None and robot.chassis == source.chassis:
            words += ["--robot", source.robot]
        else:
            words += ["--robot", f"{source.robot}.yaml"]
            robot = robot_of(run.simulator)
            notes.append(
                f"Robot {source.robot} is from a file that results do not keep."
            )

    # Compared with what this command would use by itself, not with class defaults.
    standard = simulator_config(run.protocol, None, robot)
    words += _option_words("--sim", run.simulator, standard)
    words += _option_words("--ros", run.ros, RosConfig())
    words += ["--out", "results"]
    protocol_yaml = ""
    if not is_shipped_protocol:
        content = {"schema_version": 1} | as_dict(run.protocol)
        protocol_yaml = dump_yaml(content)
    return Reproduction(shlex.join(words), protocol_yaml, " ".join(notes))


def _why_not_reproduced(source: Source) -> str:
    """Return why no command can repeat a folder's run, or "" if one can."""
    try:
        system = source.run_config.system
    except BarnError as error:
        return f"this version of the suite cannot read the configuration: {error}"
    if system.is_observed:
        return f"observed in {system.label}, not driven again"
    return ""


def _option_words(option: str, config: Checked, standard: Checked) -> list[str]:
    """Return [OPTION, NAME=JSON, ...] with each field that differs from `standard`."""
    standard_values = {name: value for name, _, value in fields_of(standard)}
    words = []
    for name, _, value in fields_of(config):
        if standard_values[name] != value:
            words += [option, f"{name}={json.dumps(value)}"]
    return words
