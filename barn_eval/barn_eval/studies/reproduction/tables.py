"""Tables of the page: ours beside the published numbers, and verdicts that follow from intervals."""

from __future__ import annotations

import math
from collections.abc import Callable, Iterator

from barn_eval.analysis.planner_style import spelling
from barn_eval.pages.markdown import markdown_table
from barn_eval.studies.reproduction import paper
from barn_eval.studies.reproduction.findings import Findings
from barn_eval.studies.reproduction.model import SHIPPED, TITLES, RecipeFinding
from barn_eval.studies.reproduction.new_worlds import Regression
from barn_eval.studies.reproduction.table_ii import MetricRow
from barn_eval.studies.reproduction.trials import PlannerFinding
from barn_eval.trials.outcome import Outcome
from barn_metrics.bootstrap import Interval, number
from barn_metrics.paper import TABLE_II

HOLDS, FAILS, OPEN = "holds", "does not hold", "not decided"
SURE = 1.96  # standard errors of a 95 % interval
_LEAST_LOSS = 0.005  # (s/m)^2, below it a loss is shown as 0.00 and a ratio to it says nothing
_OURS = ("published", "ours", "difference", "within ours")

Row = tuple[str, ...]


def above(interval: Interval, value: float = 0.0) -> str:
    """Return the verdict on whether a figure is above a value."""
    if interval.low is None or interval.high is None:
        return OPEN
    return HOLDS if interval.low > value else FAILS if interval.high < value else OPEN


def below(interval: Interval, value: float = 0.0) -> str:
    """Return the verdict on whether a figure is below a value."""
    return {HOLDS: FAILS, FAILS: HOLDS, OPEN: OPEN}[above(interval, value)]


def contains(interval: Interval, value: float) -> str:
    """Return whether a value lies within an interval, yes or no."""
    return "yes" if interval.low is not None and above(interval, value) == OPEN else "no"


def distances_table(findings: Findings) -> str:
    """Return by how many standard errors the metrics of our worlds are off those of Table II."""
    columns = ("metric", "mean off by", "verdict", "std. off by", "ours / published", "verdict")
    return markdown_table(columns, [_distances(row, findings.metrics.worlds) for row in findings.metrics.rows])


def _distances(row: MetricRow, worlds: int) -> Row:
    """Return a row; the standard error of our std. is that of its interval, and that of the published one as large."""
    published, both = TABLE_II[row.name], math.sqrt(1.0 / worlds + 1.0 / paper.WORLDS)
    mean = (row.mean.estimate - published.mean) / (published.std * both)
    error = ((row.std.high or 0.0) - (row.std.low or 0.0)) / (2.0 * SURE) * math.sqrt(worlds) * both
    std = (row.std.estimate - published.std) / error if error else 0.0
    verdicts = ["within chance" if abs(one) <= SURE else "more than chance" for one in (mean, std)]
    return row.title, f"{mean:+.1f}", verdicts[0], f"{std:+.1f}", number(row.std.estimate / published.std), verdicts[1]


def planner_table(one: PlannerFinding) -> str:
    """Return the times and failures of a planner's trials."""
    published = paper.TRIALS[one.planner]
    failures = one.trials - one.outcomes.get(Outcome.SUCCESS.value, 0)
    rows = [
        _compared("time per metre as counted [s/m]", published.normalised_s_per_m, one.normalised_s_per_m),
        _compared("its ±: over a world's trials [s/m]", published.spread_s_per_m, one.spread_s_per_m),
        _compared("the same in worlds without a failure [s/m]", None, one.sure_spread_s_per_m),
        _compared("worlds without a failure", None, one.sure_worlds, 0),
        _compared("its deviation over worlds [s/m]", published.over_worlds_s_per_m, one.over_worlds_s_per_m),
        _compared("time as counted [s]", published.time_s, one.time_s),
        _compared("time of successes [s]", published.success_time_s, one.success_time_s),
        _compared("failures [%]", 100.0 * published.failure_share, one.failure_share.scaled(100.0), 1),
        _compared("failures", published.failures, failures, 0),
        _compared("failures by timeout", published.failures_50_s, one.outcomes.get(Outcome.TIMEOUT.value, 0), 0),
        _compared("time that a failure counts [s]", published.failure_time_s, one.failure_time_s, 1),
        _compared("time in the easiest tenth of the worlds [s]", published.easy_s, one.easy_s, 1),
        _compared("time in the most difficult tenth [s]", published.hard_s, one.hard_s, 1),
        _compared("repeatability: two trials against the others, Spearman", published.halves, one.halves),
    ]
    return markdown_table((f"{spelling(one.planner)}, {one.trials} trials", *_OURS), rows)


def correlations_table(findings: Findings) -> str:
    """Return how well planners, and halves of the trials, agree on the worlds."""
    trials = findings.trials
    rows = [
        _compared("DWA's means against E-Band's", paper.PLANNERS_CORRELATION, trials.planners_correlation),
        _compared("one half of a world's trials against the other", paper.HALVES, trials.halves),
    ]
    return markdown_table(("Spearman correlation over worlds", *_OURS), rows)


