"""Summarize planners' rates and means with their uncertainty, and compare each pair."""

import math
from collections import Counter
from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass, replace
from itertools import combinations
from typing import Any, NamedTuple

import numpy as np

from barn_eval.analysis.compare import (
    Comparison,
    adjust_by_holm,
    compare,
    trial_places,
    trial_values,
)
from barn_eval.analysis.entries import Entry
from barn_eval.analysis.measures import (
    DRIVEN,
    MEASURES,
    SCORED,
    Measure,
    ranking_measure,
    with_moving_measures,
)
from barn_eval.analysis.planners import spelling
from barn_eval.analysis.significance import proportion
from barn_eval.analysis.sources import group_by_planner
from barn_eval.analysis.statistics import repetition_spread
from barn_eval.analysis.verdict import (
    Conclusion,
    Ranking,
    conclude_ranking,
    rank_results,
)
from barn_eval.results.row_table import column, take
from barn_eval.trials.result import Outcome, Rows
from barn_metrics.bootstrap import Interval
from barn_worlds.base.config import as_dict

_JSON_NAMES = {"success": "success_rate", "traversal_time_s": "success_time_s"}


@dataclass(frozen=True)
class Summary:
    """Figures of one planner's trials; intervals are of 95%."""

    planner: str

    label: str
    """Name of the planner in tables."""

    trials: int
    worlds: int

    outcomes: Mapping[str, int]
    """Number of trials by outcome."""

    means: Mapping[str, Interval]
    """Means by key of the measure."""

    spread_s_per_m: float
    """Standard deviation of the counted time per meter over a world's trials.

    It is averaged over worlds, as in the paper.
    """

    def __getitem__(self, key: str) -> Interval:
        """Return the mean of a measure by its key."""
        return self.means[key]

    def columns(self) -> dict[str, Any]:
        """Return a flat dict: trials, worlds, and mean and limits of each score."""
        row: dict[str, Any] = {"trials": self.trials, "worlds": self.worlds}
        for key in SCORED:
            row |= self[key].columns(key)
        return row

    def as_json(self) -> dict[str, Any]:
        """Return nested dicts and lists for JSON: planner, scores and other figures."""
        scores: dict[str, Any] = {
            "trials": self.trials,
            "worlds": self.worlds,
            "outcomes": dict(self.outcomes),
        }
        for key in SCORED:
            scores[_JSON_NAMES.get(key, key)] = as_dict(self[key])
        scores["spread_s_per_m"] = self.spread_s_per_m

        figures = []
        for key, mean in self.means.items():
            if key not in SCORED:
                measure = MEASURES[key]
                figures.append(
                    {
                        "key": key,
                        "name": measure.title,
                        "unit": measure.unit,
                        "value": as_dict(mean),
                    }
                )
        return {"planner": self.planner, "scores": scores, "figures": figures}


@dataclass(frozen=True)
class RunSummary:
    """Each planner of a run, and each pair on the worlds and seeds that both met."""

    planners: Sequence[Summary]
    comparisons: Sequence[Comparison]

    measure: Measure
    """Measure that ranks planners."""

    ranking: Ranking
    """Planners by label."""

    conclusion: Conclusion

    @property
    def verdict(self) -> str:
        """The conclusion about all planners in a sentence or two."""
        return str(self.conclusion)

    def as_json(self) -> dict[str, Any]:
        """Return nested dicts and lists for JSON: planners, comparisons, verdict."""
        return {
            "planners": [summary.as_json() for summary in self.planners],
            "comparisons": [as_dict(comparison) for comparison in self.comparisons],
            "verdict": self.verdict,
        }


def summarize(results: Rows, keys: Sequence[str] = SCORED, label: str = "") -> Summary:
    """Return a planner's counts, spread, and means of success and measures `keys`.

    Args:
        results: Results of the planner; there may be none.
        keys: Keys of measures. The success rate is always among the means.
        label: Name of the planner in tables. Default: its usual spelling.
    """
    worlds = column(results, "world").astype(np.int64)
    successes = column(results, "scores.success").astype(np.int64)
    # A share has its own kind of interval, which stays within 0 and 1.
    means = {"success": proportion(successes, worlds)}
    for key in keys:
        if key != "success":
            means[key] = trial_values(results, MEASURES[key]).mean()

    times = MEASURES["normalised_time_s_per_m"].values(results)
    planner = results[0].planner if results else ""
    return Summary(
        planner=planner,
        label=label or spelling(planner),
        trials=len(results),
        worlds=len(np.unique(worlds)),
        outcomes=count_outcomes(results),
        means=means,
        spread_s_per_m=repetition_spread(times, worlds),
    )


