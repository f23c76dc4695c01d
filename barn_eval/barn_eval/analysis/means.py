"""Means over trials and their differences, with limits that hold for few worlds, skewed values and rare failures.

A world is the unit of sampling. A mean of values that count failures has two parts: the mean of the successes, and what
failures take away. No bootstrap sees a failure that was not drawn; so the share of failures has an interval of its own,
above 0 even where none was seen, and the two are put together by the method of variance estimates recovery (MOVER; Zou
and Donner 2008, "Construction of confidence limits about effect measures"; Newcombe 1998 for differences).
"""

import math
from dataclasses import dataclass, field, replace
from functools import cached_property
from typing import Any

import numpy as np
import numpy.typing as npt
from scipy.optimize import brentq

from barn_eval.analysis.significance import Components, components, effective_trials, proportion, t_quantile, wilson
from barn_metrics.bootstrap import LEVEL, Interval
from barn_worlds.base.arrays import Floats, Integers

_STRAIGHT = 1e-9  # skewness below which a distribution counts as symmetric
_SMALLEST_P = 1e-7


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
        ordered = self.at(known[np.lexsort((self.values[known], self.worlds[known]))])
        found = counted_interval(ordered) if ordered.counted else mean_interval(ordered.values, ordered.worlds)
        if found.low is None or found.high is None:
            return found
        low = max(0.0, found.low) if ordered.values.min() >= 0.0 else found.low
        return replace(found, low=low, high=min(found.high, self.best) if self.best > 0.0 else found.high)

    def parts(self) -> Components:
        """Return the variance of the values, all of them finite."""
        return replace(components(self.values, self.worlds), unseen=self.unseen)

    def failure_share(self) -> Interval | None:
        """Return the share of failures, None where they have no value of their own."""
        return proportion(self.failures, self.worlds) if self.counted else None

    @property
    def unseen(self) -> tuple[float, ...]:
        """What a failure costs, if it counts and none was seen."""
        return (abs(self.cost),) if self.counted and not self.failures.any() else ()

    @cached_property
    def _world(self) -> Integers:
        """The position of each trial's world among those that there are (n,)."""
        places: Integers = np.unique(self.worlds, return_inverse=True)[1]
        return places

    @cached_property
    def succeeding_worlds(self) -> int:
        """In how many worlds there is a success."""
        return len(np.unique(self._world[self.failures == 0]))

    @cached_property
    def success_mean(self) -> float:
        """The mean of the successes; the best value where they lie in fewer than two worlds and say too little."""
        return float(np.mean(self.values[self.failures == 0])) if self.succeeding_worlds > 1 else self.best

    @cached_property
    def cost(self) -> float:
        """How much a success is worth above a failure: below 0 where small values are better."""
        return self.success_mean - float(np.mean(self.as_failure))

    @cached_property
    def residuals(self) -> Floats:
        """What the successes of each world add to the error of the mean, by its linearisation as a ratio (m,)."""
        successes = 1.0 - self.failures
        counts = np.bincount(self._world, successes)
        if self.succeeding_worlds < 2:
            return np.zeros(len(counts))
        errors = np.bincount(self._world, successes * self.values) - self.success_mean * counts
        found: Floats = (1.0 - float(np.mean(self.failures))) * errors / counts.sum()
        return found

    @cached_property
    def failure_residuals(self) -> Floats:
        """What the share of failures in each world adds to the error of the mean (m,)."""
        found: Floats = np.bincount(self._world, self.failures - float(np.mean(self.failures))) / len(self.values)
        return -self.cost * found

    @cached_property
    def _effective(self) -> tuple[float, float, int]:
        return effective_trials(self.failures, self.worlds)

    def failure_errors(self, level: float) -> tuple[float, float]:
        """Return how far failures may take the mean below and above what it is; infinite in fewer than two worlds."""
        p, effective, drawn = self._effective
        if drawn < 2:
            return math.inf, math.inf
        found = wilson(p, effective, drawn, level)
        assert found.low is not None and found.high is not None
        fewer, more = self.cost * (found.estimate - found.low), self.cost * (found.high - found.estimate)
        return (more, fewer) if self.cost > 0.0 else (-fewer, -more)


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
    below, above = _errors((sums - mean * counts) / counts.sum(), len(sums), LEVEL)
    return Interval(mean, mean - below, mean + above)


