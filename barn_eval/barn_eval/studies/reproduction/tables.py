"""Figures of the page: ours beside the published numbers, and verdicts that follow from intervals."""

import math
from collections.abc import Sequence

import numpy as np

from barn_eval.studies.reproduction import paper
from barn_eval.studies.reproduction.findings import Findings
from barn_eval.studies.reproduction.new_worlds import Regression
from barn_eval.studies.reproduction.table_ii import MetricRow
from barn_metrics.bootstrap import Interval, number
from barn_metrics.report import TABLE_II

HOLDS, FAILS, OPEN = "holds", "does not hold", "not decided"
SURE = 1.96  # standard errors of a 95 % interval
_LEAST_LOSS = 0.005  # (s/m)^2, below it a loss is shown as 0.00 and a ratio to it says nothing

Figure = Interval | float | None


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


def text(value: Figure, digits: int = 2) -> str:
    """Return an estimate with its limits, or a plain number."""
    return value.text(digits) if isinstance(value, Interval) else number(value, digits)


def compared(published: float | None, ours: Figure, digits: int = 2) -> str:
    """Return four cells: a published number, ours, their difference, whether the published one is in our interval."""
    if published is None:
        return f" | {text(ours, digits)} |  | "
    value = ours.estimate if isinstance(ours, Interval) else ours
    change = "" if value is None else f"{value - published:+.{digits}f}"
    within = contains(ours, published) if isinstance(ours, Interval) else ""
    return f"{number(published, digits)} | {text(ours, digits)} | {change} | {within}"


def changed(new: Interval, before: Interval, digits: int = 2) -> str:
    """Return three cells: a figure, what it was before, and the difference."""
    return f"{new.text(digits)} | {before.text(digits)} | {new.estimate - before.estimate:+.{digits}f}"


def distances(row: MetricRow, worlds: int) -> str:
    """Return five cells: by how many standard errors mean and std. of a metric are off Table II, with verdicts.

    The standard error of our std. is that of its interval, and that of the published one as large.
    """
    published, both = TABLE_II[row.name], math.sqrt(1.0 / worlds + 1.0 / paper.WORLDS)
    mean = (row.mean.estimate - published.mean) / (published.std * both)
    error = ((row.std.high or 0.0) - (row.std.low or 0.0)) / (2.0 * SURE) * math.sqrt(worlds) * both
    std = (row.std.estimate - published.std) / error if error else 0.0
    verdicts = ["within chance" if abs(one) <= SURE else "more than chance" for one in (mean, std)]
    ratio = number(row.std.estimate / published.std)
    return f"{mean:+.1f} | {verdicts[0]} | {std:+.1f} | {ratio} | {verdicts[1]}"


def loss_ratio(loss: float, training_loss: float) -> str:
    """Return how often the training loss goes into the held-out one."""
    return number(loss / training_loss, 1) if training_loss >= _LEAST_LOSS else "-"


def fits(findings: Findings) -> dict[str, Regression]:
    """Return the lines through new worlds by a title: in the worlds of the figure and in all."""
    found = findings.transfer
    made = {f"{findings.scope.config.transfer_worlds} worlds of Fig. 8": found.figure}
    return made | ({f"all {len(found.worlds)} worlds": found.all_worlds} if found.all_worlds else {})


def variance(difficulty: Sequence[float]) -> float:
    """Return the variance of the difficulty over worlds, (s/m)^2."""
    return float(np.var(difficulty))
