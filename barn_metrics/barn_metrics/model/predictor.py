"""The difficulty model: inputs of a world in, predicted time per metre out, its networks evaluated with numpy."""

from collections.abc import Mapping
from dataclasses import dataclass
from typing import Any

import numpy as np

from barn_metrics.model.inputs import inputs_of
from barn_metrics.model.route import CHANNELS, PRESENT, SAMPLES, mirror_strips
from barn_worlds.base.arrays import Floats
from barn_worlds.datasets.dataset import Dataset, select_worlds
from barn_worlds.worlds.world import World

Layer = tuple[Floats, Floats]  # weights and bias

DILATIONS = (1, 1, 2)  # of the filters of each layer
LARGEST_SCORE = 5.0  # standard deviations beyond which a z-scored input is clipped
SUMMARY_SCALE = 0.3  # of z-scored inputs beside the responses of filters
_QUICKEST_S_PER_M = 0.1  # no prediction is below: ten metres a second
_AT_ONCE = 64  # worlds, which bounds the memory


@dataclass(frozen=True, eq=False)
class RouteNetwork:
    """Filters along the strips of r routes, then layers that see their largest and mean response and d other inputs.

    A world and its mirror image give the same.
    """

    mean: Floats  # (d,) of the inputs that are not strips, which come first
    std: Floats
    filters: tuple[
        Layer, ...
    ]  # weights (width, in, out), width odd, and bias (out,) of each of `DILATIONS`
    layers: tuple[
        Layer, ...
    ]  # weights (in, out) and bias (out,), with rectified linear units between them

    def __call__(self, inputs: Floats) -> Floats:
        """Return the outputs (n, k) of inputs (n, d + r * SAMPLES * CHANNELS)."""
        starts = range(0, max(len(inputs), 1), _AT_ONCE)
        return np.concatenate(
            [self._both_ways(inputs[first : first + _AT_ONCE]) for first in starts]
        )

    def _both_ways(self, inputs: Floats) -> Floats:
        plain, strips = split_inputs(inputs, self.mean, self.std)
        outputs = [
            self._one_way(plain, side_by_side(way))
            for way in (strips, mirror_strips(strips))
        ]
        mean: Floats = 0.5 * (outputs[0] + outputs[1])
        return mean

    def _one_way(self, plain: Floats, strips: Floats) -> Floats:
        present = sample_mask(strips)
        longest = max(int(present.any(axis=(0, 2)).sum()), 1)
        values, present = strips[:, :longest], present[:, :longest]
        for (weights, bias), dilation in zip(self.filters, DILATIONS, strict=True):
            # Zero after the end of a route, so that what follows it does not matter.
            values = (
                np.maximum(_convolved(values, weights, dilation) + bias, 0.0) * present
            )
        means = values.sum(axis=1) / np.maximum(present.sum(axis=1), 1.0)
        values = np.concatenate([values.max(axis=1), means, plain], axis=1)
        *hidden, (weights, bias) = self.layers
        for inner, offset in hidden:
            values = np.maximum(values @ inner + offset, 0.0)
        outputs: Floats = values @ weights + bias
        return outputs


def moments(values: Floats) -> tuple[Floats, Floats]:
    """Return mean and standard deviation (d,) of values (n, d); the deviation of what does not vary is 1."""
    std = values.std(axis=0)
    return values.mean(axis=0), np.where(std > 1e-9, std, 1.0)


def split_inputs(inputs: Floats, mean: Floats, std: Floats) -> tuple[Floats, Floats]:
    """Return the z-scored inputs (n, d) that are no strips, and the strips (n, r, SAMPLES, CHANNELS)."""
    plain = SUMMARY_SCALE * np.clip(
        (inputs[:, : len(mean)] - mean) / std, -LARGEST_SCORE, LARGEST_SCORE
    )
    strips = inputs[:, len(mean) :]
    return plain, strips.reshape(
        len(inputs), strips.shape[1] // (SAMPLES * CHANNELS), SAMPLES, CHANNELS
    )


def side_by_side(strips: Floats) -> Floats:
    """Return strips (n, r, SAMPLES, CHANNELS) as (n, SAMPLES, r * CHANNELS)."""
    count, routes, samples, channels = strips.shape
    return np.swapaxes(strips, 1, 2).reshape(count, samples, routes * channels)


def sample_mask(strips: Floats) -> Floats:
    """Return (n, SAMPLES, 1), 1 where any of the strips side by side has a sample."""
    present: Floats = strips[:, :, PRESENT::CHANNELS].max(axis=2, keepdims=True)
    return present


def _convolved(values: Floats, weights: Floats, dilation: int) -> Floats:
    """Return the response (n, s, out) of values (n, s, in), zeros beyond, to filters (width, in, out), tap by tap."""
    length = values.shape[1]
    reach = len(weights) // 2 * dilation
    padded = np.pad(values, ((0, 0), (reach, reach), (0, 0)))
    convolved: Floats = np.zeros((*values.shape[:2], weights.shape[2]))
    for number, tap in enumerate(weights):
        convolved += padded[:, number * dilation : number * dilation + length] @ tap
    return convolved


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
        planners = {
            f"{planner}_s_per_m": value
            for planner, value in self.per_planner_s_per_m.items()
        }
        own = {
            "difficulty_s_per_m": self.difficulty_s_per_m,
            "std_s_per_m": self.std_s_per_m,
        }
        return {**own, **planners, "failure_probability": self.failure_probability}


@dataclass(frozen=True, eq=False)
class DifficultyModel:
    """The mean of some networks; about: where it comes from."""

    planners: tuple[
        str, ...
    ]  # whose times the networks give, followed by their shares of failures
    networks: tuple[RouteNetwork, ...]
    relative_std: float  # of held-out worlds about the prediction, beyond the networks' disagreement
    about: Mapping[str, Any]

    def predict(self, world: World) -> Prediction:
        """Return the prediction of a world; WorldError for one without metrics."""
        return self.predict_inputs(inputs_of([world]))[0]

    def predict_dataset(
        self, dataset: Dataset, worlds: str = "all"
    ) -> dict[int, Prediction]:
        """Return predictions of worlds, such as "0-49", by number, each alone, as last digits depend on company."""
        return {
            number: self.predict(dataset.load(number))
            for number in select_worlds(worlds, dataset.world_numbers)
        }

    def predict_inputs(self, inputs: Floats) -> list[Prediction]:
        """Return the predictions of worlds whose inputs (n, d) are known."""
        outputs, difficulty, spread = self._outputs(inputs)
        std, count = (
            np.hypot(spread, self.relative_std * difficulty),
            len(self.planners),
        )
        times, failures = (
            np.maximum(outputs[:, :count], _QUICKEST_S_PER_M),
            np.clip(outputs[:, count:], 0.0, 1.0),
        )
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
        spread = np.sqrt(
            (share * (means - (share * means).sum(axis=0)) ** 2).sum(axis=0)
        )
        return (
            outputs,
            np.maximum(self._over_planners(outputs), _QUICKEST_S_PER_M),
            spread,
        )

    def _over_planners(self, outputs: Floats) -> Floats:
        """Return the mean over planners of outputs (..., k)."""
        mean: Floats = outputs[..., : len(self.planners)].mean(axis=-1)
        return mean
