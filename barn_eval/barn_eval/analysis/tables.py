"""Tables of trials, planners, difficulty bands, comparisons, and tables for papers.

Names and digits of measures are those of the catalog.
"""

import re
from collections.abc import Mapping, Sequence

from barn_eval.analysis.compare import Comparison
from barn_eval.analysis.difficulty import Band
from barn_eval.analysis.measures import (
    MEASURES,
    SHOWN,
    Measure,
    ranking_measure,
    require_measures,
)
from barn_eval.analysis.planners import spelling
from barn_eval.analysis.significance import ALPHA
from barn_eval.analysis.summary import (
    Summary,
    common_trials,
    finite_keys,
    sort_positions,
    summarize,
)
from barn_eval.analysis.text_table import (
    TextTable,
    count_noun,
    latex_text,
)
from barn_eval.analysis.verdict import rank_results, warn_of_few_worlds
from barn_eval.trials.result import Rows, RowsByPlanner
from barn_metrics.bootstrap import Interval, number
from barn_worlds.base.errors import ConfigError

SPREAD = "spread over a world's trials [s/m]"
_LATEX_LABEL = re.compile(r"[\w:.-]+")


def trials_table(results: Rows, title: str) -> TextTable:
    """Return the figures of single trials, a trial per row.

    Args:
        results: Results of any planners.
        title: Title of the table.
    """
    measures = [MEASURES[key] for key in SHOWN["trials"]]
    rows = []
    for result in results:
        cells = [measure.number(measure.value(result)) for measure in measures]
        rows.append((result.trial_id, result.outcome.value, *cells))
    headings = [measure.trial_heading for measure in measures]
    columns = ("trial", "outcome", *headings)
    return TextTable("trials", title, columns, tuple(rows), texts=2)


def headline_table(
    labels: Sequence[str],
    summaries: Sequence[Summary],
    measure: Measure,
    keys: Sequence[str] = (),
) -> TextTable:
    """Return the main measures, a planner per row from best to worst.

    Args:
        labels: Name of each planner.
        summaries: Summary of each planner.
        measure: The ranking measure, which comes first.
        keys: Keys of the measures. By default rates, times and scores.
    """
    keys = keys or finite_keys(summaries, SHOWN["headline"])
    # The ranking measure comes first, wherever else it stands.
    all_keys = tuple(dict.fromkeys((measure.key, *keys)))

    rows = []
    for position in sort_positions(measure, summaries):
        summary = summaries[position]
        cells = [_mean_with_count(MEASURES[key], summary) for key in all_keys]
        extent = f"{summary.trials} in {summary.worlds}"
        rows.append((labels[position], extent, *cells, _spread_text(summary)))

    headings = [MEASURES[key].heading for key in all_keys]
    columns = ("planner", "trials in worlds", *headings, SPREAD)
    title = "Success, time and scores with 95 % intervals"
    return TextTable("headline", title, columns, tuple(rows))


def measures_table(
    labels: Sequence[str], summaries: Sequence[Summary], keys: Sequence[str]
) -> TextTable:
    """Return the means of measures, a planner per column.

    Args:
        labels: Name of each planner.
        summaries: Summary of each planner.
        keys: Keys of the measures, which all summaries have.
    """
    rows = []
    for key in keys:
        measure = MEASURES[key]
        cells = [measure.text(summary[key]) for summary in summaries]
        rows.append((measure.heading, *cells))
    title = "Measures: mean and 95 % interval"
    return TextTable("measures", title, ("measure", *labels), tuple(rows))


def summary_table(summaries: Sequence[Summary]) -> TextTable:
    """Return everything in summaries of the same measures, a planner per column."""
    labels = [spelling(summary.planner) for summary in summaries]
    rows = list(measures_table(labels, summaries, list(summaries[0].means)).rows)
    rows.append((SPREAD, *map(_spread_text, summaries)))

    planner_outcomes = []
    for label, summary in zip(labels, summaries, strict=True):
        counts = [f"{name} {count}" for name, count in summary.outcomes.items()]
        planner_outcomes.append(f"{label} {', '.join(counts)}")
    worlds = max(summary.worlds for summary in summaries)
    notes = [f"outcomes: {'; '.join(planner_outcomes)}", warn_of_few_worlds(worlds)]

    trials = count_noun(sum(summary.trials for summary in summaries), "trial")
    return TextTable(
        "summary",
        f"{trials} in {count_noun(worlds, 'world')}",
        ("mean and 95 % interval", *labels),
        tuple(rows),
        caption=". ".join(note for note in notes if note),
    )


def outcomes_table(labels: Sequence[str], summaries: Sequence[Summary]) -> TextTable:
    """Return how often each outcome occurred, a planner per row.

    Args:
        labels: Name of each planner.
        summaries: Summary of each planner.
    """
    outcomes: dict[str, int] = {}
    for summary in summaries:
        outcomes |= summary.outcomes
    rows = []
    for label, summary in zip(labels, summaries, strict=True):
        counts = [str(summary.outcomes.get(name, 0)) for name in outcomes]
        rows.append((label, *counts))
    columns = ("planner", *outcomes)
    return TextTable("outcomes", "Trials by outcome", columns, tuple(rows))


