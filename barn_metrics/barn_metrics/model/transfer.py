"""How well a model that is trained already predicts trials in other worlds, or of other robots."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass

import numpy as np
import numpy.typing as npt

from barn_metrics.bootstrap import Interval
from barn_metrics.model.intervals import over_worlds, pearson_of_ranks
from barn_metrics.model.predictor import DifficultyModel
from barn_metrics.model.training import trained_worlds
from barn_metrics.model.trials import Trials
from barn_worlds.world import World

Floats = npt.NDArray[np.float64]


@dataclass(frozen=True)
class Transfer:
    """Errors of a model on trials; intervals of 95 % over worlds.

    mse in (s/m)^2, mae in s/m; bias_s_per_m: mean of prediction minus measurement; within_two_std: share of the worlds
    whose measured difficulty lies within two of the model's standard deviations. predictions: of each world, s/m.
    """

    worlds: int
    trials: int
    mse: Interval
    mae: Interval
    r2: Interval
    spearman: Interval
    bias_s_per_m: Interval
    within_two_std: float
    predictions: tuple[float, ...]


def transfer(model: DifficultyModel, worlds: Mapping[int, World], trials: Trials) -> Transfer:
    """Return how well a model predicts the difficulty that trials give; ModelError for too few worlds.

    It is held-out only where the model was not trained on these worlds.
    """
    numbers = trained_worlds(worlds, trials)
    found = model.predict_worlds([worlds[number] for number in numbers])
    predicted = np.array([one.difficulty_s_per_m for one in found])
    std = np.array([one.std_s_per_m for one in found])
    measured = trials.difficulty()
    error = predicted - measured

    def r2(drawn: npt.NDArray[np.int64]) -> Floats:
        explained: Floats = 1.0 - (error[drawn] ** 2).mean(axis=-1) / measured[drawn].var(axis=-1)
        return explained

    return Transfer(
        len(numbers),
        len(trials.only(numbers)),
        over_worlds(lambda drawn: (error[drawn] ** 2).mean(axis=-1), len(numbers)),
        over_worlds(lambda drawn: np.abs(error[drawn]).mean(axis=-1), len(numbers)),
        over_worlds(r2, len(numbers)),
        over_worlds(lambda drawn: pearson_of_ranks(predicted[drawn], measured[drawn]), len(numbers)),
        over_worlds(lambda drawn: error[drawn].mean(axis=-1), len(numbers)),
        float((np.abs(error) <= 2.0 * std).mean()),
        tuple(predicted.tolist()),
    )