def counted_interval(trials: Columns) -> Interval:
    """Return the mean of trials that count failures, with limits that allow for failures that were not seen."""
    errors = _errors(trials.residuals, trials.succeeding_worlds, LEVEL)
    failed = trials.failure_errors(LEVEL)
    return _joined(
        float(np.mean(trials.values)), errors, failed, _correlation(trials.residuals, trials.failure_residuals)
    )


def difference_interval(a: Columns, b: Columns, level: float = LEVEL) -> Interval:
    """Return the mean of A less that of B, trial by trial of the same worlds, with limits as of `counted_interval`.

    The successes' part is paired by world. Failures that come in the same worlds cancel as far as they are seen to.
    """
    driven = a.residuals - b.residuals
    errors = _errors(driven, min(a.succeeding_worlds, b.succeeding_worlds), level)
    (a_below, a_above), (b_below, b_above) = a.failure_errors(level), b.failure_errors(level)
    shared = _correlation(a.failure_residuals, b.failure_residuals)
    failed = _together(a_below, b_above, -shared), _together(a_above, b_below, -shared)
    joint = _correlation(driven, a.failure_residuals - b.failure_residuals)
    return _joined(float(np.mean(a.values)) - float(np.mean(b.values)), errors, failed, joint)


def difference_p(a: Columns, b: Columns) -> float:
    """Return the smallest alpha at which the interval of level 1 - alpha leaves out 0; 1 where there is none."""

    def beyond(alpha: float) -> float:
        """Return how far the interval lies from 0, below 0 where it holds it."""
        found = difference_interval(a, b, 1.0 - alpha)
        if found.low is None or found.high is None:
            return -1.0
        return max(found.low, -found.high)

    if beyond(1.0) <= 0.0:
        return 1.0
    return _SMALLEST_P if beyond(_SMALLEST_P) > 0.0 else float(brentq(beyond, _SMALLEST_P, 1.0, xtol=_SMALLEST_P))


def _errors(residuals: Floats, worlds: int, level: float) -> tuple[float, float]:
    """Return how far below and above an estimate its limits are, by what worlds add to its error (m,)."""
    spread = float(residuals @ residuals)
    if spread == 0.0:
        return 0.0, 0.0
    if worlds < 2:
        return math.inf, math.inf
    error = math.sqrt(spread * worlds / (worlds - 1))
    quantile = t_quantile(0.5 + level / 2.0, worlds - 1)
    skewness: float = float(np.sum(residuals**3)) * math.sqrt(worlds) / math.pow(spread, 1.5)
    if abs(skewness) < _STRAIGHT:
        return quantile * error, quantile * error

    def untransformed(y: float) -> float:
        """Return the studentised error of which y is the transform."""
        inner = 1.0 + skewness * (y / math.sqrt(worlds) - skewness / (6.0 * worlds))
        return math.sqrt(worlds) * 3.0 / skewness * (float(np.cbrt(inner)) - 1.0)

    return max(0.0, untransformed(quantile)) * error, max(0.0, -untransformed(-quantile)) * error


def _joined(estimate: float, errors: tuple[float, float], others: tuple[float, float], joint: float) -> Interval:
    below, above = (_together(error, other, joint) for error, other in zip(errors, others, strict=True))
    return (
        Interval(estimate, estimate - below, estimate + above) if math.isfinite(below + above) else Interval(estimate)
    )


def _together(error: float, other: float, correlation: float) -> float:
    """Return the size of the sum of two errors."""
    if not (math.isfinite(error) and math.isfinite(other)):
        return math.inf
    return math.sqrt(max(0.0, error * error + other * other + 2.0 * correlation * error * other))


def _correlation(a: Floats, b: Floats) -> float:
    """Return how errors of two parts go together over worlds; 0 where they seem to cancel, which is not relied on."""
    size = math.sqrt(float(a @ a) * float(b @ b))
    return max(0.0, float(a @ b) / size) if size > 0.0 else 0.0
