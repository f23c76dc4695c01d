"""The difficulty model: inputs of a world in, predicted time per metre out, with numpy only."""

from __future__ import annotations

from collections.abc import Iterable, Mapping
from dataclasses import dataclass, field
from typing import Any

import numpy as np
import numpy.typing as npt

from barn_metrics.model.forest import Forest
from barn_metrics.model.inputs import inputs_of
from barn_metrics.model.network import Network
from barn_metrics.model.sequence import SequenceNetwork
from barn_worlds.world import World

Floats = npt.NDArray[np.float64]

_QUICKEST_S_PER_M = 0.1  # no prediction is below: ten metres a second


@dataclass(frozen=True, eq=False)
class Member:
    """A part of a model: its function of inputs (n, d), and its share in the average."""

    function: Network | Forest | SequenceNetwork
    weight: float


@dataclass(frozen=True)
class Prediction:
    """What a model says of a world.

    difficulty_s_per_m: time per metre of path as trials count it, failures included, averaged over planners;
    std_s_per_m: standard deviation to be expected of what trials in a new world give around it; per_planner_s_per_m: of
    each planner, empty where the model knows only their mean; failure_probability: of a trial, likewise.
    """

    difficulty_s_per_m: float
    std_s_per_m: float
    per_planner_s_per_m: dict[str, float] = field(default_factory=dict)
    failure_probability: float | None = None


@dataclass(frozen=True, eq=False)
class DifficultyModel:
    """An average of members.

    inputs: name of the set of inputs; planners: those whose times the members give, one after the other, followed by
    their shares of failures; empty where members give the difficulty alone. relative_std: spread of held-out worlds
    about the prediction, as a share of it, beyond the members' disagreement. about: where the model comes from.
    """

    recipe: str
    inputs: str
    planners: tuple[str, ...]
    members: tuple[Member, ...]
    relative_std: float
    about: Mapping[str, Any]

    def predict(self, world: World) -> Prediction:
        """Return the prediction of a world; WorldError for one without metrics."""
        return self.predict_worlds([world])[0]

    def predict_worlds(self, worlds: Iterable[World]) -> list[Prediction]:
        """Return the prediction of each world."""
        seen = inputs_of(worlds, self.inputs)
        return self.predict_inputs(seen) if len(seen) else []

    def predict_inputs(self, inputs: Floats) -> list[Prediction]:
        """Return the predictions of worlds whose inputs (n, d) are known."""
        each = self._each(inputs)
        outputs = self._weighted(each)
        difficulty = self._difficulty(outputs)
        std = np.hypot(self._spread(each), self.relative_std * difficulty)
        count = len(self.planners)
        return [
            Prediction(
                float(difficulty[row]),
                float(std[row]),
                dict(zip(self.planners, np.maximum(outputs[row, :count], _QUICKEST_S_PER_M).tolist(), strict=True)),
                float(np.clip(outputs[row, count:], 0.0, 1.0).mean()) if count else None,
            )
            for row in range(len(inputs))
        ]

    def difficulty(self, inputs: Floats) -> Floats:
        """Return the predicted time per metre (n,) of worlds whose inputs (n, d) are known."""
        return self._difficulty(self._weighted(self._each(inputs)))

    def spread(self, inputs: Floats) -> Floats:
        """Return by how much the members disagree: the standard deviation (n,) of their predictions."""
        return self._spread(self._each(inputs))

    def _each(self, inputs: Floats) -> Floats:
        """Return the outputs of each member, (m, n, k)."""
        return np.array([member.function(inputs) for member in self.members])

    def _weighted(self, each: Floats) -> Floats:
        mean: Floats = np.sum(self._weights[:, None, None] * each, axis=0)
        return mean

    def _difficulty(self, outputs: Floats) -> Floats:
        return np.maximum(self._mean(outputs), _QUICKEST_S_PER_M)

    def _spread(self, each: Floats) -> Floats:
        means = self._mean(each)
        weights = self._weights[:, None]
        mean = (weights * means).sum(axis=0)
        spread: Floats = np.sqrt((weights * (means - mean) ** 2).sum(axis=0))
        return spread

    @property
    def _weights(self) -> Floats:
        return np.array([member.weight for member in self.members])

    def _mean(self, outputs: Floats) -> Floats:
        """Return the mean over planners of outputs (..., k)."""
        mean: Floats = outputs[..., : max(len(self.planners), 1)].mean(axis=-1)
        return mean
