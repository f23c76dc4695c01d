"""Estimates over worlds with confidence intervals, and their text.

Trials in the same world are not independent of each other. So whole worlds are drawn
with replacement (a cluster bootstrap).
"""

import math
import warnings
from collections.abc import Callable
from dataclasses import dataclass

import numpy as np

from barn_worlds.base.arrays import Floats, Integers

LEVEL = 0.95
RESAMPLES = 10_000

# Takes places of worlds (..., n), from 0, and returns one figure per row (...).
Statistic = Callable[[Integers], Floats]


@dataclass(frozen=True)
class Interval:
    """An estimate and its confidence limits, which are None if data do not suffice."""

    estimate: float
    low: float | None = None
    high: float | None = None

    def widen_to(self, *values: float) -> "Interval":
        """Return a copy with limits widened to hold values; itself if it has none."""
        if self.low is None or self.high is None:
            return self
        return Interval(self.estimate, min(self.low, *values), max(self.high, *values))

    def scale(self, factor: float) -> "Interval":
        """Return estimate and limits times a factor; limits are never swapped."""
        return Interval(
            factor * self.estimate,
            None if self.low is None else factor * self.low,
            None if self.high is None else factor * self.high,
        )

    def negate(self) -> "Interval":
        """Return a copy with the signs of all numbers changed and limits swapped."""
        negative = self.scale(-1.0)
        return Interval(negative.estimate, negative.high, negative.low)

    def columns(self, name: str) -> dict[str, float | None]:
        """Return a dict of NAME, NAME_low and NAME_high; limits may be None."""
        return {name: self.estimate, f"{name}_low": self.low, f"{name}_high": self.high}

    def text(self, digits: int = 2, unit: str = "") -> str:
        """Return text such as "0.51 m [0.40, 0.60]"; without limits, only the estimate.

        Args:
            digits: Decimals of all three numbers.
            unit: Follows the estimate, such as " m".
        """
        text = number(self.estimate, digits) + unit
        if self.low is None or self.high is None:
            return text
        return f"{text} [{number(self.low, digits)}, {number(self.high, digits)}]"


def number(value: float | None, digits: int = 2) -> str:
    """Return a number as text with fixed decimals, "-" for None, NaN and infinity.

    Args:
        value: The number; None, NaN and infinity become a dash.
        digits: Number of decimals.
    """
    if value is None or not math.isfinite(value):
        return "-"
    # Adding 0 turns a negative zero into a positive one.
    return f"{round(value, digits) + 0.0:.{digits}f}"


def bootstrap_interval(
    statistic: Statistic,
    worlds: int,
    seed: int = 0,
    *,
    percentile: bool = False,
    resamples: int = RESAMPLES,
) -> Interval:
    """Return a statistic with 95% bootstrap limits, None if worlds are too alike.

    Args:
        statistic: Function of places of worlds (..., n), 0 to worlds - 1.
        worlds: Number of worlds. One alone has no limits.
        seed: Seed of the draws.
        percentile: Take percentiles of the draws and leave out those without a figure
            (NaN). By default limits are bias-corrected and accelerated (BCa, Efron
            1987); there are none if a draw has no figure.
        resamples: Number of draws.
    """
    all_worlds = np.arange(worlds)
    estimate = float(statistic(all_worlds))
    if worlds < 2:
        return Interval(estimate)

    # Importing it takes a second, which runs in one world need not wait for.
    from scipy import stats  # noqa: PLC0415

    with warnings.catch_warnings(), np.errstate(invalid="ignore", divide="ignore"):
        # Worlds that are all alike are handled below.
        warnings.simplefilter("ignore", stats.DegenerateDataWarning)
        result = stats.bootstrap(
            (all_worlds,),
            lambda rows, axis: statistic(rows),  # noqa: ARG005 (always the last axis)
            n_resamples=resamples,
            batch=500,
            vectorized=True,
            confidence_level=LEVEL,
            method="percentile" if percentile else "BCa",
            random_state=np.random.default_rng(seed),
        )

    draws = result.bootstrap_distribution
    limits = tuple(result.confidence_interval)
    if percentile:
        # SciPy takes percentiles of all draws, which NaN would spoil.
        draws = draws[np.isfinite(draws)]
        quantiles = [(1.0 - LEVEL) / 2.0, (1.0 + LEVEL) / 2.0]
        limits = np.quantile(draws, quantiles) if len(draws) else (math.nan, math.nan)

    # Draws that are all alike do not show how wide an interval must be.
    if np.isfinite(limits).all() and np.ptp(limits) > 0.0:
        return Interval(estimate, *map(float, limits))
    return Interval(estimate)


def spearman(a: Floats | Integers, b: Floats | Integers) -> Floats:
    """Return Spearman's correlation, last axis, NaN if constant; integers must be >= 0.

    Args:
        a: Values (..., n).
        b: Values of the same shape.
    """
    return correlation(_ranks(a), _ranks(b))


def correlation(a: Floats, b: Floats) -> Floats:
    """Return Pearson's correlation along the last axis, NaN where a side is constant.

    Args:
        a: Values (..., n).
        b: Values of the same shape.
    """
    a = a - a.mean(axis=-1, keepdims=True)
    b = b - b.mean(axis=-1, keepdims=True)
    scale = np.sqrt((a**2).sum(axis=-1) * (b**2).sum(axis=-1))
    coefficients: Floats = (a * b).sum(axis=-1) / np.where(scale > 1e-12, scale, np.nan)
    return coefficients


def _ranks(values: Floats | Integers) -> Floats:
    """Return average ranks along the last axis, up to a shift; integers must be >= 0.

    Whole numbers from 0 are ranked by counting, which is much faster than sorting.
    """
    if values.dtype != np.int64:
        from scipy import stats  # noqa: PLC0415 (as above)

        ranks: Floats = stats.rankdata(values, axis=-1)
        return ranks

    rows = values.reshape(-1, values.shape[-1])
    kinds = int(rows.max()) + 1
    # All rows are counted at once: each has counters of its own.
    first_counters = kinds * np.arange(len(rows))
    counters = rows + first_counters[:, None]
    counts = np.bincount(counters.ravel(), minlength=kinds * len(rows))
    counts = counts.reshape(len(rows), kinds)
    # The middle of the ranks that equal values share.
    rank_by_value = np.cumsum(counts, axis=1) - counts / 2.0
    ranks = rank_by_value.ravel()[counters]
    return ranks.reshape(values.shape)
