"""Intervals of a model's errors, and correlations that a constant prediction does not break."""

from __future__ import annotations

import numpy as np
from scipy import stats

from barn_metrics import bootstrap
from barn_metrics.bootstrap import Floats, Interval, Statistic

RESAMPLES = 4000  # rank correlations of several repeats are slow, and the shipped card has this many


def over_worlds(statistic: Statistic, worlds: int) -> Interval:
    """Return a statistic of positions of worlds (..., n), 0 to worlds - 1, with its 95 % BCa interval."""
    return bootstrap.over_worlds(statistic, worlds, resamples=RESAMPLES)


def pearson_of_ranks(a: Floats, b: Floats) -> Floats:
    """Return Spearman's correlation along the last axis; 0 where one side does not vary."""
    first, second = (stats.rankdata(one, axis=-1) for one in (a, b))
    return pearson(first, second)


def pearson(a: Floats, b: Floats) -> Floats:
    """Return the correlation along the last axis; 0 where one side does not vary."""
    a, b = (one - one.mean(axis=-1, keepdims=True) for one in (a, b))
    scale = np.sqrt((a**2).sum(axis=-1) * (b**2).sum(axis=-1))
    found: Floats = np.where(scale > 1e-12, (a * b).sum(axis=-1) / np.maximum(scale, 1e-12), 0.0)
    return found
