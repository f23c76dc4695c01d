"""The difficulty model, which predicts a world's time per meter from its inputs.

NumPy evaluates its networks.
"""

from collections.abc import Mapping
from dataclasses import dataclass
from typing import Any

import numpy as np

from barn_metrics.model.inputs import inputs_of
from barn_metrics.model.route import CHANNELS, PRESENT, SAMPLES, mirror_strips
from barn_worlds.base.arrays import Floats
from barn_worlds.datasets.dataset import Dataset, select_worlds
from barn_worlds.worlds.world import World

# Weights and bias.
Layer = tuple[Floats, Floats]

# Of the filters of each layer.
DILATIONS = (1, 1, 2)
# Standard deviations beyond which a z-scored input is clipped.
LARGEST_SCORE = 5.0
# Scale of z-scored inputs beside the responses of filters.
SUMMARY_SCALE = 0.3
# No prediction is below: ten meters a second.
_QUICKEST_S_PER_M = 0.1
# Worlds that are evaluated together, which bounds the memory.
_BATCH = 64


@dataclass(frozen=True, eq=False)
class RouteNetwork:
    """A network along routes: filters on strips, then fully connected layers.

    The layers see the largest and the mean response of each filter, and the inputs that
    are no strips. A world and its mirror image give the same.
    """

    # (d,) of the inputs that are no strips, which come first.
    mean: Floats
    std: Floats
    # Weights (width, in, out), the width odd, and bias (out,) for each of `DILATIONS`.
    filters: tuple[Layer, ...]
    # Weights (in, out) and bias (out,), with rectified linear units between them.
    layers: tuple[Layer, ...]

    def __call__(self, inputs: Floats) -> Floats:
        """Return the outputs (n, k) of inputs (n, d + routes * SAMPLES * CHANNELS)."""
        starts = range(0, max(len(inputs), 1), _BATCH)
        # At least one batch, so that no worlds give an array of the right width.
        return np.concatenate(
            [self._evaluate(inputs[start : start + _BATCH]) for start in starts]
        )

    def _evaluate(self, inputs: Floats) -> Floats:
        """Return outputs (n, k), the mean over each world and its mirror image."""
        summary, strips = split_inputs(inputs, self.mean, self.std)
        plain = self._evaluate_side(summary, side_by_side(strips))
        mirrored = self._evaluate_side(summary, side_by_side(mirror_strips(strips)))
        return 0.5 * (plain + mirrored)

    def _evaluate_side(self, summary: Floats, strips: Floats) -> Floats:
        """Return outputs (n, k) of summaries (n, d), strips (n, SAMPLES, channels)."""
        # Samples beyond the longest route are zero in all worlds.
        mask = sample_mask(strips)
        longest = max(int(mask.any(axis=(0, 2)).sum()), 1)
        values = strips[:, :longest]
        mask = mask[:, :longest]
        for (weights, bias), dilation in zip(self.filters, DILATIONS, strict=True):
            # What follows the end of a route must not count.
            response = _convolve(values, weights, dilation) + bias
            values = np.maximum(response, 0.0) * mask

        means = values.sum(axis=1) / np.maximum(mask.sum(axis=1), 1.0)
        values = np.concatenate([values.max(axis=1), means, summary], axis=1)
        *hidden_layers, (output_weights, output_bias) = self.layers
        for weights, bias in hidden_layers:
            values = np.maximum(values @ weights + bias, 0.0)
        return values @ output_weights + output_bias


def moments(values: Floats) -> tuple[Floats, Floats]:
    """Return mean and std (d,) over rows of values (n, d); std 1 if constant."""
    std = values.std(axis=0)
    return values.mean(axis=0), np.where(std > 1e-9, std, 1.0)


def split_inputs(inputs: Floats, mean: Floats, std: Floats) -> tuple[Floats, Floats]:
    """Return scaled, clipped scores (n, d) and raw strips (n, r, SAMPLES, CHANNELS).

    Args:
        inputs: (n, d + r * SAMPLES * CHANNELS).
        mean: (d,) of the inputs that are no strips.
        std: (d,) of these.

    Returns:
        The z-scored inputs (n, d), and the strips (n, r, SAMPLES, CHANNELS).
    """
    size = len(mean)
    scores = (inputs[:, :size] - mean) / std
    summary = SUMMARY_SCALE * np.clip(scores, -LARGEST_SCORE, LARGEST_SCORE)
    strips = inputs[:, size:]
    # Not -1, which NumPy cannot infer where there are no worlds.
    routes = strips.shape[1] // (SAMPLES * CHANNELS)
    return summary, strips.reshape(len(inputs), routes, SAMPLES, CHANNELS)


