"""Deviations, lines and rank correlations of trials, with percentile intervals over worlds.

Slopes and deviations of very few worlds have no bias correction that could be trusted.
"""

from dataclasses import dataclass
from functools import partial
from itertools import combinations

import numpy as np

from barn_metrics import bootstrap
from barn_metrics.bootstrap import Interval
from barn_worlds.base.arrays import Floats, Integers


@dataclass(frozen=True)
class Line:
    """A least-squares line through trials: measured time per metre over the predicted one."""

    trials: int
    worlds: int
    slope: Interval
    intercept_s_per_m: Interval


over_worlds = partial(bootstrap.over_worlds, method="percentile")


def deviation(values: Floats, seed: int) -> Interval:
    """Return the standard deviation (population) of one value per world (n,)."""
    return over_worlds(lambda drawn: values[drawn].std(axis=-1), len(values), seed)


def line(predicted: Floats, measured: Floats, seed: int) -> Line:
    """Return the line through the trials of worlds: predicted (w,), measured (w, t); worlds are drawn whole."""
    means = measured.mean(axis=1)

    def fit(drawn: Integers) -> tuple[Floats, Floats]:
        x, y = predicted[drawn], means[drawn]
        mean_x, mean_y = x.mean(axis=-1), y.mean(axis=-1)
        spread = ((x - mean_x[..., None]) ** 2).sum(axis=-1)
        # One world drawn again and again has no slope, however little its copies differ by rounding.
        spread = np.where(np.ptp(x, axis=-1) > 0.0, spread, np.nan)
        slope = ((x - mean_x[..., None]) * (y - mean_y[..., None])).sum(axis=-1) / spread
        return slope, mean_y - slope * mean_x

    count = len(predicted)
    slope = over_worlds(lambda drawn: fit(drawn)[0], count, seed)
    intercept = over_worlds(lambda drawn: fit(drawn)[1], count, seed)
    return Line(measured.size, count, slope, intercept)


def slope_difference(predicted: Floats, first: Floats, second: Floats, seed: int) -> Interval:
    """Return by how much the slope of `first` (w, t) is above that of `second` (w, t), on the same worlds."""
    return line(predicted, (first.mean(axis=1) - second.mean(axis=1))[:, None], seed).slope


def split_correlation(values: Floats, first: int) -> float:
    """Return Spearman's correlation over worlds of the mean of some trials with that of the others.

    values: (w, t); averaged over all ways to choose `first` of the t trials.
    """
    count = values.shape[1]
    found = []
    for chosen in combinations(range(count), first):
        others = [trial for trial in range(count) if trial not in chosen]
        if 2 * first == count and 0 not in chosen:
            continue  # the same two halves come the other way round
        found.append(bootstrap.spearman(values[:, list(chosen)].mean(axis=1), values[:, others].mean(axis=1)))
    return float(np.mean(found))
