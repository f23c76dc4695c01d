"""Why our numbers differ from the published ones, as far as the numbers can tell: each sentence cites them."""

from __future__ import annotations

import math
from collections.abc import Mapping

from barn_eval.analysis.planner_style import spelling
from barn_eval.studies import learning, metrics, paper
from barn_eval.studies.findings import Findings
from barn_eval.studies.metrics import MetricRow
from barn_eval.studies.transfer import Regression
from barn_eval.studies.trials import PlannerFinding
from barn_eval.studies.verdict import FAILS, HOLDS, OPEN, above, contains
from barn_eval.trials.outcome import Outcome
from barn_metrics.bootstrap import Interval, number

SURE = 1.96  # standard errors of a 95 % interval
_NOTABLE_S = 0.05
_LEAST_LOSS = 0.005  # (s/m)^2; below it is shown as 0.00, and a ratio to it says nothing


def remarks_on_metrics(findings: Findings) -> list[str]:
    """Return what is to be said of Table II."""
    rows, count = findings.metrics.rows, findings.metrics.worlds
    means = {row.title: _mean_distance(row, count) for row in rows}
    stds = {row.title: _std_distance(row, count) for row in rows}
    said = [
        f"The worlds are another draw from the same generator, {count} of ours against {paper.WORLDS} published"
        f" ones. Of {len(rows)} means {_near(means)} differ by less than {SURE} standard errors, of {len(rows)}"
        f" deviations {_near(stds)}; chance alone would have 95 of 100 do so."
    ]
    for row in rows:
        published = metrics.published(row.name)
        if abs(means[row.title]) > SURE:
            said.append(
                f"{row.title}: its mean is {row.mean.estimate:.2f} instead of {published.mean:.2f},"
                f" {means[row.title]:+.1f} standard errors off, more than chance. Why has not been found."
            )
        if abs(stds[row.title]) > SURE:
            said.append(
                f"{row.title}: its deviation over worlds is {row.std.estimate / published.std:.2f} times the"
                f" published one, {stds[row.title]:+.1f} standard errors off, more than chance. Why has not been"
                " found."
            )
        if row.maximum > published.maximum + 0.005:
            said.append(f"{row.title}: the largest value is {row.maximum:.2f} instead of {published.maximum:.2f}.")
    if findings.metrics.regenerated is not None:
        same = "the same worlds" if findings.metrics.regenerated else "OTHER worlds"
        said.append(f"Generated anew from its seed, the data set has {same}.")
    return said


def remarks_on_trials(findings: Findings) -> list[str]:
    """Return what is to be said of times, failures and the order of worlds."""
    trials = findings.trials
    said = []
    for one in trials.planners:
        said += [_of_time(one), *_of_failures(one), *_of_spread(one)]
    published = paper.PLANNERS_CORRELATION
    ours = trials.planners_correlation
    if not contains(ours, published):
        side = "higher" if ours.estimate > published else "lower"
        said.append(
            f"The two planners agree on which worlds are difficult with a correlation of {ours.text()}, {side}"
            f" than the published {published:.2f}."
        )
    return said


def remarks_on_models(findings: Findings) -> list[str]:
    """Return what is to be said of the difficulty model."""
    found = findings.learning
    network, ours = found.of(learning.PAPER), found.of(learning.SHIPPED)
    said = [
        f"The paper's loss of {paper.MODEL.training_mse:.2f} is that of training. On worlds that it has not seen,"
        f" the same network errs by {paper.MODEL.mse:.2f} on the published trials and by {network.mse.text()} on"
        " ours."
    ]
    if network.training_mse < network.mse.estimate / 2.0:
        seen = network.training_mse
        others = f", {network.mse.estimate / seen:.1f} times as much on others" if seen >= _LEAST_LOSS else ""
        said.append(
            f"So does it here: {seen:.2f} on the worlds of its training{others}. It has learnt its worlds by heart."
        )
    said.append(
        f"Difficulty has a variance over worlds of {found.variance:.2f} (s/m)^2 here; from error and R2 on the"
        f" published trials it follows to be {paper.MODEL.variance:.2f} there. So errors cannot be compared across,"
        f" R2 can: {network.r2.text()} here, {paper.MODEL.r2:.2f} there."
    )
    if ours.improvement is not None:
        sure = {HOLDS: "better", FAILS: "worse", OPEN: "not decided"}[above(ours.improvement)]
        said.append(
            f"The suite's model errs less than the paper's network by {ours.improvement.text()} (s/m)^2 on"
            f" held-out worlds ({sure}); its R2 is {ours.r2.text()}."
        )
    if found.ceiling_r2 is not None:
        said.append(
            "By the agreement of one half of the trials with the other, no model can have an R2 above"
            f" {found.ceiling_r2.text()} on them."
        )
    if found.notes:
        said += [f"{note[:1].upper()}{note[1:].rstrip('.')}." for note in found.notes]
    return said


