"""The difficulty model: inputs of a world in, predicted time per metre out, with numpy only."""

from collections.abc import Iterable, Mapping
from dataclasses import dataclass
from typing import Any

import numpy as np

from barn_metrics.model.inputs import inputs_of
from barn_metrics.model.network import RouteNetwork
from barn_worlds.base.arrays import Floats
from barn_worlds.worlds.dataset import Dataset, select_worlds
from barn_worlds.worlds.world import World

_QUICKEST_S_PER_M = 0.1  # no prediction is below: ten metres a second


@dataclass(frozen=True)
class Prediction:
    """What the model says of a world.

    difficulty_s_per_m: time per metre of path as trials count it, failures included, averaged over planners;
    std_s_per_m: standard deviation to be expected of what trials in a new world give around it; per_planner_s_per_m: of
    each planner; failure_probability: of a trial.
    """

    difficulty_s_per_m: float
    std_s_per_m: float
    per_planner_s_per_m: dict[str, float]
    failure_probability: float

    def columns(self) -> dict[str, float]:
        """Return the figures by name, as a table of worlds has them."""
        planners = {f"{planner}_s_per_m": value for planner, value in self.per_planner_s_per_m.items()}
        own = {"difficulty_s_per_m": self.difficulty_s_per_m, "std_s_per_m": self.std_s_per_m}
        return {**own, **planners, "failure_probability": self.failure_probability}


@dataclass(frozen=True, eq=False)
class DifficultyModel:
    """The mean of some networks.

    planners: those whose times the networks give, one after the other, followed by their shares of failures.
    relative_std: spread of held-out worlds about the prediction, as a share of it, beyond the networks' disagreement.
    about: where the model comes from.
    """

    planners: tuple[str, ...]
    networks: tuple[RouteNetwork, ...]
    relative_std: float
    about: Mapping[str, Any]

    def predict(self, world: World) -> Prediction:
        """Return the prediction of a world; WorldError for one without metrics."""
        return self.predict_worlds([world])[0]

    def predict_worlds(self, worlds: Iterable[World]) -> list[Prediction]:
        """Return the prediction of each world."""
        seen = inputs_of(worlds)
        return self.predict_inputs(seen) if len(seen) else []

    def predict_dataset(self, dataset: Dataset, worlds: str = "all") -> dict[int, Prediction]:
        """Return predictions of worlds of a data set by number; WorldError names the world that has no metrics.

        worlds: which of them, such as "0-49". One by one, as the last digits depend on what is evaluated together.
        """
        return {number: self.predict(dataset.load(number)) for number in select_worlds(worlds, dataset.indices)}

    def predict_inputs(self, inputs: Floats) -> list[Prediction]:
        """Return the predictions of worlds whose inputs (n, d) are known."""
        outputs, difficulty, spread = self._outputs(inputs)
        std = np.hypot(spread, self.relative_std * difficulty)
        count = len(self.planners)
        times, failures = np.maximum(outputs[:, :count], _QUICKEST_S_PER_M), np.clip(outputs[:, count:], 0.0, 1.0)
        return [
            Prediction(
                float(difficulty[row]),
                float(std[row]),
                dict(zip(self.planners, times[row].tolist(), strict=True)),
                float(failures[row].mean()),
            )
            for row in range(len(inputs))
        ]

    def difficulty(self, inputs: Floats) -> tuple[Floats, Floats]:
        """Return predicted times per metre (n,) for inputs (n, d), and their standard deviation (n,) over networks."""
        return self._outputs(inputs)[1:]

    def _outputs(self, inputs: Floats) -> tuple[Floats, Floats, Floats]:
        """Return the networks' mean outputs (n, k), the difficulty (n,) and the networks' spread about it (n,)."""
        each = np.array([network(inputs) for network in self.networks])  # (m, n, k)
        share = 1.0 / len(self.networks)
        outputs: Floats = np.sum(share * each, axis=0)
        means = self._over_planners(each)
        spread = np.sqrt((share * (means - (share * means).sum(axis=0)) ** 2).sum(axis=0))
        return outputs, np.maximum(self._over_planners(outputs), _QUICKEST_S_PER_M), spread

    def _over_planners(self, outputs: Floats) -> Floats:
        """Return the mean over planners of outputs (..., k)."""
        mean: Floats = outputs[..., : len(self.planners)].mean(axis=-1)
        return mean
