"""Estimates over worlds with confidence intervals, and how they are written.

Trials of one world are not independent of each other, so whole worlds are drawn with replacement (a cluster bootstrap).
"""

import math
import warnings
from collections.abc import Callable
from dataclasses import dataclass

import numpy as np

from barn_worlds.base.arrays import Floats, Integers

LEVEL = 0.95
RESAMPLES = 10_000

Statistic = Callable[[Integers], Floats]


@dataclass(frozen=True)
class Interval:
    """An estimate and its confidence limits; limits are None where there is too little to give any."""

    estimate: float
    low: float | None = None
    high: float | None = None

    def excludes(self, value: float) -> bool:
        """Tell whether there are limits and a value lies outside them."""
        return (
            self.low is not None
            and self.high is not None
            and not self.low <= value <= self.high
        )

    def widen_to(self, *values: float) -> "Interval":
        """Return the estimate with limits that hold these values as well, none where it has none."""
        if self.low is None or self.high is None:
            return self
        return Interval(self.estimate, min(self.low, *values), max(self.high, *values))

    def scale(self, factor: float) -> "Interval":
        """Return the interval in another unit; factor is above 0."""
        low, high = (
            None if limit is None else factor * limit for limit in (self.low, self.high)
        )
        return Interval(factor * self.estimate, low, high)

    def columns(self, name: str) -> dict[str, float | None]:
        """Return estimate and limits as columns of a table: NAME, NAME_low and NAME_high."""
        return {name: self.estimate, f"{name}_low": self.low, f"{name}_high": self.high}

    def shift(self, by: float) -> "Interval":
        """Return the interval of the estimate and a known figure together."""
        low, high = (
            None if limit is None else limit + by for limit in (self.low, self.high)
        )
        return Interval(self.estimate + by, low, high)

    def negate(self) -> "Interval":
        """Return the interval of the estimate with the other sign."""
        low, high = (
            None if limit is None else -limit for limit in (self.high, self.low)
        )
        return Interval(-self.estimate, low, high)

    def text(self, digits: int = 2, unit: str = "") -> str:
        """Return the estimate, a unit if given, and the limits in brackets, such as "0.51 m [0.40, 0.60]"."""
        text = number(self.estimate, digits) + unit
        if self.low is None or self.high is None:
            return text
        return f"{text} [{number(self.low, digits)}, {number(self.high, digits)}]"


def number(value: float | None, digits: int = 2) -> str:
    """Return a number, zero without a sign; a dash for None, NaN and infinity."""
    return (
        "-"
        if value is None or not math.isfinite(value)
        else f"{round(value, digits) + 0.0:.{digits}f}"
    )


def bootstrap_interval(
    statistic: Statistic,
    worlds: int,
    seed: int = 0,
    *,
    percentile: bool = False,
    resamples: int = RESAMPLES,
) -> Interval:
    """Return a statistic of worlds with its bootstrap interval.

    statistic: takes positions of worlds (..., n), 0 to worlds - 1, and returns one figure per row (...). BCa intervals
    are bias-corrected and accelerated (Efron 1987); they have no limits where a draw has no figure (NaN). Percentile
    intervals leave such draws out.
    """
    every = np.arange(worlds)
    estimate = float(statistic(every))
    if worlds < 2:
        return Interval(estimate)
    from scipy import stats  # noqa: PLC0415 (takes a second, which runs in one world need not wait for)

    with warnings.catch_warnings(), np.errstate(invalid="ignore", divide="ignore"):
        warnings.simplefilter(
            "ignore", stats.DegenerateDataWarning
        )  # all worlds alike: handled below
        found = stats.bootstrap(
            (every,),
            lambda drawn, axis: statistic(drawn),  # noqa: ARG005 (worlds are along the last axis)
            n_resamples=resamples,
            batch=500,
            vectorized=True,
            confidence_level=LEVEL,
            method="percentile" if percentile else "BCa",
            random_state=np.random.default_rng(seed),
        )
    drawn = found.bootstrap_distribution
    limits = tuple(found.confidence_interval)
    if percentile:
        drawn = drawn[np.isfinite(drawn)]
        limits = (
            np.quantile(drawn, [(1.0 - LEVEL) / 2.0, (1.0 + LEVEL) / 2.0])
            if len(drawn)
            else (math.nan, math.nan)
        )
    if np.isfinite(limits).all():
        return Interval(estimate, *map(float, limits))
    return (
        Interval(estimate, estimate, estimate)
        if len(drawn) and np.ptp(drawn) == 0.0
        else Interval(estimate)
    )


def spearman(a: Floats | Integers, b: Floats | Integers) -> Floats:
    """Return the rank correlation along the last axis, NaN where one side does not vary."""
    return correlation(_ranks(a), _ranks(b))


def correlation(a: Floats, b: Floats) -> Floats:
    """Return the correlation along the last axis, NaN where one side does not vary."""
    a, b = (one - one.mean(axis=-1, keepdims=True) for one in (a, b))
    scale = np.sqrt((a**2).sum(axis=-1) * (b**2).sum(axis=-1))
    found: Floats = (a * b).sum(axis=-1) / np.where(scale > 1e-12, scale, np.nan)
    return found


def _ranks(values: Floats | Integers) -> Floats:
    """Return average ranks along the last axis, but for a constant; of whole numbers from 0 on by counting, quickly."""
    if values.dtype != np.int64:
        from scipy import stats  # noqa: PLC0415 (as above)

        found: Floats = stats.rankdata(values, axis=-1)
        return found
    rows = values.reshape(-1, values.shape[-1])
    kinds = int(rows.max()) + 1
    places = rows + kinds * np.arange(len(rows))[:, None]
    counts = np.bincount(places.ravel(), minlength=kinds * len(rows)).reshape(
        len(rows), kinds
    )
    ranks = np.cumsum(counts, axis=1) - counts / 2.0
    by_place: Floats = ranks.ravel()[places]
    return by_place.reshape(values.shape)
