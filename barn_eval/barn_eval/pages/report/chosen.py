"""What a report's page needs to compute its figures and tables anew from the trials that its filters leave."""

from collections.abc import Sequence
from typing import Any

from barn_eval.analysis.difficulty import IN_BANDS
from barn_eval.analysis.measures import MEASURES, metric_of, safety_of
from barn_eval.analysis.overview import Overview
from barn_eval.analysis.planning import t_quantile
from barn_eval.analysis.sources import Entry
from barn_eval.analysis.summary import SCORED
from barn_eval.analysis.tables import band_name, headline_keys
from barn_eval.experiments.track import pack
from barn_eval.pages.report import drawing, figures
from barn_eval.trials.outcome import Outcome
from barn_metrics.bootstrap import LEVEL

_ALWAYS = ("success", "normalised_time_s_per_m", "contact_s")


def choice_data(entries: Sequence[Entry], found: Overview) -> dict[str, Any]:
    """Return the values of all trials by measure, in the order of the entries, and what is drawn and tabulated of them.

    quantiles: Student's, by degrees of freedom from one up, for as many worlds as there are.
    """
    results = [result for entry in entries for result in entry.results]
    places = {entry.label: place for place, entry in enumerate(entries)}
    metric = metric_of(results)
    tables = {
        "headline": headline_keys(metric),
        "measures": [key for key in found.summaries[0].means if key not in SCORED],
        "bands": list(IN_BANDS),
        "paired": [row.key for row in found.comparisons[0].rows] if found.comparisons else [],
    }
    drawn = (*_ALWAYS, safety_of(results).key, *figures.DISTRIBUTED, *figures.COMPUTE.values())
    keys = dict.fromkeys((*(key for keys in tables.values() for key in keys), *drawn))
    by_rank = not found.order.predicted_s_per_m
    return {
        "measures": {key: _described(key) for key in keys},
        "values": pack({key: MEASURES[key].values(results) for key in keys}),
        "tables": tables,
        "distributed": figures.DISTRIBUTED,
        "compute": figures.COMPUTE,
        "pairs": [[places[one.a], places[one.b]] for one in found.comparisons],
        "order": {
            "worlds": found.order.worlds,
            "places": list(range(1, len(found.order.worlds) + 1)) if by_rank else found.order.predicted_s_per_m,
            "title": figures.RANK if by_rank else figures.PREDICTED,
            "named": by_rank and len(found.order.worlds) <= figures.NAMED_WORLDS,
            "s_per_m": found.order.mean_s_per_m,
        },
        "bands": [{"name": band.name, "title": band_name(band), "worlds": band.worlds} for band in found.bands],
        "outcomes": {outcome.value: drawing.outcome_colour(outcome) for outcome in Outcome},
        "no_trial": drawing.NO_TRIAL,
        "quantiles": [
            t_quantile(0.5 + LEVEL / 2.0, freedom) for freedom in range(1, len({one.world for one in results}))
        ],
    }


def _described(key: str) -> dict[str, Any]:
    one = MEASURES[key]
    return {
        "title": one.title,
        "heading": one.heading,
        "unit": "%" if one.share else one.unit,
        "digits": one.digits,
        "factor": 100.0 if one.share else 1.0,
        "larger": one.better == "larger",
        "successes": one.successes_only,
    }
