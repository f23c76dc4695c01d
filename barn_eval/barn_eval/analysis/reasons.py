"""Where planners differ, by bands of difficulty, and in which measures: sentences that follow from tests."""

from collections.abc import Sequence
from contextlib import suppress
from dataclasses import replace

from barn_eval.analysis.compare import Comparison
from barn_eval.analysis.difficulty import Band
from barn_eval.analysis.measures import MEASURES, metric_of
from barn_eval.analysis.significance import ALPHA, holm
from barn_eval.analysis.sources import Entry
from barn_eval.analysis.text_table import joined
from barn_eval.analysis.verdict import rank_results, verdict
from barn_worlds.base.errors import ConfigError

_IN = ("success", "traversal_time_s", "min_clearance_m", "contact_s")


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
        own = {entry.label: [one for one in entry.results if one.world in inside] for entry in entries}
        with suppress(ConfigError):  # no trial in it that all have
            found[band.name] = rank_results(own, measure)
    adjusted = iter(holm([one.differences[pair].p for one in found.values() for pair in one.p]))
    ranked = {name: replace(one, p={pair: next(adjusted) for pair in one.p}) for name, one in found.items()}
    return {name: verdict(one, measure).short for name, one in ranked.items()}


def why(comparisons: Sequence[Comparison]) -> list[str]:
    """Return a sentence on each pair of planners: in which measures they differ clearly, and in which not."""
    texts = []
    for one in comparisons:
        keys = dict.fromkeys((one.metric, *_IN))
        rows = [row for row in one.rows if row.key in keys]
        clear = [row for row in rows if row.p_holm <= ALPHA]
        unclear = [row.measure for row in rows if row not in clear]
        parts = []
        for row in clear:
            measure, pair = MEASURES[row.key], row.paired
            unit = " %" if measure.percent else f" {measure.unit}".rstrip()
            parts.append(f"{row.measure} ({measure.number(pair.mean_a)} against {measure.number(pair.mean_b)}{unit})")
        told = [f"differ clearly in {joined(parts)}"] if clear else []
        if unclear:
            told.append(("not" if clear else "do not differ clearly") + f" in {joined(unclear, 'or')}")
        texts.append(f"{one.a} and {one.b} {', '.join(told)}.")
    return texts
