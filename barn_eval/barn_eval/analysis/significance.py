"""Shares and differences whose uncertainty respects that trials of one world are alike.

Functions take one value per trial and, beside it, the number of its world. A world is the unit of sampling throughout.
"""

import math
from bisect import bisect_left
from collections.abc import Callable, Sequence
from dataclasses import dataclass
from functools import lru_cache

import numpy as np
from scipy import special

from barn_metrics.bootstrap import LEVEL, Interval, number
from barn_worlds.base.arrays import Floats, Integers

ALPHA = 1.0 - LEVEL  # a difference is clear from this p-value down
FLIPS = 10_000
_ENUMERATED_WORLDS = (
    13  # up to so many worlds all sign patterns are tried, 8192 at most
)
_TOLERANCE = 1e-9  # of a sum that is rounded differently for another order of signs
_TELLING_WORLDS = 3
POWER = 0.8
_MOST_WORLDS = 1_000_000


@dataclass(frozen=True)
class Components:
    """Variance of a figure, or of a paired difference, between worlds and between the trials of a world.

    unseen: what a failure costs of each planner that has not failed so far, of which the variance knows nothing.
    """

    between: float
    within: float
    unseen: tuple[float, ...] = ()

    def standard_error(self, worlds: int, repetitions: int) -> float:
        """Return the standard error of the mean over so many worlds with so many trials each."""
        return math.sqrt((self.between + self.within / repetitions) / worlds)


def components(values: Floats, worlds: Integers) -> Components:
    """Return the components of variance of one value per trial (n,) by the analysis of variance (Searle 1971).

    Worlds may have different numbers of trials. With one trial a world all variance counts as that between worlds.
    """
    _, world = np.unique(worlds, return_inverse=True)
    counts = np.bincount(world)
    trials, groups = len(values), len(counts)
    means = np.bincount(world, values) / counts
    if trials == groups:
        return Components(
            float(np.var(values, ddof=1)) if trials > 1 else math.nan, 0.0
        )
    within = float(np.sum((values - means[world]) ** 2)) / (trials - groups)
    if groups < 2:
        return Components(math.nan, within)
    mean_square = float(np.sum(counts * (means - np.mean(values)) ** 2)) / (groups - 1)
    size = (trials - float(np.sum(counts**2)) / trials) / (groups - 1)
    return Components(max(0.0, (mean_square - within) / size), within)


def t_quantile(p: float, freedom: int) -> float:
    """Return the p-quantile of Student's distribution with that many degrees of freedom."""
    return float(special.stdtrit(freedom, p))


@dataclass(frozen=True)
class Difference:
    """A mean paired difference A - B.

    interval: of the difference, None limits where there are too few worlds for any. p: two-sided probability of a mean
    as far from 0 if the two were alike, NaN without data. worlds: that both have a value in. parts: its variance.
    """

    interval: Interval
    p: float
    worlds: int
    trials: int
    parts: Components


@dataclass(frozen=True)
class Share:
    """A share of trials, and the number of independent trials that would tell it as well."""

    share: float
    effective: float

    @property
    def limits(self) -> tuple[float, float]:
        """The 95 % interval of Clopper and Pearson (1934)."""
        p, n = self.share, self.effective
        low = (
            float(special.betaincinv(p * n, n - p * n + 1.0, ALPHA / 2.0))
            if p > 0.0
            else 0.0
        )
        return low, upper_share(p, n)

    def p_above(self, share: float) -> float:
        """Return the two-sided p-value of a true share that is above this one."""
        if share >= 1.0:
            return 0.0
        seen = self.share * self.effective
        return min(
            1.0, 2.0 * float(special.betaincc(seen + 1.0, self.effective - seen, share))
        )


def upper_share(share: float, effective: float) -> float:
    """Return the upper limit of a share of so many independent trials."""
    seen = share * effective
    return (
        float(special.betaincinv(seen + 1.0, effective - seen, 1.0 - ALPHA / 2.0))
        if share < 1.0
        else 1.0
    )


def share_of(values: Floats | Integers, worlds: Integers) -> Share:
    """Return the mean of values (n,) in 0 to 1 as a share.

    Where fewer than three worlds have any, they tell little of how alike trials of a world are: each world then counts
    as one trial.
    """
    p, effective, drawn = effective_trials(values, worlds)
    few = len(np.unique(worlds[values > 0.0])) < _TELLING_WORLDS
    return Share(p, float(drawn) if few else max(1.0, effective))


def proportion(successes: Integers, worlds: Integers) -> Interval:
    """Return the share of successes (n,), each 0 or 1, with Wilson's interval for the effective number of trials.

    The quantile is Student's with one degree of freedom less than worlds (Franco et al. 2019, "Comparative study of
    confidence intervals for proportions in complex sample surveys"). Where all worlds are alike, each counts once.
    """
    if not len(successes):
        return Interval(math.nan)
    p, effective, drawn = effective_trials(successes, worlds)
    if drawn < 2:
        return Interval(p)
    z = t_quantile(0.5 + LEVEL / 2.0, drawn - 1)
    middle = (p + z * z / (2.0 * effective)) / (1.0 + z * z / effective)
    half = (
        z
        * math.sqrt(p * (1.0 - p) / effective + (z / (2.0 * effective)) ** 2)
        / (1.0 + z * z / effective)
    )
    return Interval(p, max(0.0, middle - half), min(1.0, middle + half))


