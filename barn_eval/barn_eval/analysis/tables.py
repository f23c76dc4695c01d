"""Tables of trials, planners, bands of difficulty, comparisons and papers; names and digits are the catalogue's."""

import re
from collections.abc import Mapping, Sequence
from math import isfinite

from barn_eval.analysis.compare import Comparison
from barn_eval.analysis.difficulty import IN_BANDS, Band
from barn_eval.analysis.measures import MEASURES, Measure, measures_named, metric_of
from barn_eval.analysis.planners import spelling
from barn_eval.analysis.significance import ALPHA
from barn_eval.analysis.summary import Summary, in_common, sorted_by, summarise
from barn_eval.analysis.text_table import TextTable, counted, latex_text
from barn_eval.analysis.verdict import few_worlds, rank_results
from barn_eval.trials.result import Rows, RowsByPlanner
from barn_metrics.bootstrap import Interval, number
from barn_worlds.base.errors import ConfigError

SPREAD = "spread over a world's trials [s/m]"
_TRIAL = (
    "traversal_time_s",
    "normalised_time_s_per_m",
    "challenge",
    "min_clearance_m",
    "real_time_factor",
)
_HEADLINE = (
    "success",
    "efficiency",
    "traversal_time_s",
    "normalised_time_s_per_m",
    "challenge",
)


def trials_table(results: Rows, title: str) -> TextTable:
    """Return the figures of single trials, a trial per row."""
    measures = [MEASURES[key] for key in _TRIAL]
    rows = (
        (
            one.trial_id,
            one.outcome.value,
            *(by.number(by.value(one)) for by in measures),
        )
        for one in results
    )
    return TextTable(
        "trials",
        title,
        ("trial", "outcome", *(one.trial_heading for one in measures)),
        tuple(rows),
        2,
    )


def headline_table(
    labels: Sequence[str],
    summaries: Sequence[Summary],
    metric: Measure,
    columns: Sequence[str] = (),
) -> TextTable:
    """Return measures, a planner per row from best to worst by a metric, which comes first.

    columns: keys of the measures; rates, times and scores unless given.
    """
    known = (
        key
        for key in _HEADLINE
        if any(isfinite(one[key].estimate) for one in summaries)
    )  # not of older rows
    keys = tuple(dict.fromkeys((metric.key, *(columns or known))))
    rows = []
    for place in sorted_by(metric, summaries):
        one = summaries[place]
        cells = (_counted_text(MEASURES[key], one) for key in keys)
        rows.append(
            (labels[place], f"{one.trials} in {one.worlds}", *cells, _spread(one))
        )
    columns = (
        "planner",
        "trials in worlds",
        *(MEASURES[key].heading for key in keys),
        SPREAD,
    )
    return TextTable(
        "headline", "Success, time and scores with 95 % intervals", columns, tuple(rows)
    )


def measures_table(
    labels: Sequence[str], summaries: Sequence[Summary], keys: Sequence[str]
) -> TextTable:
    """Return the means of measures, a planner per column."""
    rows = [
        (MEASURES[key].heading, *(MEASURES[key].text(one[key]) for one in summaries))
        for key in keys
    ]
    return TextTable(
        "measures",
        "Measures: mean and 95 % interval",
        ("measure", *labels),
        tuple(rows),
    )


def summary_table(summaries: Sequence[Summary]) -> TextTable:
    """Return all that summaries of the same measures have, a planner per column."""
    labels = [spelling(one.planner) for one in summaries]
    rows = list(measures_table(labels, summaries, list(summaries[0].means)).rows)
    rows.append((SPREAD, *map(_spread, summaries)))
    trials = counted(sum(one.trials for one in summaries), "trial")
    worlds = counted(max(one.worlds for one in summaries), "world")
    outcomes = "; ".join(
        f"{label} "
        + ", ".join(f"{name} {count}" for name, count in one.outcomes.items())
        for label, one in zip(labels, summaries, strict=True)
    )
    columns = ("mean and 95 % interval", *labels)
    caption = ". ".join(
        filter(
            None,
            (f"outcomes: {outcomes}", few_worlds(max(one.worlds for one in summaries))),
        )
    )
    return TextTable(
        "summary", f"{trials} in {worlds}", columns, tuple(rows), caption=caption
    )


def outcomes_table(labels: Sequence[str], summaries: Sequence[Summary]) -> TextTable:
    """Return how often each outcome came, a planner per row."""
    names = list(dict.fromkeys(name for one in summaries for name in one.outcomes))
    counts = ((str(one.outcomes.get(name, 0)) for name in names) for one in summaries)
    rows = tuple((label, *own) for label, own in zip(labels, counts, strict=True))
    return TextTable("outcomes", "Trials by outcome", ("planner", *names), rows)


def bands_table(labels: Sequence[str], bands: Sequence[Band]) -> TextTable:
    """Return success and time of each planner in each band."""
    rows = []
    for band in bands:
        low, high = band.limits_s_per_m
        name = f"{band.name} ({counted(len(band.worlds), 'world')}, {low:.2f} to {high:.2f} s/m)"
        for label, one in zip(labels, band.summaries, strict=True):
            rows.append(
                (
                    name,
                    label,
                    str(one.trials),
                    *(MEASURES[key].text(one[key]) for key in IN_BANDS),
                )
            )
    columns = (
        "band",
        "planner",
        "trials",
        *(MEASURES[key].heading for key in IN_BANDS),
    )
    return TextTable(
        "bands",
        "Success and time by difficulty band, 95 % intervals",
        columns,
        tuple(rows),
        texts=2,
    )


