"""How much of the difficulty repeats: what no model of worlds can explain of a mean over few trials."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
import numpy.typing as npt

from barn_metrics.bootstrap import Interval
from barn_metrics.model.intervals import over_worlds, pearson, pearson_of_ranks
from barn_metrics.model.trials import Trials

Floats = npt.NDArray[np.float64]

_SPLITS = 50


@dataclass(frozen=True)
class Ceiling:
    """Agreement of the trials with themselves.

    reliability: correlation of halves of the repetitions, carried to all of them by the formula of Spearman and Brown:
    the highest R2 that a model can have on these trials; None where worlds have one trial per planner. half_spearman:
    rank correlation of the halves. noise_mse: squared error in (s/m)^2 that even the true difficulty would have.
    """

    reliability: Interval | None
    half_spearman: float | None
    noise_mse: float | None


def noise_ceiling(trials: Trials, seed: int = 0) -> Ceiling:
    """Return the ceiling of trials from random splits of the repetitions; both halves hold as many of each planner."""
    values = [_repetitions(trials, planner) for planner in trials.planner_names]
    fewest = min(min(map(len, rows)) for rows in values)
    if fewest < 2:
        return Ceiling(None, None, None)
    generator = np.random.default_rng(seed)
    halves = np.array([_split(values, generator) for _ in range(_SPLITS)])  # (splits, 2, w)
    # Halves are as large as the world with the fewest repetitions allows.
    factor = fewest / (fewest // 2)

    def reliability(drawn: npt.NDArray[np.int64]) -> Floats:
        each = np.mean([pearson(first[drawn], second[drawn]) for first, second in halves], axis=0)
        full: Floats = factor * each / (1.0 + (factor - 1.0) * each)
        return full

    worlds = len(trials.world_numbers)
    noise = sum(np.mean([np.var(row, ddof=1) / len(row) for row in rows]) for rows in values) / len(values) ** 2
    ranks = np.mean([pearson_of_ranks(first, second) for first, second in halves])
    return Ceiling(over_worlds(reliability, worlds), float(ranks), float(noise))


def _repetitions(trials: Trials, planner: str) -> list[Floats]:
    """Return the times per metre of one planner's trials in each world."""
    mine = trials.of(planner)
    return [mine.normalised_s_per_m[mine.worlds == world] for world in trials.world_numbers]


def _split(values: list[list[Floats]], generator: np.random.Generator) -> Floats:
    """Return the difficulty of each world by two halves that share no trial, (2, w)."""
    half = min(min(map(len, rows)) for rows in values) // 2
    means = []
    for rows in values:
        drawn = [generator.permutation(row)[: 2 * half].reshape(2, half).mean(axis=1) for row in rows]
        means.append(np.array(drawn).T)
    mean: Floats = np.mean(means, axis=0)
    return mean