def count_outcomes(results: Rows) -> dict[str, int]:
    """Return the number of trials by outcome, in `Outcome` order, without zeros."""
    counts = Counter(column(results, "outcome").tolist())
    return {o.value: counts[o.value] for o in Outcome if counts[o.value]}


def summarize_run(results: Rows) -> RunSummary:
    """Return summaries, pairs' comparisons, ranking and conclusion of a run's results.

    There must be at least one result. Planners are in the order of first appearance.
    """
    groups = group_by_planner(results)
    keys = with_moving_measures(SCORED + DRIVEN, *groups.values())
    summaries = [summarize(rows, keys) for rows in groups.values()]

    pairs = combinations(groups, 2)
    comparisons = adjust_by_holm([compare(groups[a], groups[b]) for a, b in pairs])
    # The conclusion has display names, the comparisons have the planners' names.
    labeled_groups = {spelling(name): rows for name, rows in groups.items()}
    labeled_comparisons = [
        replace(comparison, a=spelling(comparison.a), b=spelling(comparison.b))
        for comparison in comparisons
    ]
    measure = ranking_measure(results)
    ranking = rank_results(labeled_groups, measure, labeled_comparisons)
    conclusion = conclude_ranking(ranking, measure)
    return RunSummary(summaries, comparisons, measure, ranking, conclusion)


class Bars(NamedTuple):
    """Bars of planners, best first, over the trials that all of them have."""

    rows: list[dict[str, Any]]
    """Label, color, estimate in words, and lengths in percent of the axis."""

    limit: str
    """The end of the axis."""

    worlds: int


def make_bars(entries: Sequence[Entry]) -> Bars:
    """Return bars by the ranking measure on common trials, the best planner first.

    The axis ends at the limit of the measure, or else at the longest bar.
    """
    measure = ranking_measure(entries[0].results)
    groups = common_trials([entry.results for entry in entries])
    summaries = [summarize(rows, (measure.key,)) for rows in groups]
    intervals = [measure.in_heading_unit(summary[measure.key]) for summary in summaries]
    # As numbers, None becomes NaN.
    limits = np.array([(i.estimate, i.low, i.high) for i in intervals], np.float64)
    # Missing limits are set to the estimate; a planner without a value has no bar.
    limits = np.where(np.isnan(limits), limits[:, :1], limits)
    limits = np.maximum(np.nan_to_num(limits), 0.0)
    end = measure.maximum or float(limits.max()) or 1.0
    if measure.percent:
        end = 100.0

    rows = []
    for position in sort_positions(measure, summaries):
        entry = entries[position]
        bar, low, high = (100.0 * limits[position] / end).tolist()
        rows.append(
            {
                "label": entry.label,
                "color": entry.color,
                "text": measure.text(summaries[position][measure.key]),
                "bar": bar,
                "low": low,
                "high": high,
            }
        )
    worlds = {result.world for result in groups[0]}
    return Bars(rows, f"{end:.3g}", len(worlds))


def common_trials(groups: Sequence[Rows]) -> list[Rows]:
    """Return planners' results in trials that all have; all results if there are none."""
    # Otherwise a planner with only easy worlds so far would seem to lead.
    group_places = list(map(trial_places, groups))
    shared = set.intersection(*map(set, group_places)) or set().union(*group_places)
    common = []
    for rows, trials in zip(groups, group_places, strict=True):
        places = [place for key, place in trials.items() if key in shared]
        common.append(take(rows, np.array(places, np.int64)))
    return common


def finite_keys(summaries: Sequence[Summary], keys: Iterable[str]) -> list[str]:
    """Return the keys of measures for which at least one summary has a finite mean.

    Args:
        summaries: Summaries that have all these measures.
        keys: Keys of measures. Rows of older versions lack some.
    """
    keys_with_mean = []
    for key in keys:
        if any(math.isfinite(summary[key].estimate) for summary in summaries):
            keys_with_mean.append(key)
    return keys_with_mean


def sort_positions(measure: Measure, summaries: Sequence[Summary]) -> list[int]:
    """Return the indices of summaries from best to worst, those without a value last.

    Args:
        measure: Measure to rank by.
        summaries: Summaries that have the measure.
    """
    sign = -1.0 if measure.better == "larger" else 1.0
    values = [summary[measure.key].estimate for summary in summaries]
    return sorted(
        range(len(values)),
        # Equal values are ordered by position.
        key=lambda k: (np.isnan(values[k]), sign * values[k], k),
    )