def comparison_table(found: Comparison, name: str = "comparison") -> TextTable:
    """Return the comparison of two planners; * marks a difference that is clear, after Holm if there are more pairs."""
    a, b = spelling(found.a), spelling(found.b)
    rows = []
    for one in found.rows:
        measure, pair = MEASURES[one.key], one.paired
        figures = (
            measure.number(pair.mean_a),
            measure.number(pair.mean_b),
            measure.text(pair.difference),
        )
        p_text = ("<0.001" if one.p_holm < 0.001 else number(one.p_holm, 3)) + (
            " *" if one.p_holm <= ALPHA else ""
        )
        rows.append(
            (
                measure.heading,
                *figures,
                p_text,
                pair.improvement.text(),
                str(pair.trials),
            )
        )
    p = f"p (Holm, {found.pairs} pairs)" if found.pairs > 1 else "p"
    columns = (
        "measure",
        a,
        b,
        "difference and 95 % interval",
        p,
        f"P({a} is better)",
        "pairs of trials",
    )
    title = f"{a} against {b}, {found.protocol} protocol, same worlds and seeds"
    correlation = f"rank correlation of time per metre over worlds: {found.rank_correlation.text()}"
    caption = " ".join(
        filter(None, (few_worlds(found.worlds), *found.notes, correlation))
    )
    return TextTable(name, title, columns, tuple(rows), caption=caption)


def _counted_text(measure: Measure, summary: Summary) -> str:
    """Return an estimate with its limits and, where failed trials are left out, how many it is of."""
    of = f" of {summary.outcomes.get('success', 0)}" if measure.successes_only else ""
    return measure.text(summary[measure.key]) + of


def _spread(summary: Summary) -> str:
    return number(summary.spread_s_per_m, MEASURES["normalised_time_s_per_m"].digits)


COLUMNS = ("success", "traversal_time_s", "min_clearance_m")
_LABEL = re.compile(r"[\w:.-]+")


def paper_table(
    results: RowsByPlanner,
    columns: Sequence[str] = (),
    *,
    caption: str = "",
    label: str = "tab:planners",
) -> str:
    """Return a table in LaTeX, for the package booktabs, of planners on the worlds and seeds that all have.

    columns: keys of measures; without any, the metric of the protocol, then `COLUMNS`. Bold are the best by each
    measure and those that are not clearly worse, as rankings judge it. ConfigError for unknown measures and labels that
    LaTeX would not take, and where planners have not done the same task.
    """
    if not _LABEL.fullmatch(label):
        raise ConfigError(
            f"label: must have letters, digits, colons, dots and hyphens only, got {label!r}"
        )
    first = next(iter(results.values()))
    measures = [
        MEASURES[key]
        for key in measures_named(columns or (metric_of(first).key, *COLUMNS))
    ]
    groups = dict(zip(results, in_common(list(results.values())), strict=True))
    found = {
        name: summarise(group, [one.key for one in measures])
        for name, group in groups.items()
    }
    bold = {measure.key: _best(groups, found, measure) for measure in measures}
    rows = []
    for name, one in found.items():
        cells = (
            _cell(one[measure.key], measure, name in bold[measure.key])
            for measure in measures
        )
        rows.append(" & ".join([latex_text(name), *cells]))
    lines = [
        r"\begin{table}",
        r"\centering",
        rf"\caption{{{latex_text(caption) if caption else _caption(groups)}}}",
    ]
    lines += [
        rf"\label{{{label}}}",
        rf"\begin{{tabular}}{{l{'r' * len(measures)}}}",
        r"\toprule",
    ]
    lines += [" & ".join(["planner", *map(_heading, measures)]) + r" \\", r"\midrule"]
    # The braces keep a name that begins with a bracket or a star from being an option of the line's end before it.
    lines += [f"{{}}{row} \\\\" for row in rows]
    return "\n".join([*lines, r"\bottomrule", r"\end{tabular}", r"\end{table}", ""])


def _best(
    groups: RowsByPlanner, summaries: Mapping[str, Summary], measure: Measure
) -> set[str]:
    """Return the names of the best and of those not clearly worse; none where no way is better, or for one planner."""
    if not measure.better or len(groups) < 2:
        return set()
    found, names = rank_results(groups, measure), list(summaries)
    best = names[sorted_by(measure, list(summaries.values()))[0]]
    at = found.names.index(best)
    return {
        name
        for place, name in enumerate(found.names)
        if place <= at or not found.clear(at, place)
    }


def _cell(found: Interval, measure: Measure, bold: bool) -> str:
    mean, _, limits = measure.text(found).partition(" ")
    shown = rf"\textbf{{{latex_text(mean)}}}" if bold else latex_text(mean)
    return rf"{shown} {{\scriptsize {latex_text(limits)}}}" if limits else shown


def _heading(measure: Measure) -> str:
    better = {"larger": r" $\uparrow$", "smaller": r" $\downarrow$"}.get(
        measure.better, ""
    )
    return latex_text(measure.heading) + better


def _caption(groups: RowsByPlanner) -> str:
    first = next(iter(groups.values()))
    worlds = {one.world for one in first}
    each = len(first) / len(worlds)
    trials = (
        f"{counted(round(each), 'trial')} each"
        if each == round(each)
        else f"{len(first)} trials"
    )
    text = f"Means with 95 % intervals over {counted(len(worlds), 'world')} of {first[0].dataset}, {trials}"
    text += f", protocol {first[0].protocol}."
    if len(groups) > 1:
        text += " Bold: the best, and those not clearly worse (test over worlds, 5 %, after Holm)."
    return latex_text(text)
