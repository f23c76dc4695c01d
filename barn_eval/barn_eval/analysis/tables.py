"""Make text tables of trials, planners, difficulty bands and comparisons.

Names and digits of measures come from the catalog.
"""

from collections import Counter
from collections.abc import Sequence

from barn_eval.analysis.compare import Comparison
from barn_eval.analysis.difficulty import Band
from barn_eval.analysis.measures import MEASURES, SHOWN, Measure
from barn_eval.analysis.planners import spelling
from barn_eval.analysis.significance import ALPHA
from barn_eval.analysis.summary import RunSummary, Summary, finite_keys, sort_positions
from barn_eval.analysis.text_table import TextTable, count_noun, one_line
from barn_eval.analysis.verdict import warn_of_few_worlds
from barn_eval.results.row_table import column
from barn_eval.trials.result import Outcome, Rows
from barn_metrics.bootstrap import number

FEWEST_WORLDS = 6
"""With fewer worlds, no test can be significant, and tables have no intervals."""

MAX_RANKED = 20
"""Largest number of planners in a table of ranks."""

_MAX_DETAIL_CHARACTERS = 160

SPREAD = "spread over a world's trials [s/m]"


def trials_table(results: Rows, title: str) -> TextTable:
    """Return a text table of outcome and main figures, a trial per row.

    Args:
        results: Results of any planners.
        title: Title of the table.
    """
    headings = ["trial", "outcome"]
    cells = [column(results, "trial_id"), column(results, "outcome")]
    for key in SHOWN["trials"]:
        measure = MEASURES[key]
        headings.append(measure.trial_heading)
        cells.append(list(map(measure.number, measure.raw_values(results).tolist())))
    rows = list(zip(*cells, strict=True))
    return TextTable("trials", title, headings, rows, texts=2)


def ranked_table(run: RunSummary) -> TextTable:
    """Return a text table of rank and four main figures, a planner per row, best first.

    The figures are success, time, the ranking measure and clearance; intervals begin at
    six worlds. Planners that no test separates share a rank. Beyond `MAX_RANKED` planners, only the
    best are listed and the others are counted.

    Args:
        run: Planners of one run.
    """
    ranking = run.ranking
    summaries = {summary.label: summary for summary in run.planners}
    has_intervals = ranking.worlds >= FEWEST_WORLDS
    rows = []
    for rank, name in zip(ranking.ranks[:MAX_RANKED], ranking.names, strict=False):
        summary = summaries[name]
        cells = [str(rank), name]
        # Few digits, so that the table fits 80 columns.
        for measure, digits, may_have_interval in (
            (MEASURES["success"], 0, True),
            (MEASURES["traversal_time_s"], 1, False),
            (run.measure, run.measure.digits, True),
            (MEASURES["min_clearance_m"], 2, False),
        ):
            interval = measure.in_heading_unit(summary[measure.key])
            if has_intervals and may_have_interval:
                cells.append(interval.text(digits))
            else:
                cells.append(number(interval.estimate, digits))
        rows.append(cells)

    headings = ("rank", "planner", "success [%]", "time [s]", run.measure.heading)
    notes = []
    if has_intervals:
        notes.append("[low, high]: 95% interval")
    notes.append("time: mean of successes; clearance: mean of each trial's smallest")
    rest = len(ranking.names) - len(rows)
    if rest:
        notes.append(f"and {count_noun(rest, 'more planner')}")
    trials = count_noun(sum(summary.trials for summary in run.planners), "trial")
    title = f"{trials} in {count_noun(ranking.worlds, 'world')}"
    # Then the protocol's own metric has no meaning in these worlds.
    if run.measure.key == "efficiency":
        title += ", ranked by efficiency"
    return TextTable(
        "ranked",
        title,
        (*headings, "clearance [m]"),
        rows,
        texts=2,
        caption=". ".join(notes),
    )


def describe_failures(results: Rows) -> str:
    """Return lines: failures by planner and outcome, then examples; "" without failures.

    Timeouts and collisions need no example.

    Args:
        results: Results of any planners.
    """
    counts: dict[str, Counter[str]] = {}
    details: dict[str, str] = {}
    for result in results:
        if result.scores.success:
            continue
        outcome = result.outcome.value
        counts.setdefault(spelling(result.planner), Counter())[outcome] += 1
        # One detail per outcome is enough; these two need none.
        if result.outcome in (Outcome.TIMEOUT, Outcome.COLLISION):
            continue
        if result.detail and outcome not in details:
            details[outcome] = one_line(result.detail)[:_MAX_DETAIL_CHARACTERS]

    planners = []
    for planner, outcomes in counts.items():
        parts = [f"{count} {outcome}" for outcome, count in outcomes.most_common()]
        planners.append(f"{planner} {', '.join(parts)}")
    if not planners:
        return ""
    line = f"failures: {'; '.join(planners)}"
    for outcome, detail in details.items():
        line += f"\n  {outcome}, for example: {detail}"
    return line


