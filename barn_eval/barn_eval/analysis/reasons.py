"""Where and why one planner does better than the next: bars, and a sentence each, from the figures of a report."""

import math
from collections.abc import Sequence
from typing import Any

from barn_eval.analysis.difficulty import Band
from barn_eval.analysis.measures import MEASURES, Measure, metric_of
from barn_eval.analysis.sources import Entry
from barn_eval.analysis.summary import Summary
from barn_eval.analysis.text_table import joined
from barn_metrics.bootstrap import number

_SUCCESS, _TIME, _CONTACT = (MEASURES[key] for key in ("success", "traversal_time_s", "contact_s"))


def sorted_by(measure: Measure, summaries: Sequence[Summary]) -> list[int]:
    """Return the places of summaries from best to worst by a measure; what has no value comes last."""
    sign = -1.0 if measure.better == "larger" else 1.0
    values = [one[measure.key].estimate for one in summaries]
    return sorted(range(len(values)), key=lambda at: (values[at] != values[at], sign * values[at], at))


def reasons(
    entries: Sequence[Entry], summaries: Sequence[Summary], bands: Sequence[Band], measure: Measure
) -> tuple[str, ...]:
    """Return where the first by a measure does better or worse than the second, and how both succeed and fail."""
    places = sorted_by(measure, summaries)[:2]
    names = [entries[place].label for place in places]
    texts = [_why(names, [summaries[place] for place in places])]
    if len(places) == 2 and bands:
        texts.insert(0, _where(names, places, bands, measure))
    return tuple(texts)


def _where(names: Sequence[str], places: Sequence[int], bands: Sequence[Band], measure: Measure) -> str:
    pairs = [[measure.shown(band.summaries[place][measure.key]).estimate for place in places] for band in bands]
    sign = 1.0 if measure.better == "larger" else -1.0
    unit = " %" if measure.percent else f" {measure.unit}".rstrip()
    values = [
        f"{number(a, measure.digits)}{unit} against {number(b, measure.digits)}{unit} in {_named(band)}"
        for band, (a, b) in zip(bands, pairs, strict=True)
    ]
    ahead = [_named(band) for band, (a, b) in zip(bands, pairs, strict=True) if sign * (a - b) > 0.0]
    in_bands = "all bands of difficulty" if len(ahead) == len(bands) else joined(ahead) or "no band"
    return f"Where: {names[0]} has the better {measure.title} in {in_bands}: {', '.join(values)}."


def _named(band: Band) -> str:
    return f"the {band.name} worlds" if band.name in ("easiest", "hardest") else f"band {band.name}"


def _why(names: Sequence[str], summaries: Sequence[Summary]) -> str:
    parts = []
    for name, one in zip(names, summaries, strict=True):
        failures = [f"{key.replace('_', ' ')} {count}" for key, count in one.outcomes.items() if key != "success"]
        ended = f", failures: {', '.join(failures)}" if failures else ", no failures"
        good = one.outcomes.get("success", 0)
        time = f", in {_TIME.number(one[_TIME.key].estimate)} s on average of {good}" if good else ""
        contact = f", {_CONTACT.number(one[_CONTACT.key].estimate)} s in contact" if _CONTACT.key in one.means else ""
        parts.append(f"{name} succeeds in {_SUCCESS.number(one['success'].estimate)} % of trials{time}{contact}{ended}")
    return f"Why: {'; '.join(parts)}."


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


def _or(value: float | None, other: float) -> float:
    return other if value is None else value