def side_by_side(strips: Floats) -> Floats:
    """Return strips (n, r, SAMPLES, CHANNELS) as (n, SAMPLES, r * CHANNELS)."""
    count, routes, samples, channels = strips.shape
    return np.swapaxes(strips, 1, 2).reshape(count, samples, routes * channels)


def sample_mask(strips: Floats) -> Floats:
    """Return (n, SAMPLES, 1), 1 where any of the strips side by side has a sample."""
    mask: Floats = strips[:, :, PRESENT::CHANNELS].max(axis=2, keepdims=True)
    return mask


def _convolve(values: Floats, weights: Floats, dilation: int) -> Floats:
    """Return the response of dilated filters over zero-padded samples, without bias.

    Args:
        values: (n, s, in), zeros beyond.
        weights: (width, in, out).
        dilation: Samples from one tap to the next.

    Returns:
        (n, s, out).
    """
    length = values.shape[1]
    reach = len(weights) // 2 * dilation
    padded = np.pad(values, ((0, 0), (reach, reach), (0, 0)))
    response: Floats = np.zeros((*values.shape[:2], weights.shape[2]))
    for number, tap in enumerate(weights):
        start = number * dilation
        response += padded[:, start : start + length] @ tap
    return response


@dataclass(frozen=True)
class Prediction:
    """The model's prediction for a world."""

    # Scored time per meter of path, failures included, averaged over planners.
    difficulty_s_per_m: float
    # Expected standard deviation of trials in a new world around the prediction.
    std_s_per_m: float
    per_planner_s_per_m: dict[str, float]

    def columns(self) -> dict[str, float]:
        """Return a dict of difficulty_s_per_m, std_s_per_m and each PLANNER_s_per_m."""
        planners = {
            f"{planner}_s_per_m": value
            for planner, value in self.per_planner_s_per_m.items()
        }
        return {
            "difficulty_s_per_m": self.difficulty_s_per_m,
            "std_s_per_m": self.std_s_per_m,
            **planners,
        }


@dataclass(frozen=True, eq=False)
class DifficultyModel:
    """The mean of some networks."""

    # The networks give their times, followed by their shares of failures, which are far
    # too low in the hardest worlds to be shown.
    planners: tuple[str, ...]
    networks: tuple[RouteNetwork, ...]
    # Of unseen worlds about the prediction, beyond the networks' disagreement.
    relative_std: float
    # Where the model comes from.
    about: Mapping[str, Any]

    def predict(self, world: World) -> Prediction:
        """Return a world's prediction; WorldError for an arena or blocked path."""
        return self.predict_inputs(inputs_of([world]))[0]

    def predict_dataset(
        self, dataset: Dataset, worlds: str = "all"
    ) -> dict[int, Prediction]:
        """Load the selected worlds of a data set; return their predictions by number.

        Args:
            dataset: The data set.
            worlds: Selection, such as "0-49".
        """
        # Each alone: the last digits depend on what is evaluated together.
        return {
            number: self.predict(dataset.load(number))
            for number in select_worlds(worlds, dataset.world_numbers)
        }

    def predict_inputs(self, inputs: Floats) -> list[Prediction]:
        """Return a prediction for each row of inputs (n, d) of `inputs_of`."""
        outputs, difficulty, spread = self.evaluate(inputs)
        # The networks' disagreement and the error of all of them are independent.
        std = np.hypot(spread, self.relative_std * difficulty)
        times = np.maximum(outputs[:, : len(self.planners)], _QUICKEST_S_PER_M)
        return [
            Prediction(
                difficulty_s_per_m=float(difficulty[row]),
                std_s_per_m=float(std[row]),
                per_planner_s_per_m=dict(
                    zip(self.planners, times[row].tolist(), strict=True)
                ),
            )
            for row in range(len(inputs))
        ]

    def evaluate(self, inputs: Floats) -> tuple[Floats, Floats, Floats]:
        """Return mean outputs (n, k), difficulty (n,) in s/m, >= 0.1, and its std.

        Args:
            inputs: (n, d).

        Returns:
            Mean outputs, and predicted times in s/m with their standard deviation.
        """
        # (networks, n, k)
        all_outputs = np.array([network(inputs) for network in self.networks])
        outputs: Floats = all_outputs.mean(axis=0)
        difficulty = np.maximum(self._planner_mean(outputs), _QUICKEST_S_PER_M)
        return outputs, difficulty, self._planner_mean(all_outputs).std(axis=0)

    def _planner_mean(self, outputs: Floats) -> Floats:
        """Return the mean over planners of the times (s/m) in outputs (..., k)."""
        mean: Floats = outputs[..., : len(self.planners)].mean(axis=-1)
        return mean