def headline_table(
    summaries: Sequence[Summary], measure: Measure, keys: Sequence[str] = ()
) -> TextTable:
    """Return a text table of the main measures, a planner per row, best first.

    Args:
        summaries: Summary of each planner.
        measure: The ranking measure, which comes first.
        keys: Keys of the measures. Default: rates, times and scores.
    """
    keys = keys or finite_keys(summaries, SHOWN["headline"])
    measures = [MEASURES[key] for key in dict.fromkeys((measure.key, *keys))]

    rows = []
    for position in sort_positions(measure, summaries):
        summary = summaries[position]
        cells = [_mean_with_count(shown, summary) for shown in measures]
        extent = f"{summary.trials} in {summary.worlds}"
        rows.append((summary.label, extent, *cells, _spread_text(summary)))

    headings = [shown.heading for shown in measures]
    columns = ("planner", "trials in worlds", *headings, SPREAD)
    title = "Success, time and scores with 95% intervals"
    return TextTable("headline", title, columns, rows)


def measures_table(summaries: Sequence[Summary], keys: Sequence[str]) -> TextTable:
    """Return a text table of means, a measure per row and a planner per column.

    Args:
        summaries: Summary of each planner.
        keys: Keys of the measures, which all summaries have.
    """
    rows = []
    for key in keys:
        measure = MEASURES[key]
        cells = [measure.text(summary[key]) for summary in summaries]
        rows.append((measure.heading, *cells))
    labels = [summary.label for summary in summaries]
    title = "Measures: mean and 95% interval"
    return TextTable("measures", title, ("measure", *labels), rows)


def summary_table(summaries: Sequence[Summary]) -> TextTable:
    """Return a text table of means, spread and outcomes, a planner per column."""
    measures = measures_table(summaries, list(summaries[0].means))
    rows = (*measures.rows, (SPREAD, *map(_spread_text, summaries)))

    planner_outcomes = []
    for summary in summaries:
        counts = [f"{name} {count}" for name, count in summary.outcomes.items()]
        planner_outcomes.append(f"{summary.label} {', '.join(counts)}")
    worlds = max(summary.worlds for summary in summaries)
    notes = [f"outcomes: {'; '.join(planner_outcomes)}", warn_of_few_worlds(worlds)]

    trials = count_noun(sum(summary.trials for summary in summaries), "trial")
    return TextTable(
        "summary",
        f"{trials} in {count_noun(worlds, 'world')}",
        ("mean and 95% interval", *measures.columns[1:]),
        rows,
        caption=". ".join(filter(None, notes)),
    )


def outcomes_table(summaries: Sequence[Summary]) -> TextTable:
    """Return a text table of trials by outcome, a planner per row.

    Args:
        summaries: Summary of each planner.
    """
    # Only outcomes that occurred get a column.
    outcomes: dict[str, int] = {}
    for summary in summaries:
        outcomes |= summary.outcomes
    rows = []
    for summary in summaries:
        counts = [str(summary.outcomes.get(name, 0)) for name in outcomes]
        rows.append((summary.label, *counts))
    columns = ("planner", *outcomes)
    return TextTable("outcomes", "Trials by outcome", columns, rows)


def bands_table(bands: Sequence[Band]) -> TextTable:
    """Return a text table of success and time, a row per band and planner.

    Args:
        bands: Bands from easy to difficult.
    """
    measures = [MEASURES[key] for key in SHOWN["bands"]]
    rows = []
    for band in bands:
        low, high = band.limits_s_per_m
        worlds = count_noun(len(band.worlds), "world")
        name = f"{band.name} ({worlds}, {low:.2f} to {high:.2f} s/m)"
        for summary in band.summaries:
            cells = [measure.text(summary[measure.key]) for measure in measures]
            rows.append((name, summary.label, str(summary.trials), *cells))

    headings = [measure.heading for measure in measures]
    columns = ("band", "planner", "trials", *headings)
    title = "Success and time by difficulty band, 95% intervals"
    return TextTable("bands", title, columns, rows, texts=2)


def comparison_table(comparison: Comparison, name: str = "comparison") -> TextTable:
    """Return a text table that compares A and B, a measure per row; * is significant.

    Args:
        comparison: The comparison. With several pairs, p-values are adjusted by Holm.
        name: Name of the table's files.
    """
    a = spelling(comparison.a)
    b = spelling(comparison.b)
    rows = []
    for row in comparison.rows:
        measure = MEASURES[row.key]
        paired = row.paired
        # A rounded p-value of 0.000 would look like certainty.
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
        "difference and 95% interval",
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
        rows,
        caption=" ".join(filter(None, notes)),
    )


def _mean_with_count(measure: Measure, summary: Summary) -> str:
    """Return "mean [low, high]", plus the number of successes if only these count."""
    text = measure.text(summary[measure.key])
    if measure.successes_only:
        # Readers must see if a good time rests on few successes.
        text += f" of {summary.outcomes.get('success', 0)}"
    return text


def _spread_text(summary: Summary) -> str:
    """Return the mean spread over a world's trials [s/m] as text without the unit."""
    digits = MEASURES["normalised_time_s_per_m"].digits
    return number(summary.spread_s_per_m, digits)
