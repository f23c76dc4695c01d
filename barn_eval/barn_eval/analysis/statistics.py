"""Figures of many trials with their uncertainty, and comparisons of planners.

Trials of one world are not independent of each other, so intervals are made by drawing whole worlds with
replacement (a cluster bootstrap), bias-corrected and accelerated (Efron 1987). Functions take one value per trial and,
beside it, the number of its world; they draw from a seed that is passed in and give the same figures for any order of
the trials.
"""

from __future__ import annotations

import math
import warnings
from collections.abc import Callable
from dataclasses import dataclass

import numpy as np
import numpy.typing as npt
from scipy import stats

LEVEL = 0.95
RESAMPLES = 10_000

Floats = npt.NDArray[np.float64]
Integers = npt.NDArray[np.int64]


@dataclass(frozen=True)
class Interval:
    """An estimate and its confidence limits; limits are None where there is too little to give any."""

    estimate: float
    low: float | None = None
    high: float | None = None


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


def wilson(successes: int, trials: int, level: float = LEVEL) -> Interval:
    """Return a success rate with Wilson's score interval; NaN without limits where there are no trials."""
    if trials == 0:
        return Interval(math.nan)
    limits = stats.binomtest(successes, trials).proportion_ci(level, method="wilson")
    return Interval(successes / trials, float(limits.low), float(limits.high))


def mean_over_trials(values: Floats, worlds: Integers, seed: int = 0, level: float = LEVEL) -> Interval:
    """Return the mean of all values (n,) with an interval that resamples worlds (n,).

    Values that are NaN have no part in it, nor have worlds that hold nothing else.
    """
    known = np.isfinite(values)
    if not known.any():
        return Interval(math.nan)
    values, (_, world) = _in_order(values[known], worlds[known])
    sums, counts = np.bincount(world, values), np.bincount(world)

    def mean(drawn: Integers, axis: int = -1) -> Floats:
        ratio: Floats = sums[drawn].sum(axis=axis) / counts[drawn].sum(axis=axis)
        return ratio

    return _over_worlds(mean, len(counts), seed, level)


def repetition_spread(values: Floats, worlds: Integers) -> float:
    """Return the standard deviation over a world's trials, averaged over worlds: the paper's +- (Sec. IV).

    It is that of the trials themselves (divisor n); worlds with one trial have none and no part in the average.
    """
    known = np.isfinite(values)
    spreads = [part.std() for part in _groups(values[known], worlds[known]).values() if len(part) > 1]
    return float(np.mean(spreads)) if spreads else math.nan


def paired(
    a: tuple[Floats, Integers, Integers],
    b: tuple[Floats, Integers, Integers],
    *,
    larger_is_better: bool,
    seed: int = 0,
    level: float = LEVEL,
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
        mean_over_trials(left - right, worlds, seed, level),
        mean_over_trials(chances, np.array(list(groups_a)), seed, level),
    )


def rank_correlation(
    a: tuple[Floats, Integers], b: tuple[Floats, Integers], seed: int = 0, level: float = LEVEL
) -> Interval:
    """Return Spearman's correlation of two planners' means per world, each given as (values, worlds)."""
    first, second = (
        {
            world: group.mean()
            for world, group in _groups(values[np.isfinite(values)], worlds[np.isfinite(values)]).items()
        }
        for values, worlds in (a, b)
    )
    shared = sorted(first.keys() & second.keys())
    x = np.array([first[world] for world in shared])
    y = np.array([second[world] for world in shared])

    def spearman(drawn: Integers, axis: int = -1) -> Floats:
        return _correlation(stats.rankdata(x[drawn], axis=axis), stats.rankdata(y[drawn], axis=axis), axis)

    return _over_worlds(spearman, len(shared), seed, level) if len(shared) > 2 else Interval(math.nan)


def ratio_of_means(numerators: Floats, denominators: Floats, seed: int = 0, level: float = LEVEL) -> Interval:
    """Return the mean of one figure per world (n,) over that of another of the same worlds; both are resampled."""
    if not len(numerators):
        return Interval(math.nan)

    def ratio(drawn: Integers, axis: int = -1) -> Floats:
        found: Floats = numerators[drawn].sum(axis=axis) / denominators[drawn].sum(axis=axis)
        return found

    return _over_worlds(ratio, len(numerators), seed, level)


def _over_worlds(statistic: Callable[..., Floats], worlds: int, seed: int, level: float) -> Interval:
    """Return a statistic of world numbers 0..n-1, drawn along an axis, with its interval."""
    estimate = float(statistic(np.arange(worlds)))
    if worlds < 2:
        return Interval(estimate)
    with warnings.catch_warnings():
        # All worlds alike: scipy warns that the distribution is degenerate, and the limits are the estimate.
        warnings.simplefilter("ignore", stats.DegenerateDataWarning)
        with np.errstate(invalid="ignore"):
            limits = stats.bootstrap(
                (np.arange(worlds),),
                statistic,
                n_resamples=RESAMPLES,
                batch=500,
                vectorized=True,
                confidence_level=level,
                method="BCa",
                rng=np.random.default_rng(seed),
            )
    low, high = float(limits.confidence_interval.low), float(limits.confidence_interval.high)
    if math.isfinite(low) and math.isfinite(high):
        return Interval(estimate, low, high)
    same = np.ptp(limits.bootstrap_distribution) == 0.0
    return Interval(estimate, estimate, estimate) if same else Interval(estimate)


def _correlation(x: Floats, y: Floats, axis: int) -> Floats:
    x = x - x.mean(axis=axis, keepdims=True)
    y = y - y.mean(axis=axis, keepdims=True)
    with np.errstate(invalid="ignore", divide="ignore"):
        r: Floats = (x * y).sum(axis=axis) / np.sqrt((x**2).sum(axis=axis) * (y**2).sum(axis=axis))
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


def _world_means(values: Floats, worlds: Integers) -> dict[int, float]:
    known = np.isfinite(values)
    return {world: float(group.mean()) for world, group in _groups(values[known], worlds[known]).items()}


def _groups(values: Floats, worlds: Integers) -> dict[int, Floats]:
    """Return the values of each world, worlds ascending."""
    values, (numbers, world) = _in_order(values, worlds)
    return {int(number): values[world == index] for index, number in enumerate(numbers)}
