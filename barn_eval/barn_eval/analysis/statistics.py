"""Means over trials and comparisons of planners, with limits that hold for few worlds, skewed values and rare failures.

A world is the unit of sampling: functions take one value per trial and, beside it, the number of its world. No interval
that is made of what was seen knows of failures that were not drawn. So where failures count, limits also hold what the
mean would be with the share of failures at either of its own limits. Shares and the test of differences are those of
`significance` beside this. All are the same for any order of the trials.
"""

import math
from collections.abc import Sequence
from dataclasses import dataclass, field, replace
from functools import cached_property

import numpy as np

from barn_eval.analysis import significance
from barn_eval.analysis.significance import FLIPS, Components, Difference, Share
from barn_metrics.bootstrap import LEVEL, Interval, bootstrap_interval, spearman
from barn_worlds.base.arrays import Floats, Integers


@dataclass(frozen=True, eq=False)
class Columns:
    """A measure of some trials.

    values, worlds, repetitions (n,): of each trial. failures (n,): of 0 and 1, as_failure (n,): what each counts with,
    or would, as a failure; empty where failures have no value of their own. best: the best value that there can be.
    """

    values: Floats
    worlds: Integers
    repetitions: Integers
    failures: Integers = field(default_factory=lambda: np.empty(0, np.int64))
    as_failure: Floats = field(default_factory=lambda: np.array([]))
    best: float = math.inf

    def at(self, places: Integers) -> "Columns":
        """Return the trials at these places."""
        values, worlds, repetitions = (
            self.values[places],
            self.worlds[places],
            self.repetitions[places],
        )
        if not self.counted:
            return Columns(values, worlds, repetitions)
        return Columns(
            values,
            worlds,
            repetitions,
            self.failures[places],
            self.as_failure[places],
            self.best,
        )

    @property
    def counted(self) -> bool:
        """Whether failures have a value of their own, which is finite as are all values."""
        return len(self.failures) > 0

    def mean(self) -> Interval:
        """Return the mean of the values that are finite, with its interval, which holds no value that cannot be."""
        known = np.flatnonzero(np.isfinite(self.values))
        trials = self.at(known[np.lexsort((self.values[known], self.worlds[known]))])
        found = mean_interval(trials.values, trials.worlds)
        if trials.counted:
            share = trials.failures_seen
            found = found.widen_to(
                *(
                    found.estimate - trials.cost * (one - share.share)
                    for one in share.limits
                )
            )
        if found.low is None or found.high is None:
            return found
        low = max(0.0, found.low) if trials.values.min() >= 0.0 else found.low
        return replace(
            found,
            low=low,
            high=min(found.high, self.best) if self.best > 0.0 else found.high,
        )

    def parts(self) -> Components:
        """Return the variance of the values, all of them finite."""
        return replace(
            significance.components(self.values, self.worlds), unseen=self.unseen
        )

    def failure_share(self) -> Interval | None:
        """Return the share of failures, None where they have no value of their own."""
        return (
            Interval(self.failures_seen.share, *self.failures_seen.limits)
            if self.counted
            else None
        )

    @property
    def unseen(self) -> tuple[float, ...]:
        """What a failure costs, if it counts and none was seen."""
        return (abs(self.cost),) if self.counted and not self.failures.any() else ()

    @cached_property
    def failures_seen(self) -> Share:
        """The share of failures."""
        return significance.share_of(self.failures, self.worlds)

    @cached_property
    def cost(self) -> float:
        """How much a success is worth above a failure: below 0 where small values are better.

        Successes in fewer than two worlds say too little; they are taken to be worth the best value that there can be.
        """
        won = self.failures == 0
        success = (
            float(np.mean(self.values[won]))
            if len(np.unique(self.worlds[won])) > 1
            else self.best
        )
        return success - float(np.mean(self.as_failure))

    def excess(self, other: "Columns") -> Share:
        """Return the share of failures that another has not had in the same worlds, of the same trials."""
        world = np.unique(self.worlds, return_inverse=True)[1]
        more = np.maximum(
            0.0, np.bincount(world, self.failures - other.failures) / np.bincount(world)
        )
        return significance.share_of(more[world], self.worlds)


