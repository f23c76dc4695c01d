"""The bars that a report and a campaign's page begin with: each planner's estimate and its interval, best first."""

import math
from collections.abc import Sequence
from typing import Any

from barn_eval.analysis.measures import Measure, metric_of
from barn_eval.analysis.sources import Entry
from barn_eval.analysis.summary import Summary


def bars(entries: Sequence[Entry], summaries: Sequence[Summary]) -> list[dict[str, Any]]:
    """Return the bars, best first: label, colour, estimate in words, lengths in percent of the longest."""
    metric = metric_of(entries[0].results)
    shown = [metric.shown(one[metric.key]) for one in summaries]
    limits = [(one.estimate, _or(one.low, one.estimate), _or(one.high, one.estimate)) for one in shown]
    most = max((value for row in limits for value in row if math.isfinite(value)), default=0.0) or 1.0
    rows = []
    for place in sorted_by(metric, summaries):
        bar, low, high = (100.0 * max(value, 0.0) / most if math.isfinite(value) else 0.0 for value in limits[place])
        entry, text = entries[place], metric.text(summaries[place][metric.key])
        rows.append({"label": entry.label, "colour": entry.colour, "text": text, "bar": bar, "low": low, "high": high})
    return rows


def sorted_by(measure: Measure, summaries: Sequence[Summary]) -> list[int]:
    """Return the places of summaries from best to worst by a measure; what has no value comes last."""
    sign = -1.0 if measure.better == "larger" else 1.0
    values = [one[measure.key].estimate for one in summaries]
    return sorted(range(len(values)), key=lambda at: (values[at] != values[at], sign * values[at], at))


def _or(value: float | None, other: float) -> float:
    return other if value is None else value
