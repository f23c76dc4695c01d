"""Tables in LaTeX, for the package booktabs."""

import re
from collections.abc import Mapping, Sequence

from barn_eval.analysis.measures import (
    MEASURES,
    SHOWN,
    Measure,
    ranking_measure,
    require_measures,
)
from barn_eval.analysis.summary import Summary, common_trials, sort_positions, summarize
from barn_eval.analysis.text_table import TextTable, count_noun
from barn_eval.analysis.verdict import rank_results
from barn_eval.pages.template import render
from barn_eval.trials.result import RowsByPlanner
from barn_worlds.base.errors import ConfigError

_LABEL = re.compile(r"[\w:.-]+")
# The better direction of a measure.
_ARROWS = {"larger": r" $\uparrow$", "smaller": r" $\downarrow$"}


def latex_table(table: TextTable) -> str:
    """Return a table of results as the text of a LaTeX tabular for booktabs."""
    return render("table.tex", table=table)


def paper_table(
    results: RowsByPlanner,
    keys: Sequence[str] = (),
    *,
    caption: str = "",
    label: str = "tab:planners",
) -> str:
    """Return a LaTeX table over common trials, the best bold; ConfigError if tasks differ.

    The best planner by each measure is bold, and so are those that are not
    significantly worse, as rankings judge it; none is where no planner is.

    Args:
        results: Results by planner.
        keys: Keys of measures. By default the ranking measure of the protocol, then
            those that `SHOWN` has for papers.
        caption: Caption of the table. By default what the means are over.
        label: Label by which LaTeX refers to the table.

    Raises:
        ConfigError: A measure is unknown, LaTeX would not accept the label, or planners
            have not done the same task.
    """
    if not _LABEL.fullmatch(label):
        raise ConfigError(
            "label: must have letters, digits, colons, dots and hyphens only, "
            f"got {label!r}"
        )
    first = next(iter(results.values()))
    default_keys = (ranking_measure(first).key, *SHOWN["paper"])
    measures = [MEASURES[key] for key in require_measures(keys or default_keys)]
    measure_keys = [measure.key for measure in measures]
    # On other trials a planner might only have met easier worlds.
    common = common_trials(list(results.values()))
    groups = dict(zip(results, common, strict=True))
    summaries = {name: summarize(rows, measure_keys) for name, rows in groups.items()}
    bold = {m.key: _find_best(groups, summaries, m) for m in measures}

    return render(
        "paper.tex",
        caption=caption or _default_caption(groups),
        label=label,
        measures=measures,
        summaries=summaries,
        bold=bold,
        arrows=_ARROWS,
    )


def _find_best(
    groups: RowsByPlanner, summaries: Mapping[str, Summary], measure: Measure
) -> set[str]:
    """Return the planners not clearly worse than the best; empty if all are or for one.

    A measure without a better direction has none.
    """
    if not measure.better or len(groups) < 2:
        return set()
    ranking = rank_results(groups, measure)
    # By the mean that the table shows; a ranking leaves out trials without a value.
    best_position = sort_positions(measure, list(summaries.values()))[0]
    best_place = ranking.names.index(list(summaries)[best_position])
    best = set()
    for place, name in enumerate(ranking.names):
        # Planners ahead in the ranking's trials are no worse than the best by the mean.
        if place <= best_place or not ranking.is_clear(best_place, place):
            best.add(name)
    # Where no planner is clearly worse, bold would make a difference that is none.
    return set() if len(best) == len(groups) else best


def _default_caption(groups: RowsByPlanner) -> str:
    """Return a caption: data set, protocol, number of worlds, trials per world."""
    results = next(iter(groups.values()))
    worlds = len({result.world for result in results})
    # Unfinished runs have unequal worlds.
    if len(results) % worlds:
        trials = f"{len(results)} trials"
    else:
        trials = f"{count_noun(len(results) // worlds, 'trial')} each"
    text = (
        f"Means with 95% intervals over {count_noun(worlds, 'world')} of "
        f"{results[0].dataset}, {trials}, protocol {results[0].protocol}."
    )
    if len(groups) > 1:
        text += (
            " Bold: the best, and those not clearly worse "
            "(test over worlds, 5%, after Holm)."
        )
    return text
