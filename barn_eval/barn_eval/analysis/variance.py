"""How many worlds and repetitions a wanted precision needs, from trials that are there."""

import math
from collections.abc import Callable
from dataclasses import dataclass

import numpy as np
from scipy import special

from barn_metrics.bootstrap import LEVEL
from barn_worlds.base.arrays import Floats, Integers

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
        return Components(float(np.var(values, ddof=1)) if trials > 1 else math.nan, 0.0)
    within = float(np.sum((values - means[world]) ** 2)) / (trials - groups)
    if groups < 2:
        return Components(math.nan, within)
    mean_square = float(np.sum(counts * (means - np.mean(values)) ** 2)) / (groups - 1)
    size = (trials - float(np.sum(counts**2)) / trials) / (groups - 1)
    return Components(max(0.0, (mean_square - within) / size), within)


def t_quantile(p: float, freedom: int) -> float:
    """Return the p-quantile of Student's distribution with that many degrees of freedom."""
    return float(special.stdtrit(freedom, p))


def half_width(found: Components, worlds: int, repetitions: int, level: float = LEVEL) -> float:
    """Return half the width of the interval of a mean over so many worlds with so many trials each.

    It is of what has been seen, and of failures that could come (Wilson's share).
    """
    if worlds < 2:
        return math.inf
    quantile = t_quantile(0.5 + level / 2.0, worlds - 1)
    share = quantile**2 / (worlds + quantile**2)
    return math.hypot(quantile * found.standard_error(worlds, repetitions), *(cost * share for cost in found.unseen))


def detectable_difference(found: Components, worlds: int, repetitions: int, level: float = LEVEL) -> float:
    """Return the difference that a test at that level finds 8 times in 10."""
    if worlds < 2:
        return math.inf
    by_chance = t_quantile(POWER, worlds - 1) * found.standard_error(worlds, repetitions)
    return half_width(found, worlds, repetitions, level) + by_chance


def worlds_for_half_width(found: Components, wanted: float, repetitions: int) -> int | None:
    """Return the fewest worlds whose interval is no wider than +- `wanted`; None above a million."""
    return _fewest(lambda worlds: half_width(found, worlds, repetitions) <= wanted)


def worlds_for_difference(found: Components, wanted: float, repetitions: int, level: float = LEVEL) -> int | None:
    """Return the fewest worlds in which a difference of `wanted` is found 8 times in 10; None above a million."""
    return _fewest(lambda worlds: detectable_difference(found, worlds, repetitions, level) <= wanted)


def _fewest(enough: Callable[[int], bool]) -> int | None:
    """Return the smallest number from 2 that is enough, where all above it are."""
    if not enough(_MOST_WORLDS):
        return None
    low, high = 1, _MOST_WORLDS
    while high - low > 1:
        middle = (low + high) // 2
        low, high = (low, middle) if enough(middle) else (middle, high)
    return high
