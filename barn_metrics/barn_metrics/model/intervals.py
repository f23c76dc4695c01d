"""Estimates over worlds with bootstrap intervals: whole worlds are drawn with replacement."""

from __future__ import annotations

import warnings
from collections.abc import Callable
from dataclasses import dataclass

import numpy as np
import numpy.typing as npt
from scipy import stats

Floats = npt.NDArray[np.float64]
Statistic = Callable[[npt.NDArray[np.int64]], Floats]

LEVEL = 0.95
RESAMPLES = 4000


@dataclass(frozen=True)
class Interval:
    """An estimate and its confidence limits."""

    estimate: float
    low: float
    high: float


def over_worlds(statistic: Statistic, worlds: int, seed: int = 0) -> Interval:
    """Return a statistic of positions of worlds (..., n), 0 to worlds - 1, with its interval (BCa, Efron 1987)."""
    every = np.arange(worlds)
    estimate = float(statistic(every))
    with warnings.catch_warnings(), np.errstate(invalid="ignore"):
        warnings.simplefilter("ignore", stats.DegenerateDataWarning)  # all alike: the limits are the estimate
        found = stats.bootstrap(
            (every,),
            lambda drawn, axis: statistic(drawn),  # noqa: ARG005 (worlds are along the last axis)
            n_resamples=RESAMPLES,
            batch=500,
            confidence_level=LEVEL,
            method="BCa",
            vectorized=True,
            random_state=np.random.default_rng(seed),
        )
    limits = [float(one) for one in (found.confidence_interval.low, found.confidence_interval.high)]
    low, high = (one if np.isfinite(one) else estimate for one in limits)
    return Interval(estimate, low, high)


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
