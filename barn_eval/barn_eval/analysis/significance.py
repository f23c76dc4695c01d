"""Shares and differences whose uncertainty respects that trials of one world are alike.

Functions take one value per trial and, beside it, the number of its world. A world is the unit of sampling throughout.
"""

import math
from collections.abc import Sequence
from dataclasses import dataclass
from functools import lru_cache

import numpy as np

from barn_eval.analysis.variance import Components, components, t_quantile
from barn_metrics.bootstrap import LEVEL, Interval, number
from barn_worlds.base.arrays import Floats, Integers

ALPHA = 1.0 - LEVEL  # a difference is clear from this p-value down
FLIPS = 10_000
_ENUMERATED_WORLDS = 13  # up to so many worlds all sign patterns are tried, 8192 at most
_TOLERANCE = 1e-9  # of a sum that is rounded differently for another order of signs


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


def proportion(successes: Integers, worlds: Integers) -> Interval:
    """Return the share of successes (n,), each 0 or 1, with Wilson's interval for the effective number of trials.

    That number is p (1 - p) / v with v the variance of the share as the worlds' own shares show it, at most n; the
    quantile is Student's with one degree of freedom less than worlds (Franco et al. 2019, "Comparative study of
    confidence intervals for proportions in complex sample surveys"). Where all worlds are alike, each counts once.
    """
    if not len(successes):
        return Interval(math.nan)
    p, effective, drawn = effective_trials(successes, worlds)
    return wilson(p, effective, drawn, LEVEL) if drawn > 1 else Interval(p)


def effective_trials(successes: Integers, worlds: Integers) -> tuple[float, float, int]:
    """Return a share of successes (n,), the number of independent trials that would tell it as well, and of worlds."""
    _, world = np.unique(worlds, return_inverse=True)
    p, trials, drawn = float(np.mean(successes)), len(successes), int(world.max()) + 1
    # The variance of a ratio of sums over worlds, by its linearisation.
    residuals = np.bincount(world, successes - p)
    variance = float(residuals @ residuals) * drawn / max(1, drawn - 1) / trials**2
    return p, min(p * (1.0 - p) / variance, trials) if variance > 0.0 else float(drawn), drawn


def wilson(p: float, effective: float, worlds: int, level: float) -> Interval:
    """Return Wilson's interval of a share, by Student's quantile of one degree of freedom less than worlds."""
    z = t_quantile(0.5 + level / 2.0, worlds - 1)
    middle = (p + z * z / (2.0 * effective)) / (1.0 + z * z / effective)
    half = z * math.sqrt(p * (1.0 - p) / effective + (z / (2.0 * effective)) ** 2) / (1.0 + z * z / effective)
    return Interval(p, max(0.0, middle - half), min(1.0, middle + half))


def paired_difference(differences: Floats, worlds: Integers, seed: int = 0, flips: int = FLIPS) -> Difference:
    """Return the mean of paired differences (n,) with an interval and a test that flip the sign of whole worlds.

    If A and B are alike, each world's sum is as likely to have the other sign: the test is exact for any distribution.
    The interval holds the shifts that it does not reject; its limits are quantiles of the larger and the smaller mean
    of the two groups that each pattern of signs makes (Hartigan 1969, "typical values"). flips: how many patterns are
    drawn where there are too many to try all; no p-value is smaller than 1 / (flips + 1).
    """
    if not len(differences):
        return Difference(Interval(math.nan), math.nan, 0, 0, Components(math.nan, math.nan))
    order = np.lexsort((differences, worlds))  # sums must not depend on the order of the trials
    differences, worlds = differences[order], worlds[order]
    numbers, world = np.unique(worlds, return_inverse=True)
    sums, counts = np.bincount(world, differences), np.bincount(world)
    mean = float(sums.sum() / counts.sum())
    signs = _signs(len(numbers), seed, flips)
    flipped, size = signs @ sums, signs @ counts
    total = float(sums.sum())
    reached = np.abs(flipped) >= abs(total) - _TOLERANCE * float(np.abs(sums).sum())
    with np.errstate(divide="ignore", invalid="ignore"):
        groups = np.stack([(total + flipped) / (counts.sum() + size), (total - flipped) / (counts.sum() - size)])
    low = np.where(np.isfinite(groups), groups, -np.inf).min(axis=0)  # a group of none has no mean
    high = np.where(np.isfinite(groups), groups, np.inf).max(axis=0)
    limits = float(np.quantile(low, ALPHA, method="lower")), float(np.quantile(high, LEVEL, method="higher"))
    interval = Interval(mean, *limits) if all(map(math.isfinite, limits)) else Interval(mean)
    return Difference(interval, float(reached.mean()), len(numbers), len(differences), components(differences, worlds))


def holm(p_values: Sequence[float]) -> list[float]:
    """Return p-values adjusted for testing all of them (Holm 1979): the chance of any false alarm stays below each.

    NaN stands for a test that could not be made; it stays NaN and does not count.
    """
    known = [index for index, p in enumerate(p_values) if not math.isnan(p)]
    adjusted = [math.nan] * len(p_values)
    largest = 0.0
    for place, index in enumerate(sorted(known, key=lambda index: p_values[index])):
        largest = max(largest, min(1.0, (len(known) - place) * p_values[index]))
        adjusted[index] = largest
    return adjusted


def p_text(p: float) -> str:
    """Return a p-value as it is written in a sentence."""
    return "p < 0.001" if p < 0.001 else f"p = {number(p, 3)}"


@lru_cache(maxsize=4)
def _signs(worlds: int, seed: int, flips: int) -> Floats:
    """Return patterns of signs (m, worlds), that of the data first: all of them for few worlds, else drawn ones.

    Kept, since all measures of a comparison have the same worlds.
    """
    if worlds <= _ENUMERATED_WORLDS:
        minus = np.arange(2**worlds)[:, None] >> np.arange(worlds) & 1
    else:
        minus = np.random.default_rng(seed).integers(0, 2, (flips + 1, worlds))
        minus[0] = 0
    return np.where(minus == 1, -1.0, 1.0)