def mean_interval(values: Floats, worlds: Integers) -> Interval:
    """Return the mean of values (n,) over worlds with limits; values that are NaN have no part in it.

    Limits are Student's, of the mean's linearisation as a ratio, with Hall's transformation against skewness (1992, "On
    the removal of skewness by transformation").
    """
    known = np.isfinite(values)
    order = np.lexsort(
        (values[known], worlds[known])
    )  # sums must not depend on the order of the trials
    values, worlds = values[known][order], worlds[known][order]
    _, world = np.unique(worlds, return_inverse=True)
    sums, counts = (
        np.bincount(world, weights).astype(np.float64) for weights in (values, None)
    )
    if not len(sums):
        return Interval(math.nan)
    mean = float(sums.sum() / counts.sum())
    if len(sums) < 2:
        return Interval(mean)
    below, above = _errors((sums - mean * counts) / counts.sum())
    return Interval(mean, mean - below, mean + above)


def _errors(residuals: Floats) -> tuple[float, float]:
    """Return how far below and above an estimate its limits are, by what each world adds to its error (m,), m > 1."""
    worlds, spread = len(residuals), float(residuals @ residuals)
    if spread == 0.0:
        return 0.0, 0.0
    error = math.sqrt(spread * worlds / (worlds - 1))
    quantile = significance.t_quantile(0.5 + LEVEL / 2.0, worlds - 1)
    skewness: float = (
        float(np.sum(residuals**3)) * math.sqrt(worlds) / math.pow(spread, 1.5)
    )
    if math.isclose(skewness, 0.0, abs_tol=1e-9):  # it counts as symmetric
        return quantile * error, quantile * error

    def untransformed(y: float) -> float:
        """Return the studentised error of which y is the transform."""
        inner = 1.0 + skewness * (y / math.sqrt(worlds) - skewness / (6.0 * worlds))
        return math.sqrt(worlds) * 3.0 / skewness * (float(np.cbrt(inner)) - 1.0)

    return untransformed(quantile) * error, -untransformed(-quantile) * error


@dataclass(frozen=True)
class Paired:
    """A comparison of A and B on what both did in the same worlds with the same seeds.

    mean_a, mean_b: over those trials. difference: mean of A - B over them. p: two-sided, of the test that flips the
    sign of whole worlds, and not below that at which the interval leaves out 0. parts: variance of the difference.
    improvement: probability that a trial of A is better than one of B in the same world, ties counting half, averaged
    over worlds. failures: the share of failures of each, None where they have no value of their own.
    """

    worlds: int
    trials: int
    mean_a: float
    mean_b: float
    difference: Interval
    p: float
    parts: Components
    improvement: Interval
    failures: tuple[Interval | None, Interval | None] = (None, None)


def repetition_spread(values: Floats, worlds: Integers) -> float:
    """Return the standard deviation over a world's trials, averaged over worlds: the paper's +- (Sec. IV).

    It is that of the trials themselves (divisor n); worlds with one trial have none and no part in the average.
    """
    spreads = [part.std() for part in _groups(values, worlds).values() if len(part) > 1]
    return float(np.mean(spreads)) if spreads else math.nan


def matched_trials(columns: Sequence[Columns]) -> list[Columns]:
    """Return the trials that all planners have a value for, in the same order of worlds and repetitions.

    Trials of one world and repetition belong together; they met the same noise.
    """
    found = [(one, _places(one)) for one in columns]
    keys = sorted(set.intersection(*(set(places) for _, places in found)))
    return [
        one.at(np.array([places[key] for key in keys], np.int64))
        for one, places in found
    ]


