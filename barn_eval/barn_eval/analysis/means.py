"""Means over trials and their differences, with limits that hold for few worlds, skewed values and rare failures.

A world is the unit of sampling. A mean of values that count failures has two parts: the mean of the successes, and what
failures take away. No bootstrap sees a failure that was not drawn; so the share of failures has an interval of its own,
above 0 even where none was seen, and the two are put together by the method of variance estimates recovery (MOVER; Zou
and Donner 2008, "Construction of confidence limits about effect measures"; Newcombe 1998 for differences).
"""

import math
from dataclasses import dataclass
from functools import cached_property

import numpy as np

from barn_eval.analysis.planning import t_quantile
from barn_eval.analysis.significance import share
from barn_metrics.bootstrap import LEVEL, Interval
from barn_worlds.base.arrays import Floats, Integers

_STRAIGHT = 1e-9  # skewness below which a distribution counts as symmetric
_BISECTIONS = 30  # of a p-value


@dataclass(frozen=True, eq=False)
class Counted:
    """Trials with the value that each counts with.

    values (n,): finite. failures (n,): of 0 and 1. as_failure (n,): what each counts with, or would, as a failure.
    worlds (n,): their numbers.
    """

    values: Floats
    failures: Integers
    as_failure: Floats
    worlds: Integers

    @property
    def mean(self) -> float:
        """The mean of all values."""
        return float(np.mean(self.values))

    @cached_property
    def world(self) -> Integers:
        """The position of each trial's world among those that there are (n,)."""
        places: Integers = np.unique(self.worlds, return_inverse=True)[1]
        return places

    @cached_property
    def residuals(self) -> Floats:
        """What each world adds to the error of the mean of the successes, by its linearisation as a ratio."""
        successes = 1.0 - self.failures
        sums = np.bincount(self.world, successes * self.values)
        counts = np.bincount(self.world, successes)
        found: Floats = (sums - self.success_mean * counts) / counts.sum()
        return found

    @cached_property
    def success_mean(self) -> float:
        """The mean of the successes, NaN if there are none."""
        succeeded = self.failures == 0
        return float(np.mean(self.values[succeeded])) if succeeded.any() else math.nan

    @cached_property
    def cost(self) -> float:
        """How much a success is worth above a failure: below 0 where small values are better."""
        return self.success_mean - float(np.mean(self.as_failure))

    @property
    def succeeding_worlds(self) -> int:
        """In how many worlds there is a success."""
        return len(np.unique(self.world[self.failures == 0]))

    @property
    def failure_share(self) -> float:
        """The share of failures."""
        return float(np.mean(self.failures))

    @cached_property
    def failure_residuals(self) -> Floats:
        """What each world adds to the error of the mean by its share of failures."""
        found: Floats = np.bincount(self.world, self.failures - self.failure_share) / len(self.values)
        return -self.cost * found


def mean_interval(values: Floats, worlds: Integers, level: float = LEVEL) -> Interval:
    """Return the mean of values (n,) with limits for skewed ones; values that are NaN have no part in it.

    Student's limits of the ratio of sums over worlds, with Hall's transformation against skewness (Hall 1992, "On the
    removal of skewness by transformation").
    """
    known = np.isfinite(values)
    if not known.any():
        return Interval(math.nan)
    order = np.lexsort((values[known], worlds[known]))  # sums must not depend on the order of the trials
    values, worlds = values[known][order], worlds[known][order]
    _, world = np.unique(worlds, return_inverse=True)
    counts = np.bincount(world)
    mean = float(np.bincount(world, values).sum() / counts.sum())
    if len(counts) < 2:
        return Interval(mean)
    below, above = _errors((np.bincount(world, values) - mean * counts) / counts.sum(), len(counts), level)
    return Interval(mean, mean - below, mean + above)


