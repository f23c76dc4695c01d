"""All figures of a report, computed once with barn_eval.analysis.statistics and shared by its tables and drawings."""

from __future__ import annotations

import itertools
from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any

import joblib

from barn_eval.analysis.campaign_summary import PlannerSummary, summarise_campaign
from barn_eval.analysis.compare import Comparison, compare
from barn_eval.analysis.difficulty import Band, Difficulty, bands, difficulty
from barn_eval.analysis.sources import Entry
from barn_eval.analysis.tables import Table, bands_table, comparison_table
from barn_eval.trials.result import TrialResult
from barn_metrics.bootstrap import number
from barn_worlds.errors import BarnError

MOST_PAIRS = 45  # of ten entries; more would be no table to read


@dataclass(frozen=True)
class Refusal:
    """Two entries that cannot be compared, and why."""

    a: str
    b: str
    why: str


@dataclass(frozen=True)
class Analysis:
    """What a report says in figures; summaries in the order of entries."""

    summaries: tuple[PlannerSummary, ...]
    order: Difficulty
    bands: tuple[Band, ...]
    comparisons: tuple[Comparison, ...]
    refusals: tuple[Refusal, ...]


def analyse(entries: Sequence[Entry], parallel: joblib.Parallel | None = None) -> Analysis:
    """Return the figures of at least one entry; bootstraps run on all processors where there are many trials."""
    pairs = list(itertools.combinations(entries, 2))[:MOST_PAIRS]
    jobs = [joblib.delayed(_summary)(entry.results) for entry in entries]
    jobs += [joblib.delayed(_compared)(a.label, a.results, b.label, b.results) for a, b in pairs]
    order = difficulty(entries)
    jobs.append(joblib.delayed(bands)(entries, order))
    runner = parallel or joblib.Parallel(n_jobs=1)
    done: list[Any] = list(runner(jobs))
    found = done[len(entries) : -1]
    return Analysis(
        tuple(done[: len(entries)]),
        order,
        tuple(done[-1]),
        tuple(one for one in found if isinstance(one, Comparison)),
        tuple(one for one in found if isinstance(one, Refusal)),
    )


def tables(entries: Sequence[Entry], found: Analysis) -> list[Table]:
    """Return all tables, the headline first."""
    made = [headline_table(entries, found), figures_table(entries, found)]
    if found.bands:
        made.append(bands_table(entries, found.bands))
    made += [comparison_table(one, f"paired_{index}") for index, one in enumerate(found.comparisons, 1)]
    return [*made, outcomes_table(entries, found)]


def headline_table(entries: Sequence[Entry], found: Analysis) -> Table:
    """Return rates, times and scores of each entry."""
    rows = []
    for entry, summary in zip(entries, found.summaries, strict=True):
        scores = summary.scores
        rows.append(
            (
                entry.label,
                f"{scores.trials} in {scores.worlds}",
                scores.success_rate.scaled(100.0).text(1),
                scores.success_time_s.text(),
                scores.normalised_time_s_per_m.text(),
                number(scores.spread_s_per_m),
                scores.challenge.text(3),
                scores.challenge_2022.text(3),
            )
        )
    columns = (
        "planner",
        "trials in worlds",
        "success [%]",
        "time of successes [s]",
        "time per metre as counted [s/m]",
        "spread over a world's trials [s/m]",
        "challenge metric (of 0.5)",
        "that of 2022 (of 0.25)",
    )
    return Table("headline", "Success, time and scores with 95 % intervals", columns, tuple(rows))


def figures_table(entries: Sequence[Entry], found: Analysis) -> Table:
    """Return what else is averaged over trials, an entry per column."""
    names = [f"{one.name} [{one.unit}]" if one.unit else one.name for one in found.summaries[0].figures]
    columns = [[one.value.text(3) for one in summary.figures] for summary in found.summaries]
    rows = tuple(zip(names, *columns, strict=True))
    return Table("measures", "Measures: mean and 95 % interval", ("measure", *(entry.label for entry in entries)), rows)


def outcomes_table(entries: Sequence[Entry], found: Analysis) -> Table:
    """Return how often each outcome came, an entry per row."""
    names = list(dict.fromkeys(name for summary in found.summaries for name in summary.scores.outcomes))
    rows = [
        (entry.label, *(str(summary.scores.outcomes.get(name, 0)) for name in names))
        for entry, summary in zip(entries, found.summaries, strict=True)
    ]
    return Table("outcomes", "Trials by outcome", ("planner", *names), tuple(rows))


def _summary(results: Sequence[TrialResult]) -> PlannerSummary:
    return summarise_campaign(results).planners[0]


def _compared(label_a: str, a: Sequence[TrialResult], label_b: str, b: Sequence[TrialResult]) -> Comparison | Refusal:
    try:
        return compare(a, b, label_a, label_b)
    except BarnError as error:
        return Refusal(label_a, label_b, str(error))
