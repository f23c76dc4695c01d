"""Shares and differences whose uncertainty allows for similar trials within a world.

Functions take one value per trial and the number of its world. A world is the unit of
sampling throughout.
"""

import math
from bisect import bisect_left
from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace
from functools import lru_cache

import numpy as np
import scipy

from barn_metrics.bootstrap import LEVEL, Interval, number
from barn_worlds.base.arrays import Floats, Integers

# A difference is significant if its p-value is at most this.
ALPHA = 1.0 - LEVEL
POWER = 0.8
FLIPS = 10_000

# Up to this number of worlds, a test tries all sign patterns, at most 8192.
_MAX_ENUMERATED_WORLDS = 13
# Relative difference that rounding may cause between orders of summation.
_ROUNDING = 1e-9
# Fewer worlds say too little about how similar the trials of a world are.
_MIN_INFORMATIVE_WORLDS = 3
_MAX_WORLDS = 1_000_000
_HIGH_SHARE = 0.97


@dataclass(frozen=True)
class Components:
    """Variance of a figure or of a paired difference, between and within worlds."""

    between: float
    """Variance between worlds."""

    within: float
    """Variance between the trials of a world."""

    unseen: tuple[float, ...] = ()
    """Cost of a failure for each planner that has not failed, or has always failed, yet.

    The variance does not include what has not occurred.
    """

    def standard_error(self, worlds: int, repetitions: int) -> float:
        """Return the standard error of a mean over `worlds` * `repetitions` trials.

        Args:
            worlds: Number of worlds.
            repetitions: Number of trials in each world.
        """
        return math.sqrt((self.between + self.within / repetitions) / worlds)


def variance_components(values: Floats, worlds: Integers) -> Components:
    """Return variances between worlds (NaN for one world) and within, by ANOVA.

    With one trial per world, all variance counts as variance between worlds.

    Args:
        values: One value per trial (n,).
        worlds: Number of each trial's world (n,); worlds may differ in trials.
    """
    _, world = np.unique(worlds, return_inverse=True)
    counts = np.bincount(world)
    trials = len(values)
    groups = len(counts)
    means = np.bincount(world, values) / counts

    # One trial per world shows no variance within. Counting all as variance between
    # worlds is right for a mean over worlds.
    if trials == groups:
        variance = float(np.var(values, ddof=1)) if trials > 1 else math.nan
        return Components(variance, 0.0)
    within = float(np.sum((values - means[world]) ** 2)) / (trials - groups)
    if groups < 2:
        return Components(math.nan, within)

    deviations = (means - np.mean(values)) ** 2
    mean_square = float(np.sum(counts * deviations)) / (groups - 1)
    # The effective number of trials per world if worlds differ in trials.
    size = (trials - float(np.sum(counts**2)) / trials) / (groups - 1)
    # By chance, the estimate may be negative, but a variance cannot.
    return Components(max(0.0, (mean_square - within) / size), within)


def t_quantile(p: float, freedom: int) -> float:
    """Return the quantile of Student's t at probability `p`.

    Args:
        p: Probability below the quantile.
        freedom: Degrees of freedom.
    """
    return float(scipy.special.stdtrit(freedom, p))


@dataclass(frozen=True)
class Difference:
    """A mean paired difference A - B."""

    interval: Interval
    """The difference; its limits are None if there are too few worlds for any."""

    p: float
    """Two-sided p-value if A and B were equal; NaN without data."""

    worlds: int
    """Number of worlds in which both have a value."""

    trials: int
    parts: Components

    def negate(self) -> "Difference":
        """Return the difference B - A, with the same p-value."""
        return replace(self, interval=self.interval.negate())


@dataclass(frozen=True)
class Share:
    """A share of trials, and its effective number of independent trials."""

    share: float
    effective: float

    @property
    def limits(self) -> tuple[float, float]:
        """Lower and upper 95% limits (Clopper and Pearson 1934)."""
        successes = self.share * self.effective
        failures = self.effective - successes
        low = 0.0
        if self.share > 0.0:
            # Beta quantiles also accept fractional numbers of trials.
            low = scipy.special.betaincinv(successes, failures + 1.0, ALPHA / 2.0)
        high = 1.0
        if self.share < 1.0:
            high = scipy.special.betaincinv(
                successes + 1.0, failures, 1.0 - ALPHA / 2.0
            )
        return float(low), float(high)

    def p_above(self, share: float) -> float:
        """Return the two-sided p-value if the true share were `share`, a larger one."""
        if share >= 1.0:
            return 0.0
        successes = self.share * self.effective
        failures = self.effective - successes
        return min(
            1.0, 2.0 * float(scipy.special.betaincc(successes + 1.0, failures, share))
        )