def counted_interval(trials: Counted, level: float = LEVEL) -> Interval:
    """Return the mean of trials that count failures, with limits that allow for failures that were not seen.

    No limits with successes in fewer than two worlds.
    """
    worlds = trials.succeeding_worlds
    if worlds < 2:
        return Interval(trials.mean)
    errors = _errors((1.0 - trials.failure_share) * trials.residuals, worlds, level)
    failed = _failure_errors(trials, level)
    joint = _correlation(trials.residuals, trials.failure_residuals)
    below, above = (math.sqrt(a * a + b * b + 2.0 * joint * a * b) for a, b in zip(errors, failed, strict=True))
    return Interval(trials.mean, trials.mean - below, trials.mean + above)


def difference_interval(a: Counted, b: Counted, level: float = LEVEL) -> Interval:
    """Return the mean of A less that of B, trial by trial of the same worlds, with limits as of `counted_interval`.

    The successes' part is paired by world. Failures that come in the same worlds cancel as far as they are seen to.
    """
    difference = a.mean - b.mean
    worlds = min(a.succeeding_worlds, b.succeeding_worlds)
    if worlds < 2:
        return Interval(difference)
    driven = (1.0 - a.failure_share) * a.residuals - (1.0 - b.failure_share) * b.residuals
    errors = _errors(driven, worlds, level)
    (a_below, a_above), (b_below, b_above) = _failure_errors(a, level), _failure_errors(b, level)
    shared = _correlation(a.failure_residuals, b.failure_residuals)
    failed = (
        math.sqrt(max(0.0, one * one + other * other - 2.0 * shared * one * other))
        for one, other in ((a_below, b_above), (a_above, b_below))
    )
    joint = _correlation(driven, a.failure_residuals - b.failure_residuals)
    below, above = (math.sqrt(x * x + y * y + 2.0 * joint * x * y) for x, y in zip(errors, failed, strict=True))
    return Interval(difference, difference - below, difference + above)


def difference_p(a: Counted, b: Counted) -> float:
    """Return the smallest alpha at which the interval of level 1 - alpha leaves out 0; 1 where there is none."""
    if difference_interval(a, b).low is None:
        return 1.0
    low, high = 0.0, 1.0  # of alpha: nothing is left out at 0
    for _ in range(_BISECTIONS):
        middle = 0.5 * (low + high)
        low, high = (low, middle) if difference_interval(a, b, 1.0 - middle).excludes(0.0) else (middle, high)
    return high


def _errors(residuals: Floats, worlds: int, level: float) -> tuple[float, float]:
    """Return how far below and above an estimate its limits are, by what worlds add to its error (m,)."""
    error = math.sqrt(float(residuals @ residuals) * worlds / (worlds - 1))
    quantile = t_quantile(0.5 + level / 2.0, worlds - 1)
    spread = float(residuals @ residuals) / worlds
    skewness = float(np.sum(residuals**3)) / worlds / spread**1.5 if spread > 0.0 else 0.0
    if abs(skewness) < _STRAIGHT:
        return quantile * error, quantile * error

    def untransformed(y: float) -> float:
        """Return the studentised error whose transform is y / sqrt(worlds), times sqrt(worlds)."""
        inner = 1.0 + skewness * (y / math.sqrt(worlds) - skewness / (6.0 * worlds))
        return math.sqrt(worlds) * 3.0 / skewness * (math.copysign(abs(inner) ** (1.0 / 3.0), inner) - 1.0)

    return max(0.0, untransformed(quantile)) * error, max(0.0, -untransformed(-quantile)) * error


def _failure_errors(trials: Counted, level: float) -> tuple[float, float]:
    """Return how far failures may take the mean below and above what it is."""
    found = share(trials.failures, trials.worlds, level)
    assert found.low is not None and found.high is not None  # there are two worlds at least
    fewer, more = trials.cost * (found.estimate - found.low), trials.cost * (found.high - found.estimate)
    return (more, fewer) if trials.cost > 0.0 else (-fewer, -more)


def _correlation(a: Floats, b: Floats) -> float:
    """Return how errors of two parts go together over worlds; 0 where they seem to cancel, which is not relied on."""
    size = math.sqrt(float(a @ a) * float(b @ b))
    return max(0.0, float(a @ b) / size) if size > 0.0 else 0.0
