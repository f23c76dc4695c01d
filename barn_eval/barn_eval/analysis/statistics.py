"""Figures of many trials with their uncertainty, and comparisons of planners.

Functions take one value per trial and, beside it, the number of its world. Intervals of means draw whole worlds
(`barn_metrics.bootstrap`) from a seed that is passed in; those of shares and differences are of `significance` beside
this. All are the same for any order of the trials.
"""

import math
from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from barn_eval.analysis.significance import paired_difference
from barn_eval.analysis.variance import Components
from barn_metrics.bootstrap import Interval, over_worlds
from barn_worlds.base.arrays import Floats, Integers

Columns = tuple[Floats, Integers, Integers]  # value, world and repetition of each trial (n,)


@dataclass(frozen=True)
class Paired:
    """A comparison of A and B on what both did in the same worlds with the same seeds.

    mean_a, mean_b: over those trials. difference: mean of A - B over them. p: two-sided, of the test that flips the
    sign of whole worlds. parts: variance of the difference. improvement: probability that a trial of A is better than
    one of B in the same world, ties counting half, averaged over worlds.
    """

    worlds: int
    trials: int
    mean_a: float
    mean_b: float
    difference: Interval
    p: float
    parts: Components
    improvement: Interval


def mean_over_trials(values: Floats, worlds: Integers, seed: int = 0) -> Interval:
    """Return the mean of all values (n,) with an interval that resamples worlds (n,).

    Values that are NaN have no part in it, nor have worlds that hold nothing else.
    """
    known = np.isfinite(values)
    if not known.any():
        return Interval(math.nan)
    values, (_, world) = _in_order(values[known], worlds[known])
    sums, counts = (np.bincount(world, weights).astype(np.float64) for weights in (values, None))
    return ratio_of_means(sums, counts, seed)


def repetition_spread(values: Floats, worlds: Integers) -> float:
    """Return the standard deviation over a world's trials, averaged over worlds: the paper's +- (Sec. IV).

    It is that of the trials themselves (divisor n); worlds with one trial have none and no part in the average.
    """
    spreads = [part.std() for part in _groups(values, worlds).values() if len(part) > 1]
    return float(np.mean(spreads)) if spreads else math.nan


def matched(columns: Sequence[Columns]) -> tuple[Floats, Integers]:
    """Return the trials that all planners have a value for: values (planners, n), and the world of each (n,).

    Trials of one world and repetition belong together; they met the same noise.
    """
    found = [_by_key(*one) for one in columns]
    keys = sorted(set.intersection(*map(set, found)))
    worlds = np.array([world for world, _ in keys], np.int64)
    return np.array([[one[key] for key in keys] for one in found], np.float64), worlds


def paired(a: Columns, b: Columns, *, larger_is_better: bool, seed: int = 0) -> Paired:
    """Compare two planners on the pairs of trials in which both have a value.

    The probability of improvement looks at every pair of a trial of A and one of B in a world (Agarwal et al. 2021,
    over worlds in place of tasks). Its interval is that of its difference from one half.
    """
    (left, right), worlds = matched([a, b])
    difference = paired_difference(left - right, worlds, seed)
    if not len(worlds):
        return Paired(0, 0, math.nan, math.nan, difference.interval, math.nan, difference.parts, Interval(math.nan))
    sign = 1.0 if larger_is_better else -1.0
    groups_a, groups_b = _groups(sign * left, worlds), _groups(sign * right, worlds)
    chances = np.array([_chance(groups_a[world], groups_b[world]) for world in groups_a])
    return Paired(
        difference.worlds,
        difference.trials,
        float(left.mean()),
        float(right.mean()),
        difference.interval,
        difference.p,
        difference.parts,
        paired_difference(chances - 0.5, np.array(list(groups_a)), seed).interval.shifted(0.5),
    )


def rank_correlation(a: tuple[Floats, Integers], b: tuple[Floats, Integers], seed: int = 0) -> Interval:
    """Return Spearman's correlation of two planners' means per world, each given as (values, worlds)."""
    first, second = _groups(*a), _groups(*b)
    shared = sorted(first.keys() & second.keys())
    if len(shared) < 3:
        return Interval(math.nan)
    x, y = (np.array([groups[world].mean() for world in shared]) for groups in (first, second))
    return over_worlds(lambda drawn: _rank_correlation(x[drawn], y[drawn]), len(shared), seed)


def ratio_of_means(numerators: Floats, denominators: Floats, seed: int = 0) -> Interval:
    """Return the mean of one figure per world (n,) over that of another of the same worlds; both are resampled."""
    if not len(numerators):
        return Interval(math.nan)

    def ratio(drawn: Integers) -> Floats:
        found: Floats = numerators[drawn].sum(axis=-1) / denominators[drawn].sum(axis=-1)
        return found

    return over_worlds(ratio, len(numerators), seed)


def _rank_correlation(x: Floats, y: Floats) -> Floats:
    """Return Spearman's correlation along the last axis, NaN where one side does not vary."""
    from scipy import stats  # noqa: PLC0415 (see barn_metrics.bootstrap)

    x, y = (stats.rankdata(one, axis=-1) for one in (x, y))
    x, y = (one - one.mean(axis=-1, keepdims=True) for one in (x, y))
    with np.errstate(invalid="ignore", divide="ignore"):
        r: Floats = (x * y).sum(axis=-1) / np.sqrt((x**2).sum(axis=-1) * (y**2).sum(axis=-1))
    return r


def _chance(a: Floats, b: Floats) -> float:
    """Return the probability that a value of `a` is above one of `b`, ties counting half."""
    above = a[:, None] - b[None, :]
    return float(np.mean((above > 0.0) + 0.5 * (above == 0.0)))


def _by_key(values: Floats, worlds: Integers, repetitions: Integers) -> dict[tuple[int, int], float]:
    trials = zip(worlds.tolist(), repetitions.tolist(), values.tolist(), strict=True)
    return {(world, repetition): value for world, repetition, value in trials if math.isfinite(value)}


def _in_order(values: Floats, worlds: Integers) -> tuple[Floats, tuple[Integers, Integers]]:
    """Return the values sorted by world and size, so that sums do not depend on the order of trials."""
    order = np.lexsort((values, worlds))
    return values[order], np.unique(worlds[order], return_inverse=True)


def _groups(values: Floats, worlds: Integers) -> dict[int, Floats]:
    """Return the values of each world that are finite, worlds ascending."""
    known = np.isfinite(values)
    values, (numbers, world) = _in_order(values[known], worlds[known])
    return {int(number): values[world == index] for index, number in enumerate(numbers)}