def remarks_on_transfer(findings: Findings) -> list[str]:
    """Return what is to be said of the experiment on new worlds."""
    transfer = findings.transfer
    said = ["A slope of 1 and an intercept of 0 would mean that predictions hold as they are."]
    for one in transfer.all_worlds or transfer.figure:
        said += _of_prediction(one)
    widest = max(_width(one.lines["both"].slope) for one in transfer.figure)
    if widest > 0.5:
        said.append(
            f"{findings.scope.config.transfer_worlds} worlds leave a slope open by up to {widest:.1f}. The paper,"
            " with five, gives no interval."
        )
    for new in transfer.planners:
        before = findings.trials.of(new.planner)
        difference = new.normalised_s_per_m.estimate - before.normalised_s_per_m.estimate
        said.append(
            f"{spelling(new.planner)} takes {new.normalised_s_per_m.text()} s/m in the new worlds without a"
            f" map ({100.0 * new.failure_share.estimate:.0f} % of trials fail) and"
            f" {before.normalised_s_per_m.text()} in the data set with one"
            f" ({100.0 * before.failure_share.estimate:.0f} %), a difference of {difference:+.2f}."
        )
    return said


def _of_prediction(one: Regression) -> list[str]:
    """Return what one model's predictions of all worlds that were driven are worth."""
    slope, intercept = one.lines["both"].slope, one.lines["both"].intercept_s_per_m
    name = learning.TITLES[one.model]
    said = [
        f"By {name}, over {one.lines['both'].worlds} worlds: slope {slope.text()} (1"
        f" {_within(contains(slope, 1.0))}), intercept {intercept.text()} s/m (0"
        f" {_within(contains(intercept, 0.0))}), Spearman correlation {one.correlation.text()}."
    ]
    if above(slope) != HOLDS:
        said.append(f"So by {name} it is not certain that worlds predicted to be harder take longer.")
    narrow = one.predicted_std_s_per_m < one.measured_std_s_per_m
    said.append(
        f"Its predictions have a deviation of {one.predicted_std_s_per_m:.2f} s/m over these worlds, what is"
        f" measured one of {one.measured_std_s_per_m:.2f}: "
        + ("it spreads worlds less than they are." if narrow else "it spreads worlds more than they are.")
    )
    if one.crossing_s_per_m is not None:
        said.append(f"By it, DWA's line lies above E-Band's from a predicted {one.crossing_s_per_m:.2f} s/m.")
    return said


def _width(interval: Interval) -> float:
    return 0.0 if interval.low is None or interval.high is None else interval.high - interval.low


def _of_time(one: PlannerFinding) -> str:
    published, parts = paper.TRIALS[one.planner], one.parts
    within = contains(one.normalised_s_per_m, published.normalised_s_per_m)
    named = (
        (parts.successes_s, "from how long successes take"),
        (parts.share_s, "from how many trials fail"),
        (parts.penalty_s, "from what a failed trial counts"),
    )
    shares = ", ".join(f"{value:+.2f} s {why}" for value, why in sorted(named, key=lambda part: -abs(part[0])))
    name = spelling(one.planner)
    place = "lies within our interval" if within else "lies outside our interval"
    return (
        f"{name}: the published mean of {published.normalised_s_per_m:.2f} s/m {place}"
        f" ({one.normalised_s_per_m.text()}). The mean time differs by {parts.total_s:+.2f} s: {shares}."
    )


def _of_failures(one: PlannerFinding) -> list[str]:
    published = paper.TRIALS[one.planner]
    failed = one.trials - one.outcomes.get(Outcome.SUCCESS.value, 0)
    if failed == 0 or abs(one.parts.penalty_s) < _NOTABLE_S:
        return []
    timeouts = one.outcomes.get(Outcome.TIMEOUT.value, 0)
    return [
        f"{spelling(one.planner)}: {timeouts} of our {failed} failures reach the limit on the clock; a failure"
        f" counts {one.failure_time_s:.1f} s on average. Of the {published.failures} published ones"
        f" {published.failures_50_s} stand with 50 s, the others with the penalty of 30 s"
        f" ({published.failure_time_s:.1f} s on average)."
    ]


def _of_spread(one: PlannerFinding) -> list[str]:
    published = paper.TRIALS[one.planner]
    if contains(one.spread_s_per_m, published.spread_s_per_m):
        return []
    side = "above" if one.spread_s_per_m.estimate > published.spread_s_per_m else "below"
    return [
        f"{spelling(one.planner)}: the spread over a world's trials, {one.spread_s_per_m.text()} s/m, is"
        f" {side} the published {published.spread_s_per_m:.2f}; in the {one.sure_worlds} worlds in which no trial"
        f" fails it is {number(one.sure_spread_s_per_m)}."
    ]


def _mean_distance(row: MetricRow, count: int) -> float:
    """Return by how many standard errors a mean is off, given the published deviation over worlds."""
    published = metrics.published(row.name)
    return (row.mean.estimate - published.mean) / (published.std * math.sqrt(1.0 / count + 1.0 / paper.WORLDS))


def _std_distance(row: MetricRow, count: int) -> float:
    """Return the same of a deviation, whose standard error our interval gives; the published one has as large a one."""
    if row.std.low is None or row.std.high is None or row.std.low == row.std.high:
        return 0.0
    error = (row.std.high - row.std.low) / (2.0 * SURE) * math.sqrt(1.0 + count / paper.WORLDS)
    return (row.std.estimate - metrics.published(row.name).std) / error


def _near(distances: Mapping[str, float]) -> int:
    return sum(abs(distance) <= SURE for distance in distances.values())


def _within(inside: bool) -> str:
    return "within" if inside else "outside"
