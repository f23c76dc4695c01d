"""All that a report says in figures, computed once and shared by its tables and drawings."""

import itertools
from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any

import joblib

from barn_eval.analysis.compare import Comparison, compare, together
from barn_eval.analysis.difficulty import Band, Difficulty, bands, difficulty
from barn_eval.analysis.sources import Entry
from barn_eval.analysis.summary import DRIVEN, SCORED, Summary, summarise
from barn_eval.analysis.tables import bands_table, comparison_table, headline_table, measures_table, outcomes_table
from barn_eval.analysis.text_table import TextTable
from barn_eval.analysis.verdict import standing
from barn_eval.trials.result import TrialResult
from barn_worlds.errors import BarnError

MOST_PAIRS = 45  # of ten entries; more would be no table to read


@dataclass(frozen=True)
class Refusal:
    """Two entries that cannot be compared, and why."""

    a: str
    b: str
    why: str


@dataclass(frozen=True)
class Overview:
    """What a report says in figures; summaries in the order of entries. verdicts: the same in a sentence or two."""

    summaries: tuple[Summary, ...]
    order: Difficulty
    bands: tuple[Band, ...]
    comparisons: tuple[Comparison, ...]
    refusals: tuple[Refusal, ...]
    verdicts: tuple[str, ...]


def analyse(entries: Sequence[Entry], parallel: joblib.Parallel | None = None) -> Overview:
    """Return the figures of at least one entry; bootstraps run on all processors where there are many trials."""
    pairs = list(itertools.combinations(entries, 2))[:MOST_PAIRS]
    jobs = [joblib.delayed(summarise)(entry.results, SCORED + DRIVEN) for entry in entries]
    jobs += [joblib.delayed(_compared)(a.label, a.results, b.label, b.results) for a, b in pairs]
    order = difficulty(entries)
    jobs.append(joblib.delayed(bands)(entries, order))
    runner = parallel or joblib.Parallel(n_jobs=1)
    by_protocol: dict[str, list[Entry]] = {}
    for entry in entries:
        by_protocol.setdefault(entry.results[0].protocol, []).append(entry)
    done: list[Any] = list(runner(jobs))
    found = done[len(entries) : -1]
    return Overview(
        tuple(done[: len(entries)]),
        order,
        tuple(done[-1]),
        together([one for one in found if isinstance(one, Comparison)]),
        tuple(one for one in found if isinstance(one, Refusal)),
        tuple(filter(None, map(_verdict, by_protocol.values()))),
    )


def _verdict(entries: Sequence[Entry]) -> str:
    """Return what planners of one protocol say by its metric; an empty text where `refusals` says why they do not."""
    try:
        return standing({entry.label: entry.results for entry in entries})
    except BarnError:
        return ""


def tables(entries: Sequence[Entry], found: Overview) -> list[TextTable]:
    """Return all tables, the headline first."""
    labels, summaries = [entry.label for entry in entries], found.summaries
    made = [headline_table(labels, summaries), measures_table(labels, summaries, DRIVEN)]
    if found.bands:
        made.append(bands_table(labels, found.bands))
    made += [comparison_table(one, f"paired_{index}") for index, one in enumerate(found.comparisons, 1)]
    return [*made, outcomes_table(labels, summaries)]


def _compared(label_a: str, a: Sequence[TrialResult], label_b: str, b: Sequence[TrialResult]) -> Comparison | Refusal:
    try:
        return compare(a, b, label_a, label_b)
    except BarnError as error:
        return Refusal(label_a, label_b, str(error))
