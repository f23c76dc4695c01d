"""Results as a table of a paper: planners in rows, measures in columns, in bold what cannot be told from the best."""

import re
from collections.abc import Mapping, Sequence

from barn_eval.analysis.measures import MEASURES, Measure, measures_named, metric_of
from barn_eval.analysis.summary import Summary, in_common, sorted_by, summarise
from barn_eval.analysis.text_table import counted, latex_text
from barn_eval.analysis.verdict import rank_results
from barn_eval.trials.result import TrialResult
from barn_metrics.bootstrap import Interval
from barn_worlds.base.errors import ConfigError

COLUMNS = ("success", "traversal_time_s", "min_clearance_m")
_LABEL = re.compile(r"[\w:.-]+")


def paper_table(
    results: Mapping[str, Sequence[TrialResult]],
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
        raise ConfigError(f"label: must have letters, digits, colons, dots and hyphens only, got {label!r}")
    first = next(iter(results.values()))
    measures = [MEASURES[key] for key in measures_named(columns or (metric_of(first).key, *COLUMNS))]
    groups = dict(zip(results, in_common(list(results.values())), strict=True))
    found = {name: summarise(group, [one.key for one in measures]) for name, group in groups.items()}
    bold = {measure.key: _best(groups, found, measure) for measure in measures}
    rows = []
    for name, one in found.items():
        cells = (_cell(one[measure.key], measure, name in bold[measure.key]) for measure in measures)
        rows.append(" & ".join([latex_text(name), *cells]))
    lines = [r"\begin{table}", r"\centering", rf"\caption{{{latex_text(caption) if caption else _caption(groups)}}}"]
    lines += [rf"\label{{{label}}}", rf"\begin{{tabular}}{{l{'r' * len(measures)}}}", r"\toprule"]
    lines += [" & ".join(["planner", *map(_heading, measures)]) + r" \\", r"\midrule"]
    # The braces keep a name that begins with a bracket or a star from being an option of the line's end before it.
    lines += [f"{{}}{row} \\\\" for row in rows]
    return "\n".join([*lines, r"\bottomrule", r"\end{tabular}", r"\end{table}", ""])


def _best(groups: Mapping[str, Sequence[TrialResult]], summaries: Mapping[str, Summary], measure: Measure) -> set[str]:
    """Return the names of the best and of those not clearly worse; none where no way is better, or for one planner."""
    if not measure.better or len(groups) < 2:
        return set()
    found, names = rank_results(groups, measure), list(summaries)
    best = names[sorted_by(measure, list(summaries.values()))[0]]
    at = found.names.index(best)
    return {name for place, name in enumerate(found.names) if place <= at or not found.clear(at, place)}


def _cell(found: Interval, measure: Measure, bold: bool) -> str:
    mean, _, limits = measure.text(found).partition(" ")
    shown = rf"\textbf{{{latex_text(mean)}}}" if bold else latex_text(mean)
    return rf"{shown} {{\scriptsize {latex_text(limits)}}}" if limits else shown


def _heading(measure: Measure) -> str:
    better = {"larger": r" $\uparrow$", "smaller": r" $\downarrow$"}.get(measure.better, "")
    return latex_text(measure.heading) + better


def _caption(groups: Mapping[str, Sequence[TrialResult]]) -> str:
    first = next(iter(groups.values()))
    worlds = {one.world for one in first}
    each = len(first) / len(worlds)
    trials = f"{counted(round(each), 'trial')} each" if each == round(each) else f"{len(first)} trials"
    text = f"Means with 95 % intervals over {counted(len(worlds), 'world')} of {first[0].dataset}, {trials}"
    text += f", protocol {first[0].protocol}."
    if len(groups) > 1:
        text += " Bold: the best, and those not clearly worse (test over worlds, 5 %, after Holm)."
    return latex_text(text)