def _compared(name: str, published: float | None, ours: Interval | float | None, digits: int = 2) -> Row:
    """Return a published number, ours, their difference, and whether the published one is within our interval."""
    value = ours.estimate if isinstance(ours, Interval) else ours
    return (
        name,
        "" if published is None else number(published, digits),
        ours.text(digits) if isinstance(ours, Interval) else number(ours, digits),
        "" if published is None or value is None else f"{value - published:+.{digits}f}",
        contains(ours, published) if published is not None and isinstance(ours, Interval) else "",
    )


def models_table(findings: Findings) -> str:
    """Return losses in training and in held-out worlds, by model."""
    losses = ("training loss", "held-out loss", "held-out / training", "MAE [s/m]", "R2", "Spearman")
    rows = [_published_model(), *map(_model, findings.learning.recipes)]
    return markdown_table(("model", *losses, "loss below the paper's network's", "verdict"), rows)


def _published_model() -> Row:
    model = paper.MODEL
    losses = (number(model.training_mse), number(model.mse), _ratio(model.mse, model.training_mse))
    others = (number(model.mae_s_per_m), number(model.r2), number(model.spearman))
    return ("published: the paper's network", *losses, *others, "", "")


def _model(one: RecipeFinding) -> Row:
    title = f"the suite's model: {one.title}" if one.recipe == SHIPPED else one.title
    losses = (number(one.training_mse), one.mse.text(), _ratio(one.mse.estimate, one.training_mse))
    others = (one.mae_s_per_m.text(), one.r2.text(), one.spearman.text())
    if one.improvement is None:
        return (title, *losses, *others, "", "")
    verdict = {HOLDS: "better", FAILS: "worse", OPEN: OPEN}[above(one.improvement)]
    return (title, *losses, *others, one.improvement.text(), verdict)


def _ratio(loss: float, training_loss: float) -> str:
    return number(loss / training_loss, 1) if training_loss >= _LEAST_LOSS else "-"


def fits(findings: Findings) -> dict[str, Regression]:
    """Return the lines through new worlds by a title: of each model, in the worlds of its figure and in all."""
    found = findings.transfer
    shown, driven = findings.scope.config.transfer_worlds, len(found.worlds)
    made = {f"{TITLES[one.model]}, {shown} worlds of Fig. 8": one for one in found.figure}
    return made | {f"{TITLES[one.model]}, all {driven} worlds": one for one in found.all_worlds}


# What is shown of lines through new worlds: name, published number, ours.
_LINES: tuple[tuple[str, str, Callable[[Regression], str]], ...] = (
    ("slope, both planners", f"{paper.SLOPES['both']:.2f}", lambda one: one.lines["both"].slope.text()),
    ("1 within", "", lambda one: contains(one.lines["both"].slope, 1.0)),
    ("width of its interval", "", lambda one: _width(one.lines["both"].slope)),
    ("slope, DWA", f"{paper.SLOPES['dwa']:.2f}", lambda one: one.lines["dwa"].slope.text()),
    ("slope, E-Band", f"{paper.SLOPES['eband']:.2f}", lambda one: one.lines["eband"].slope.text()),
    ("DWA - E-Band", f"{paper.SLOPES['dwa'] - paper.SLOPES['eband']:.2f}", lambda one: one.steeper.text()),
    ("DWA's line above E-Band's from a predicted [s/m]", "", lambda one: number(one.crossing_s_per_m)),
    ("intercept, both planners [s/m]", "almost 0", lambda one: one.lines["both"].intercept_s_per_m.text()),
    ("0 within", "", lambda one: contains(one.lines["both"].intercept_s_per_m, 0.0)),
    ("Spearman", "", lambda one: one.correlation.text()),
    ("deviation of predictions over worlds [s/m]", "", lambda one: number(one.predicted_std_s_per_m)),
    ("deviation of measured times over worlds [s/m]", "", lambda one: number(one.measured_std_s_per_m)),
)


def lines_table(findings: Findings) -> str:
    """Return the lines through the new worlds, a column each."""
    found = fits(findings)
    rows = [(name, published, *map(cell, found.values())) for name, published, cell in _LINES]
    return markdown_table(("", "published (real robot)", *found), rows)


def _width(interval: Interval) -> str:
    return "-" if interval.low is None or interval.high is None else number(interval.high - interval.low, 1)


def new_trials_table(findings: Findings) -> str:
    """Return times and failures in the new worlds beside those in the data set."""
    return markdown_table(("", "new worlds, no map", "trials above", "difference"), _new_trials(findings))


def _new_trials(findings: Findings) -> Iterator[Row]:
    for new in findings.transfer.planners:
        before, name = findings.trials.of(new.planner), spelling(new.planner)
        for measure, sides, digits in (
            ("time per metre as counted [s/m]", (new.normalised_s_per_m, before.normalised_s_per_m), 2),
            ("failures [%]", (new.failure_share.scaled(100.0), before.failure_share.scaled(100.0)), 0),
        ):
            change = f"{sides[0].estimate - sides[1].estimate:+.{digits}f}"
            yield (f"{name}, {measure}", *(one.text(digits) for one in sides), change)