def effective_trials(
    values: Floats | Integers, worlds: Integers
) -> tuple[float, float, int]:
    """Return a share (n,), the number of independent trials that would tell it as well, and of worlds.

    That number is p (1 - p) / v with v the variance of the share as the worlds' own shares show it, at most n.
    """
    _, world = np.unique(worlds, return_inverse=True)
    p, trials, drawn = float(np.mean(values)), len(values), int(world.max()) + 1
    # The variance of a ratio of sums over worlds, by its linearisation.
    residuals = np.bincount(world, values - p)
    variance = float(residuals @ residuals) * drawn / max(1, drawn - 1) / trials**2
    return (
        p,
        min(p * (1.0 - p) / variance, trials) if variance > 0.0 else float(drawn),
        drawn,
    )


def paired_difference(
    differences: Floats, worlds: Integers, seed: int = 0, flips: int = FLIPS
) -> Difference:
    """Return the mean of paired differences (n,) with an interval and a test that flip the sign of whole worlds.

    If A and B are alike, each world's sum is as likely to have the other sign: the test is exact for any distribution.
    The interval holds the shifts that it does not reject; its limits are quantiles of the larger and the smaller mean
    of the two groups that each pattern of signs makes (Hartigan 1969, "typical values"). flips: how many patterns are
    drawn where there are too many to try all; no p-value is smaller than 1 / (flips + 1).
    """
    if not len(differences):
        return Difference(
            Interval(math.nan), math.nan, 0, 0, Components(math.nan, math.nan)
        )
    order = np.lexsort(
        (differences, worlds)
    )  # sums must not depend on the order of the trials
    differences, worlds = differences[order], worlds[order]
    numbers, world = np.unique(worlds, return_inverse=True)
    sums, counts = np.bincount(world, differences), np.bincount(world)
    mean = float(sums.sum() / counts.sum())
    signs = sign_patterns(len(numbers), seed, flips)
    flipped, size = (signs @ np.stack([sums, counts], axis=1)).T
    total = float(sums.sum())
    reached = np.abs(flipped) >= abs(total) - _TOLERANCE * float(np.abs(sums).sum())
    with np.errstate(divide="ignore", invalid="ignore"):
        groups = np.stack(
            [
                (total + flipped) / (counts.sum() + size),
                (total - flipped) / (counts.sum() - size),
            ]
        )
    low = np.where(np.isfinite(groups), groups, -np.inf).min(
        axis=0
    )  # a group of none has no mean
    high = np.where(np.isfinite(groups), groups, np.inf).max(axis=0)
    limits = (
        float(np.quantile(low, ALPHA, method="lower")),
        float(np.quantile(high, LEVEL, method="higher")),
    )
    interval = (
        Interval(mean, *limits) if all(map(math.isfinite, limits)) else Interval(mean)
    )
    return Difference(
        interval,
        float(reached.mean()),
        len(numbers),
        len(differences),
        components(differences, worlds),
    )


def holm(p_values: Sequence[float]) -> list[float]:
    """Return p-values adjusted for testing all of them (Holm 1979): the chance of any false alarm stays below each.

    NaN stands for a test that could not be made; it stays NaN and does not count.
    """
    p: Floats = np.array(p_values, np.float64)
    order = np.argsort(p, kind="stable")[
        : np.count_nonzero(~np.isnan(p))
    ]  # NaN comes last
    p[order] = np.maximum.accumulate(
        np.minimum(1.0, np.arange(len(order), 0, -1) * p[order])
    )
    return list(map(float, p))


def p_text(p: float) -> str:
    """Return a p-value as it is written in a sentence."""
    return "p < 0.001" if p < 0.001 else f"p = {number(p, 3)}"


@lru_cache(maxsize=4)
def sign_patterns(worlds: int, seed: int, flips: int) -> Floats:
    """Return patterns of signs (m, worlds), that of the data first: all of them for few worlds, else drawn ones.

    Kept, since all measures of a comparison have the same worlds.
    """
    if worlds <= _ENUMERATED_WORLDS:
        minus = np.arange(2**worlds)[:, None] >> np.arange(worlds) & 1
    else:
        minus = np.random.default_rng(seed).integers(0, 2, (flips + 1, worlds))
        minus[0] = 0
    return np.where(minus == 1, -1.0, 1.0)


def half_width(
    found: Components, worlds: int, repetitions: int, level: float = LEVEL
) -> float:
    """Return half the width of the interval of a mean over so many worlds with so many trials each.

    It is of what has been seen, or of failures that could come if that is more.
    """
    if worlds < 2:
        return math.inf
    seen = t_quantile(0.5 + level / 2.0, worlds - 1) * found.standard_error(
        worlds, repetitions
    )
    return max(seen, *(cost * upper_share(0.0, worlds) for cost in found.unseen), 0.0)


def detectable_difference(
    found: Components, worlds: int, repetitions: int, level: float = LEVEL
) -> float:
    """Return the difference that a test at that level finds 8 times in 10."""
    if worlds < 2:
        return math.inf
    by_chance = t_quantile(POWER, worlds - 1) * found.standard_error(
        worlds, repetitions
    )
    return half_width(found, worlds, repetitions, level) + by_chance


def worlds_for_half_width(
    found: Components, wanted: float, repetitions: int
) -> int | None:
    """Return the fewest worlds whose interval is no wider than +- `wanted`; None above a million."""
    return _fewest(lambda worlds: half_width(found, worlds, repetitions) <= wanted)


def worlds_for_difference(
    found: Components, wanted: float, repetitions: int, level: float = LEVEL
) -> int | None:
    """Return the fewest worlds in which a difference of `wanted` is found 8 times in 10; None above a million."""
    return _fewest(
        lambda worlds: (
            detectable_difference(found, worlds, repetitions, level) <= wanted
        )
    )


def _fewest(enough: Callable[[int], bool]) -> int | None:
    """Return the smallest number from 2 that is enough, where all above it are."""
    numbers = range(2, _MOST_WORLDS + 1)
    place = bisect_left(numbers, True, key=enough)
    return numbers[place] if place < len(numbers) else None