def share_of(values: Floats | Integers, worlds: Integers) -> Share:
    """Return the mean of values in 0 to 1 with its effective number of trials.

    If fewer than three worlds have a value above 0, they say little about how similar
    the trials of a world are, and each world counts as one trial.

    Args:
        values: One value per trial (n,), such as 1 for a failure.
        worlds: Number of each trial's world (n,).
    """
    mean, effective, world_count = effective_trials(values, worlds)
    # With one or two failures, the variance over worlds is nearly 0 by chance, and the
    # effective number would be far too large.
    informative_worlds = len(np.unique(worlds[values > 0.0]))
    if informative_worlds < _MIN_INFORMATIVE_WORLDS:
        return Share(mean, float(world_count))
    return Share(mean, max(1.0, effective))


def proportion(successes: Integers, worlds: Integers) -> Interval:
    """Return the share of 1s and Wilson's 95% limits, which are None below two worlds.

    The quantile is Student's with one degree of freedom fewer than worlds (Franco et
    al. 2019, "Comparative study of confidence intervals for proportions in complex
    sample surveys"). If all worlds have the same share, each counts as one trial. Above
    0.97, Clopper's and Pearson's interval is used if it is wider.

    Args:
        successes: 1 for each trial that succeeded, else 0 (n,).
        worlds: Number of each trial's world (n,).
    """
    if not len(successes):
        return Interval(math.nan)
    p, effective, world_count = effective_trials(successes, worlds)
    if world_count < 2:
        return Interval(p)

    # Unlike Wald's, Wilson's interval has a width at 0 and 1, where good planners are.
    z = t_quantile(0.5 + LEVEL / 2.0, world_count - 1)
    scale = 1.0 + z * z / effective
    middle = (p + z * z / (2.0 * effective)) / scale
    variance = p * (1.0 - p) / effective + (z / (2.0 * effective)) ** 2
    half = z * math.sqrt(variance) / scale
    interval = Interval(p, max(0.0, min(p, middle - half)), min(1.0, middle + half))
    # Near 1, Wilson's covers too little; Clopper and Pearson's never does.
    if p > _HIGH_SHARE:
        low, high = share_of(1 - successes, worlds).limits
        return interval.widen_to(1.0 - high, 1.0 - low)
    return interval


def effective_trials(
    values: Floats | Integers, worlds: Integers
) -> tuple[float, float, int]:
    """Return (share, effective number of independent trials, number of worlds).

    The effective number is p (1 - p) / v, at most n, where v is the variance of the
    share, estimated from the worlds' shares. If all worlds have the same share, it is
    the number of worlds.

    Args:
        values: One value from 0 to 1 per trial (n,).
        worlds: Number of each trial's world (n,).
    """
    _, world = np.unique(worlds, return_inverse=True)
    p = float(np.mean(values))
    trials = len(values)
    world_count = int(world.max()) + 1

    # The variance of a ratio of sums over worlds, by its linearization.
    residuals = np.bincount(world, values - p)
    variance = float(residuals @ residuals) * world_count
    variance = variance / max(1, world_count - 1) / trials**2
    if variance <= 0.0:
        # If all worlds agree, nothing shows that their trials are independent.
        return p, float(world_count), world_count
    return p, min(p * (1.0 - p) / variance, trials), world_count


def paired_difference(
    differences: Floats, worlds: Integers, flips: int = FLIPS
) -> Difference:
    """Return the mean of A - B, its limits (None for few worlds), and p by sign flips.

    If A and B are equal, the sum of each world has either sign with equal probability,
    so the test is exact for any distribution. The interval holds the shifts that the
    test does not reject: its limits are quantiles of the larger and the smaller mean of
    the two groups into which a pattern of signs divides the worlds (Hartigan 1969,
    "Using subsample values as typical values").

    Args:
        differences: Value of A minus value of B for each pair of trials (n,).
        worlds: Number of each pair's world (n,).
        flips: Number of patterns if there are too many worlds to try all. No p-value is
            then below 1 / (flips + 1).
    """
    if not len(differences):
        nothing = Components(math.nan, math.nan)
        return Difference(Interval(math.nan), math.nan, 0, 0, nothing)

    # Sums must not depend on the order of the trials.
    order = np.lexsort((differences, worlds))
    differences = differences[order]
    worlds = worlds[order]
    world_numbers, world = np.unique(worlds, return_inverse=True)
    sums = np.bincount(world, differences)
    counts = np.bincount(world)
    mean = float(sums.sum() / counts.sum())
    total = float(sums.sum())

    signs = sign_patterns(len(world_numbers), flips)
    # One product for sums and counts, because the patterns are the largest array.
    flipped_sums, flipped_counts = (signs @ np.stack([sums, counts], axis=1)).T
    threshold = abs(total) - _ROUNDING * float(np.abs(sums).sum())
    # The patterns include that of the data, so no p-value is 0 (Phipson and Smyth
    # 2010).
    p = float((np.abs(flipped_sums) >= threshold).mean())

    with np.errstate(divide="ignore", invalid="ignore"):
        plus_means = (total + flipped_sums) / (counts.sum() + flipped_counts)
        minus_means = (total - flipped_sums) / (counts.sum() - flipped_counts)
    means = np.stack([plus_means, minus_means])
    # A group without worlds has no mean.
    is_mean = np.isfinite(means)
    smaller_means = np.where(is_mean, means, -np.inf).min(axis=0)
    larger_means = np.where(is_mean, means, np.inf).max(axis=0)
    # Quantiles are not interpolated, so that test and interval agree on whether 0 is
    # possible.
    low = float(np.quantile(smaller_means, ALPHA, method="lower"))
    high = float(np.quantile(larger_means, LEVEL, method="higher"))
    interval = Interval(mean)
    if math.isfinite(low) and math.isfinite(high):
        interval = Interval(mean, low, high)

    parts = variance_components(differences, worlds)
    return Difference(interval, p, len(world_numbers), len(differences), parts)