def difference(a: Columns, b: Columns, seed: int = 0, flips: int = FLIPS) -> Difference:
    """Return the mean difference of matched trials, each as `paired_difference` has it.

    Where failures count, it is clear only if it keeps its sign when the better one fails as often as its failures so
    far allow: by the test alone, a quick planner that fails rarely seems better than a steady one of the same mean as
    long as no failure was drawn. Limits hold what either one's failures would make of the difference.
    """
    found = significance.paired_difference(a.values - b.values, a.worlds, seed, flips)
    if not (a.counted and b.counted and found.trials):
        return found
    size, p, ends = found.interval.estimate, found.p, []
    for one, other, cost in ((a, b, a.cost), (b, a, -b.cost)):
        more = one.excess(other)
        ends.append(size - cost * (more.limits[1] - more.share))
        if size * cost > 0.0:
            p = max(p, more.p_above(more.share + size / cost))
    parts = replace(found.parts, unseen=a.unseen + b.unseen)
    return replace(found, interval=found.interval.widen_to(*ends), p=p, parts=parts)


def paired(a: Columns, b: Columns, *, larger_is_better: bool, seed: int = 0) -> Paired:
    """Compare two planners on the pairs of trials in which both have a value.

    The probability of improvement looks at every pair of a trial of A and one of B in a world (Agarwal et al. 2021,
    over worlds in place of tasks). Its interval is that of its difference from one half.
    """
    left, right = matched_trials([a, b])
    found = difference(left, right, seed)
    if not found.trials:
        return Paired(
            0,
            0,
            math.nan,
            math.nan,
            found.interval,
            math.nan,
            found.parts,
            Interval(math.nan),
        )
    larger, smaller = (left, right) if larger_is_better else (right, left)
    groups, others = (_groups(one.values, one.worlds) for one in (larger, smaller))
    chances = np.array([_chance(groups[world], others[world]) for world in groups])
    return Paired(
        found.worlds,
        found.trials,
        float(left.values.mean()),
        float(right.values.mean()),
        found.interval,
        found.p,
        found.parts,
        significance.paired_difference(
            chances - 0.5, np.array(list(groups)), seed
        ).interval.shift(0.5),
        (left.failure_share(), right.failure_share()),
    )


def rank_correlation(
    a: tuple[Floats, Integers], b: tuple[Floats, Integers], seed: int = 0
) -> Interval:
    """Return Spearman's correlation of two planners' means per world, each given as (values, worlds)."""
    first, second = _groups(*a), _groups(*b)
    shared = sorted(first.keys() & second.keys())
    if len(shared) < 3:
        return Interval(math.nan)
    means = (
        np.array([groups[world].mean() for world in shared])
        for groups in (first, second)
    )
    ranks = np.array(
        [np.unique(one, return_inverse=True)[1] for one in means]
    )  # whole numbers are ranked quickly
    return bootstrap_interval(
        lambda drawn: spearman(*ranks[:, drawn]), len(shared), seed
    )


def _chance(a: Floats, b: Floats) -> float:
    """Return the probability that a value of `a` is above one of `b`, ties counting half."""
    above = a[:, None] - b[None, :]
    return float(np.mean((above > 0.0) + 0.5 * (above == 0.0)))


def _places(columns: Columns) -> dict[tuple[int, int], int]:
    """Return where the trials with a value are, by world and repetition."""
    known = np.flatnonzero(np.isfinite(columns.values)).tolist()
    return {(int(columns.worlds[k]), int(columns.repetitions[k])): k for k in known}


def _groups(values: Floats, worlds: Integers) -> dict[int, Floats]:
    """Return the values of each world that are finite, by size, so that no sum depends on the order of the trials."""
    known = np.isfinite(values)
    order = np.lexsort((values[known], worlds[known]))
    values, worlds = values[known][order], worlds[known][order]
    return {int(number): values[worlds == number] for number in np.unique(worlds)}
