"""Errors of predictions against measured difficulty, and how good they could be; intervals are of 95 % over worlds."""

import math
from dataclasses import dataclass

import numpy as np
import numpy.typing as npt

from barn_metrics import bootstrap
from barn_metrics.bootstrap import Interval, Statistic
from barn_metrics.model.trials import Trials
from barn_worlds.base.arrays import Floats, Integers

RESAMPLES = 4000  # rank correlations of several repeats are slow, and the shipped card has this many
_SPLITS = 50


@dataclass(frozen=True)
class Errors:
    """Mean squared error in (s/m)^2, mean absolute error in s/m, explained variance and Spearman's correlation."""

    mse: Interval
    mae: Interval
    r2: Interval
    spearman: Interval


@dataclass(frozen=True)
class Ceiling:
    """Agreement of the trials with themselves.

    reliability: correlation of halves of the repetitions, carried to all of them by the formula of Spearman and Brown:
    the highest R2 that a model can have on these trials; None where worlds have one trial per planner. half_spearman:
    rank correlation of the halves. noise_mse: squared error in (s/m)^2 that even the true difficulty would have.
    """

    reliability: Interval | None
    half_spearman: float | None
    noise_mse: float | None


def errors_of(predicted: Floats, measured: Floats) -> Errors:
    """Return the errors of predictions (r, w), averaged over their r repeats, against measured times (w,)."""
    squared = ((predicted - measured) ** 2).mean(axis=0)
    absolute = np.abs(predicted - measured).mean(axis=0)

    def spearman(drawn: Integers) -> Floats:
        each = [bootstrap.spearman(one[drawn], measured[drawn]) for one in predicted]
        mean: Floats = np.nan_to_num(each).mean(axis=0)  # what does not vary orders nothing
        return mean

    return Errors(
        over_worlds(lambda drawn: squared[drawn].mean(axis=-1), len(measured)),
        over_worlds(lambda drawn: absolute[drawn].mean(axis=-1), len(measured)),
        determination(predicted, measured),
        over_worlds(spearman, len(measured)),
    )


def determination(predicted: Floats, measured: Floats) -> Interval:
    """Return R2 of predictions (r, w), averaged over their r repeats, as they are: not of a line through them.

    measured: (w,). Below zero where predictions are worse than its mean; NaN where it does not vary.
    """
    if not measured.var() > 0.0:
        return Interval(math.nan)
    squared = ((predicted - measured) ** 2).mean(axis=0)

    def r2(drawn: Integers) -> Floats:
        explained: Floats = 1.0 - squared[drawn].mean(axis=-1) / measured[drawn].var(axis=-1)
        return explained

    return over_worlds(r2, len(measured))


def paired_gain(worse: npt.ArrayLike, better: npt.ArrayLike, measured: npt.ArrayLike) -> Interval:
    """Return by how much the mean squared error of predictions, (w,) or of repeats (r, w), lies below that of others.

    Both are of the worlds whose times (w,) were measured, so that models of two evaluations can be compared.
    """
    measured = np.asarray(measured)
    first, second = (((np.atleast_2d(one) - measured) ** 2).mean(axis=0) for one in (worse, better))
    return over_worlds(lambda drawn: (first - second)[drawn].mean(axis=-1), len(measured))


def noise_ceiling(trials: Trials, seed: int = 0) -> Ceiling:
    """Return the ceiling of trials from random splits of the repetitions; both halves hold as many of each planner."""
    values = [_repetitions(trials, planner) for planner in trials.planner_names]
    fewest = min(min(map(len, rows)) for rows in values)
    if fewest < 2:
        return Ceiling(None, None, None)
    generator = np.random.default_rng(seed)
    halves = np.array([_split(values, generator) for _ in range(_SPLITS)])  # (splits, 2, w)
    # Halves are as large as the world with the fewest repetitions allows.
    factor = fewest / (fewest // 2)

    def reliability(drawn: Integers) -> Floats:
        each = np.mean([pearson(first[drawn], second[drawn]) for first, second in halves], axis=0)
        full: Floats = factor * each / (1.0 + (factor - 1.0) * each)
        return full

    worlds = len(trials.world_numbers)
    noise = sum(np.mean([np.var(row, ddof=1) / len(row) for row in rows]) for rows in values) / len(values) ** 2
    ranks = np.mean([bootstrap.spearman(first, second) for first, second in halves])
    return Ceiling(over_worlds(reliability, worlds), float(ranks), float(noise))


def _repetitions(trials: Trials, planner: str) -> list[Floats]:
    """Return the times per metre of one planner's trials in each world."""
    mine = trials.of(planner)
    return [mine.normalised_s_per_m[mine.worlds == world] for world in trials.world_numbers]


def _split(values: list[list[Floats]], generator: np.random.Generator) -> Floats:
    """Return the difficulty of each world by two halves that share no trial, (2, w)."""
    half = min(min(map(len, rows)) for rows in values) // 2
    means = []
    for rows in values:
        drawn = [generator.permutation(row)[: 2 * half].reshape(2, half).mean(axis=1) for row in rows]
        means.append(np.array(drawn).T)
    mean: Floats = np.mean(means, axis=0)
    return mean


def over_worlds(statistic: Statistic, worlds: int) -> Interval:
    """Return a statistic of positions of worlds (..., n), 0 to worlds - 1, with its 95 % BCa interval."""
    return bootstrap.over_worlds(statistic, worlds, resamples=RESAMPLES)


def pearson(a: Floats, b: Floats) -> Floats:
    """Return the correlation along the last axis; 0 where one side does not vary."""
    a, b = (one - one.mean(axis=-1, keepdims=True) for one in (a, b))
    scale = np.sqrt((a**2).sum(axis=-1) * (b**2).sum(axis=-1))
    found: Floats = np.where(scale > 1e-12, (a * b).sum(axis=-1) / np.maximum(scale, 1e-12), 0.0)
    return found
