"""Figures of many trials with their uncertainty, and comparisons of planners.

Functions take one value per trial and, beside it, the number of its world. Intervals draw whole worlds
(`barn_metrics.bootstrap`) from a seed that is passed in, and are the same for any order of the trials.
"""

import math
from dataclasses import dataclass

import numpy as np
from scipy import stats

from barn_metrics.bootstrap import LEVEL, Interval, over_worlds
from barn_worlds.arrays import Floats, Integers


@dataclass(frozen=True)
class Paired:
    """A comparison of A and B on what both did in the same worlds with the same seeds.

    mean_a, mean_b: over those trials. difference: mean of A - B over them. improvement: probability that a trial of A
    is better than one of B in the same world, ties counting half, averaged over worlds.
    """

    worlds: int
    trials: int
    mean_a: float
    mean_b: float
    difference: Interval
    improvement: Interval


def wilson(successes: int, trials: int) -> Interval:
    """Return a success rate with Wilson's score interval; NaN without limits where there are no trials."""
    if trials == 0:
        return Interval(math.nan)
    limits = stats.binomtest(successes, trials).proportion_ci(LEVEL, method="wilson")
    return Interval(successes / trials, float(limits.low), float(limits.high))


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


def paired(
    a: tuple[Floats, Integers, Integers],
    b: tuple[Floats, Integers, Integers],
    *,
    larger_is_better: bool,
    seed: int = 0,
) -> Paired:
    """Compare two planners, each given as (values, worlds, repetitions) of its trials.

    Only pairs of the same world and repetition in which both have a value take part. The probability of improvement
    looks at every pair of a trial of A and one of B in a world (Agarwal et al. 2021, over worlds in place of tasks).
    """
    first, second = _by_key(*a), _by_key(*b)
    keys = sorted(first.keys() & second.keys())
    if not keys:
        return Paired(0, 0, math.nan, math.nan, Interval(math.nan), Interval(math.nan))
    worlds = np.array([world for world, _ in keys], np.int64)
    left = np.array([first[key] for key in keys])
    right = np.array([second[key] for key in keys])
    sign = 1.0 if larger_is_better else -1.0
    groups_a, groups_b = _groups(sign * left, worlds), _groups(sign * right, worlds)
    chances = np.array([_chance(groups_a[world], groups_b[world]) for world in groups_a])
    return Paired(
        len(groups_a),
        len(keys),
        float(left.mean()),
        float(right.mean()),
        mean_over_trials(left - right, worlds, seed),
        mean_over_trials(chances, np.array(list(groups_a)), seed),
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
