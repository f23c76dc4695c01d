"""What results say together: rates and means of each planner with their uncertainty, and each pair of planners."""

from collections import Counter
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from itertools import combinations
from typing import Any, NamedTuple

import numpy as np

from barn_eval.analysis.compare import Comparison, columns, compare, holm_adjusted
from barn_eval.analysis.measures import (
    DRIVEN,
    MEASURES,
    SCORED,
    Measure,
    metric_of,
    with_motion,
)
from barn_eval.analysis.planners import spelling
from barn_eval.analysis.significance import proportion
from barn_eval.analysis.sources import Entry, by_planner
from barn_eval.analysis.statistics import repetition_spread
from barn_eval.analysis.verdict import results_verdict
from barn_eval.trials.outcome import Outcome
from barn_eval.trials.result import Rows, TrialResult
from barn_metrics.bootstrap import Interval
from barn_worlds.base.config import as_dict

_JSON_NAMES = {"success": "success_rate", "traversal_time_s": "success_time_s"}


@dataclass(frozen=True)
class Summary:
    """Figures of one planner's trials; intervals are of 95 %.

    means: by key of a measure. spread_s_per_m: standard deviation of the counted time per metre over a world's trials,
    averaged over worlds, as the paper gives it.
    """

    planner: str
    trials: int
    worlds: int
    outcomes: Mapping[str, int]
    means: Mapping[str, Interval]
    spread_s_per_m: float

    def __getitem__(self, key: str) -> Interval:
        """Return the mean of a measure, named by its key."""
        return self.means[key]

    def columns(self) -> dict[str, Any]:
        """Return what is scored as a row of a table."""
        means = {
            name: value
            for key in SCORED
            for name, value in self[key].columns(key).items()
        }
        return {"trials": self.trials, "worlds": self.worlds} | means

    def as_json(self) -> dict[str, Any]:
        """Return the summary as plain data."""
        counts = {
            "trials": self.trials,
            "worlds": self.worlds,
            "outcomes": dict(self.outcomes),
        }
        means = {_JSON_NAMES.get(key, key): as_dict(self[key]) for key in SCORED}
        figures = [
            {
                "key": key,
                "name": MEASURES[key].title,
                "unit": MEASURES[key].unit,
                "value": as_dict(value),
            }
            for key, value in self.means.items()
            if key not in SCORED
        ]
        scores = counts | means | {"spread_s_per_m": self.spread_s_per_m}
        return {"planner": self.planner, "scores": scores, "figures": figures}


@dataclass(frozen=True)
class CampaignSummary:
    """What a campaign says: of each planner, and of each pair on the worlds and seeds that both met.

    verdict: what it says of all of them, in a sentence or two.
    """

    planners: tuple[Summary, ...]
    comparisons: tuple[Comparison, ...]
    verdict: str

    def as_json(self) -> dict[str, Any]:
        """Return the summary as plain data."""
        planners = [one.as_json() for one in self.planners]
        return {
            "planners": planners,
            "comparisons": list(map(as_dict, self.comparisons)),
            "verdict": self.verdict,
        }


def summarise(results: Rows, keys: Sequence[str] = SCORED) -> Summary:
    """Return the figures of one planner's results: the rates and means of the measures named by keys."""
    worlds = np.array([result.world for result in results], np.int64)
    outcomes = Counter(result.outcome for result in results)
    succeeded = np.array([result.scores.success for result in results], np.int64)
    means = {
        key: columns(results, MEASURES[key]).mean() for key in keys if key != "success"
    }
    return Summary(
        planner=results[0].planner if results else "",
        trials=len(results),
        worlds=len(np.unique(worlds)),
        outcomes={
            outcome.value: outcomes[outcome] for outcome in Outcome if outcomes[outcome]
        },
        means={"success": proportion(succeeded, worlds)} | means,
        spread_s_per_m=repetition_spread(
            MEASURES["normalised_time_s_per_m"].values(results), worlds
        ),
    )


def summarise_campaign(results: Rows) -> CampaignSummary:
    """Return the summary of at least one result; planners in the order in which they come."""
    groups = by_planner(results)
    keys = with_motion(SCORED + DRIVEN, *groups.values())
    return CampaignSummary(
        tuple(summarise(group, keys) for group in groups.values()),
        holm_adjusted(
            [compare(groups[a], groups[b]) for a, b in combinations(groups, 2)]
        ),
        str(results_verdict({spelling(name): group for name, group in groups.items()})),
    )


class Bars(NamedTuple):
    """Bars of planners, best first, over the trials that all of them have.

    rows: label, colour, estimate in words, and lengths in percent of the axis. limit: its end. worlds: how many.
    """

    rows: list[dict[str, Any]]
    limit: str
    worlds: int


def bars(entries: Sequence[Entry]) -> Bars:
    """Return bars of the metric. The axis ends at its limit where it has one, else at the longest."""
    metric = metric_of(entries[0].results)
    groups = in_common([entry.results for entry in entries])
    summaries = [summarise(group, (metric.key,)) for group in groups]
    shown = [metric.shown(one[metric.key]) for one in summaries]
    limits = np.array([(one.estimate, one.low, one.high) for one in shown], np.float64)
    limits = np.maximum(
        np.nan_to_num(np.where(np.isnan(limits), limits[:, :1], limits)), 0.0
    )
    most = 100.0 if metric.percent else metric.maximum or float(limits.max()) or 1.0
    rows = []
    for place in sorted_by(metric, summaries):
        entry, text = entries[place], metric.text(summaries[place][metric.key])
        lengths = zip(
            ("bar", "low", "high"), (100.0 * limits[place] / most).tolist(), strict=True
        )
        rows.append(
            {
                "label": entry.label,
                "colour": entry.colour,
                "text": text,
                **dict(lengths),
            }
        )
    return Bars(rows, f"{most:.3g}", len({one.world for one in groups[0]}))


def in_common(groups: Sequence[Rows]) -> list[list[TrialResult]]:
    """Return of each planner's results those of worlds and repetitions that all have; all where there are none."""
    keys = [{(one.world, one.repetition) for one in group} for group in groups]
    shared = set.intersection(*keys) or set.union(*keys)
    return [
        [one for one in group if (one.world, one.repetition) in shared]
        for group in groups
    ]


def sorted_by(measure: Measure, summaries: Sequence[Summary]) -> list[int]:
    """Return the places of summaries from best to worst by a measure; what has no value comes last."""
    sign = -1.0 if measure.better == "larger" else 1.0
    values = [one[measure.key].estimate for one in summaries]
    return sorted(
        range(len(values)),
        key=lambda at: (values[at] != values[at], sign * values[at], at),
    )
