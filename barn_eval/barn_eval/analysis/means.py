"""Means over trials with limits that hold for few worlds, skewed values and rare failures.

A world is the unit of sampling. No interval that is made of what was seen knows of failures that were not drawn. So
where failures count, limits also hold what the mean would be with the share of failures at either of its own limits.
"""

import math
from dataclasses import dataclass, field, replace
from functools import cached_property
from typing import Any

import numpy as np
import numpy.typing as npt

from barn_eval.analysis.significance import Components, Share, components, share_of, t_quantile
from barn_metrics.bootstrap import LEVEL, Interval
from barn_worlds.base.arrays import Floats, Integers

_STRAIGHT = 1e-9  # skewness below which a distribution counts as symmetric


def _none() -> npt.NDArray[Any]:
    return np.empty(0)


@dataclass(frozen=True, eq=False)
class Columns:
    """A measure of some trials.

    values, worlds, repetitions (n,): of each trial. failures (n,): of 0 and 1, as_failure (n,): what each counts with,
    or would, as a failure; empty where failures have no value of their own. best: the best value that there can be.
    """

    values: Floats
    worlds: Integers
    repetitions: Integers
    failures: Integers = field(default_factory=_none)
    as_failure: Floats = field(default_factory=_none)
    best: float = 0.0

    def at(self, places: Integers) -> "Columns":
        """Return the trials at these places."""
        values, worlds, repetitions = self.values[places], self.worlds[places], self.repetitions[places]
        if not self.counted:
            return Columns(values, worlds, repetitions)
        return Columns(values, worlds, repetitions, self.failures[places], self.as_failure[places], self.best)

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
            found = found.reaching(*(found.estimate - trials.cost * (one - share.share) for one in share.limits))
        if found.low is None or found.high is None:
            return found
        low = max(0.0, found.low) if trials.values.min() >= 0.0 else found.low
        return replace(found, low=low, high=min(found.high, self.best) if self.best > 0.0 else found.high)

    def parts(self) -> Components:
        """Return the variance of the values, all of them finite."""
        return replace(components(self.values, self.worlds), unseen=self.unseen)

    def failure_share(self) -> Interval | None:
        """Return the share of failures, None where they have no value of their own."""
        return Interval(self.failures_seen.share, *self.failures_seen.limits) if self.counted else None

    @property
    def unseen(self) -> tuple[float, ...]:
        """What a failure costs, if it counts and none was seen."""
        return (abs(self.cost),) if self.counted and not self.failures.any() else ()

    @cached_property
    def failures_seen(self) -> Share:
        """The share of failures."""
        return share_of(self.failures, self.worlds)

    @cached_property
    def cost(self) -> float:
        """How much a success is worth above a failure: below 0 where small values are better.

        Successes in fewer than two worlds say too little; they are taken to be worth the best value that there can be.
        """
        won = self.failures == 0
        success = float(np.mean(self.values[won])) if len(np.unique(self.worlds[won])) > 1 else self.best
        return success - float(np.mean(self.as_failure))

    def excess(self, other: "Columns") -> Share:
        """Return the share of failures that another has not had in the same worlds, of the same trials."""
        world = np.unique(self.worlds, return_inverse=True)[1]
        more = np.maximum(0.0, np.bincount(world, self.failures - other.failures) / np.bincount(world))
        return share_of(more[world], self.worlds)


def mean_interval(values: Floats, worlds: Integers) -> Interval:
    """Return the mean of values (n,) over worlds with limits; values that are NaN have no part in it.

    Limits are Student's, of the mean's linearisation as a ratio, with Hall's transformation against skewness (1992, "On
    the removal of skewness by transformation").
    """
    known = np.isfinite(values)
    order = np.lexsort((values[known], worlds[known]))  # sums must not depend on the order of the trials
    values, worlds = values[known][order], worlds[known][order]
    _, world = np.unique(worlds, return_inverse=True)
    sums, counts = (np.bincount(world, weights).astype(np.float64) for weights in (values, None))
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
    error, quantile = math.sqrt(spread * worlds / (worlds - 1)), t_quantile(0.5 + LEVEL / 2.0, worlds - 1)
    skewness: float = float(np.sum(residuals**3)) * math.sqrt(worlds) / math.pow(spread, 1.5)
    if abs(skewness) < _STRAIGHT:
        return quantile * error, quantile * error

    def untransformed(y: float) -> float:
        """Return the studentised error of which y is the transform."""
        inner = 1.0 + skewness * (y / math.sqrt(worlds) - skewness / (6.0 * worlds))
        return math.sqrt(worlds) * 3.0 / skewness * (float(np.cbrt(inner)) - 1.0)

    return max(0.0, untransformed(quantile)) * error, max(0.0, -untransformed(-quantile)) * error