def holm(p_values: Sequence[float]) -> list[float]:
    """Return p-values adjusted for testing all of them (Holm 1979), in the same order.

    NaN stands for a test that could not be made; it stays NaN and does not count.
    """
    p: Floats = np.array(p_values, np.float64)
    tests = int(np.count_nonzero(~np.isnan(p)))
    # NaN comes last in this order.
    order = np.argsort(p, kind="stable")[:tests]
    # Holm's correction is as safe as Bonferroni's under any dependence, but more powerful.
    scaled = np.minimum(1.0, np.arange(tests, 0, -1) * p[order])
    # A larger p-value must not have a smaller adjusted one.
    p[order] = np.maximum.accumulate(scaled)
    return [float(value) for value in p]


def p_text(p: float) -> str:
    """Return a p-value as text, such as "p = 0.021" or "p < 0.001"."""
    return "p < 0.001" if p < 0.001 else f"p = {number(p, 3)}"


@lru_cache(maxsize=4)
def sign_patterns(worlds: int, flips: int) -> Floats:
    """Return cached sign patterns (m, worlds), all up to 13 worlds; the first is all +1.

    The patterns are cached, because all measures of a comparison have the same worlds.

    Args:
        worlds: Number of worlds. Up to 13, all patterns are returned.
        flips: Number of random patterns besides the first.
    """
    if worlds <= _MAX_ENUMERATED_WORLDS:
        minus = np.arange(2**worlds)[:, None] >> np.arange(worlds) & 1
    else:
        # Always the same patterns, so that equal results have equal p-values.
        minus = np.random.default_rng(0).integers(0, 2, (flips + 1, worlds))
        minus[0] = 0
    return np.where(minus == 1, -1.0, 1.0)


def half_width(
    parts: Components, worlds: int, repetitions: int, level: float = LEVEL
) -> float:
    """Return half the width of an interval, wider for unseen failures; inf below 2 worlds.

    The width follows from the variance or, if that is wider, from failures that may
    still occur.

    Args:
        parts: Variance of one value.
        worlds: Number of worlds that the mean is over.
        repetitions: Number of trials in each world.
        level: Coverage of the interval.
    """
    if worlds < 2:
        return math.inf
    quantile = t_quantile(0.5 + level / 2.0, worlds - 1)
    by_variance = quantile * parts.standard_error(worlds, repetitions)
    # Failures that did not occur yet may still have this share of the trials.
    unseen_share = Share(0.0, worlds).limits[1]
    return max(by_variance, *(cost * unseen_share for cost in parts.unseen), 0.0)


def detectable_difference(
    parts: Components, worlds: int, repetitions: int, level: float = LEVEL
) -> float:
    """Return the difference that is detected with power 0.8; infinite below two worlds.

    Args:
        parts: Variance of one paired difference.
        worlds: Number of worlds.
        repetitions: Number of trials in each world.
        level: 1 minus the error of the test.
    """
    if worlds < 2:
        return math.inf
    error = parts.standard_error(worlds, repetitions)
    # The difference itself scatters, and must exceed the limit in 8 of 10 runs.
    by_chance = t_quantile(POWER, worlds - 1) * error
    return half_width(parts, worlds, repetitions, level) + by_chance


def worlds_for_half_width(
    parts: Components, width: float, repetitions: int
) -> int | None:
    """Return the fewest worlds with a half-width of at most `width`; None above 1e6.

    Args:
        parts: Variance of one value.
        width: Half the width that the interval may have.
        repetitions: Number of trials in each world.
    """
    return _fewest_worlds(
        lambda worlds: half_width(parts, worlds, repetitions) <= width
    )


def worlds_for_difference(
    parts: Components, size: float, repetitions: int, level: float = LEVEL
) -> int | None:
    """Return the fewest worlds to detect `size` with power 0.8; None above a million.

    Args:
        parts: Variance of one paired difference.
        size: The difference.
        repetitions: Number of trials in each world.
        level: 1 minus the error of the test.
    """
    return _fewest_worlds(
        lambda worlds: detectable_difference(parts, worlds, repetitions, level) <= size
    )


def _fewest_worlds(suffice: Callable[[int], bool]) -> int | None:
    """Return the least number from 2 to a million for which `suffice` is true, or None.

    `suffice` must stay true from that number on.
    """
    candidates = range(2, _MAX_WORLDS + 1)
    # bisect finds the first True, as False sorts before it.
    position = bisect_left(candidates, True, key=suffice)
    return candidates[position] if position < len(candidates) else None