def bands_table(labels: Sequence[str], bands: Sequence[Band]) -> TextTable:
    """Return success and time of each planner in each difficulty band.

    Args:
        labels: Name of each planner.
        bands: Bands from easy to difficult.
    """
    rows = []
    for band in bands:
        low, high = band.limits_s_per_m
        worlds = count_noun(len(band.worlds), "world")
        name = f"{band.name} ({worlds}, {low:.2f} to {high:.2f} s/m)"
        for label, summary in zip(labels, band.summaries, strict=True):
            cells = [MEASURES[key].text(summary[key]) for key in SHOWN["bands"]]
            rows.append((name, label, str(summary.trials), *cells))

    headings = [MEASURES[key].heading for key in SHOWN["bands"]]
    columns = ("band", "planner", "trials", *headings)
    title = "Success and time by difficulty band, 95 % intervals"
    return TextTable("bands", title, columns, tuple(rows), texts=2)


def comparison_table(comparison: Comparison, name: str = "comparison") -> TextTable:
    """Return the comparison of two planners; a star marks a significant difference.

    Args:
        comparison: The comparison. With several pairs p-values are after Holm.
        name: Name of the table's files.
    """
    a = spelling(comparison.a)
    b = spelling(comparison.b)
    rows = []
    for row in comparison.rows:
        measure = MEASURES[row.key]
        paired = row.paired
        # A rounded p-value of 0.000 would read as certainty.
        p = "<0.001" if row.p_holm < 0.001 else number(row.p_holm, 3)
        if row.p_holm <= ALPHA:
            p += " *"
        rows.append(
            (
                measure.heading,
                measure.number(paired.mean_a),
                measure.number(paired.mean_b),
                measure.text(paired.difference),
                p,
                paired.improvement.text(),
                str(paired.trials),
            )
        )

    p_heading = "p"
    if comparison.pairs > 1:
        p_heading = f"p (Holm, {comparison.pairs} pairs)"
    columns = (
        "measure",
        a,
        b,
        "difference and 95 % interval",
        p_heading,
        f"P({a} is better)",
        "pairs of trials",
    )
    correlation = comparison.rank_correlation.text()
    notes = [
        warn_of_few_worlds(comparison.worlds),
        *comparison.notes,
        f"rank correlation of time per meter over worlds: {correlation}",
    ]
    return TextTable(
        name,
        f"{a} against {b}, {comparison.protocol} protocol, same worlds and seeds",
        columns,
        tuple(rows),
        caption=" ".join(note for note in notes if note),
    )


def _mean_with_count(measure: Measure, summary: Summary) -> str:
    """Return a mean with its limits, and its trials where failures are left out."""
    text = measure.text(summary[measure.key])
    if measure.successes_only:
        # Few successes make a fine time: the reader has to see how many there were.
        text += f" of {summary.outcomes.get('success', 0)}"
    return text


def _spread_text(summary: Summary) -> str:
    """Return the spread over a world's trials."""
    digits = MEASURES["normalised_time_s_per_m"].digits
    return number(summary.spread_s_per_m, digits)


def paper_table(
    results: RowsByPlanner,
    keys: Sequence[str] = (),
    *,
    caption: str = "",
    label: str = "tab:planners",
) -> str:
    """Return a LaTeX table, for the package booktabs, of planners on common trials.

    The best planner by each measure is bold, and so are those that are not
    significantly worse, as rankings judge it.

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
    if not _LATEX_LABEL.fullmatch(label):
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

    lines = [
        r"\begin{table}",
        r"\centering",
        rf"\caption{{{latex_text(caption or _default_caption(groups))}}}",
        rf"\label{{{label}}}",
        rf"\begin{{tabular}}{{l{'r' * len(measures)}}}",
        r"\toprule",
        " & ".join(["planner", *map(_latex_heading, measures)]) + r" \\",
        r"\midrule",
    ]
    for name, summary in summaries.items():
        cells = [
            _latex_cell(summary[measure.key], measure, name in bold[measure.key])
            for measure in measures
        ]
        # See `latex_row` for the braces; these cells are LaTeX already.
        lines.append("{}" + " & ".join([latex_text(name), *cells]) + r" \\")
    lines += [r"\bottomrule", r"\end{tabular}", r"\end{table}", ""]
    return "\n".join(lines)


def _find_best(
    groups: RowsByPlanner, summaries: Mapping[str, Summary], measure: Measure
) -> set[str]:
    """Return the best planner and those that are not significantly worse.

    There is none for a measure without a better direction, and for a single planner.
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
    return best


def _latex_cell(mean: Interval, measure: Measure, is_bold: bool) -> str:
    """Return a mean and, in small type, its limits."""
    estimate, _, limits = measure.text(mean).partition(" ")
    cell = latex_text(estimate)
    if is_bold:
        cell = rf"\textbf{{{cell}}}"
    if limits:
        cell += rf" {{\scriptsize {latex_text(limits)}}}"
    return cell


def _latex_heading(measure: Measure) -> str:
    """Return the heading of a measure with an arrow in its better direction."""
    arrows = {"larger": r" $\uparrow$", "smaller": r" $\downarrow$"}
    return latex_text(measure.heading) + arrows.get(measure.better, "")


def _default_caption(groups: RowsByPlanner) -> str:
    """Say what the means of a paper's table are over."""
    results = next(iter(groups.values()))
    worlds = len({result.world for result in results})
    # Unfinished runs have unequal worlds.
    if len(results) % worlds:
        trials = f"{len(results)} trials"
    else:
        trials = f"{count_noun(len(results) // worlds, 'trial')} each"
    text = (
        f"Means with 95 % intervals over {count_noun(worlds, 'world')} of "
        f"{results[0].dataset}, {trials}, protocol {results[0].protocol}."
    )
    if len(groups) > 1:
        text += (
            " Bold: the best, and those not clearly worse "
            "(test over worlds, 5 %, after Holm)."
        )
    return text
