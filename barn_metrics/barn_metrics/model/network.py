"""The network of the difficulty model, evaluated with numpy."""

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from barn_metrics.model.route import CHANNELS, PRESENT, SAMPLES, mirrored
from barn_worlds.base.arrays import Floats

Layer = tuple[Floats, Floats]  # weights and bias

DILATIONS = (1, 1, 2)  # of the filters of each layer
LARGEST_SCORE = 5.0  # standard deviations beyond which a z-scored input is clipped
SUMMARY_SCALE = 0.3  # of z-scored inputs beside the responses of filters
_AT_ONCE = 64  # worlds, which bounds the memory


@dataclass(frozen=True, eq=False)
class RouteNetwork:
    """Filters along the strips of r routes, then layers that see their largest and mean response and d other inputs.

    mean, std: (d,) of the inputs that are not strips, which come first; filters: weights (width, in, out), width odd,
    and bias (out,) of each of `DILATIONS`; layers: weights (in, out) and bias (out,), fully connected with rectified
    linear units between them. A world and its mirror image give the same.
    """

    mean: Floats
    std: Floats
    filters: tuple[Layer, ...]
    layers: tuple[Layer, ...]

    def __call__(self, inputs: Floats) -> Floats:
        """Return the outputs (n, k) of inputs (n, d + r * SAMPLES * CHANNELS)."""
        starts = range(0, max(len(inputs), 1), _AT_ONCE)
        return np.concatenate([self._both_ways(inputs[first : first + _AT_ONCE]) for first in starts])

    def _both_ways(self, inputs: Floats) -> Floats:
        plain, strips = divided(inputs, self.mean, self.std)
        outputs = [self._one_way(plain, side_by_side(way)) for way in (strips, mirrored(strips))]
        mean: Floats = 0.5 * (outputs[0] + outputs[1])
        return mean

    def _one_way(self, plain: Floats, strips: Floats) -> Floats:
        present = present_in(strips)
        longest = max(int(present.any(axis=(0, 2)).sum()), 1)
        values, present = strips[:, :longest], present[:, :longest]
        for (weights, bias), dilation in zip(self.filters, DILATIONS, strict=True):
            # Zero after the end of a route, so that what follows it does not matter.
            values = np.maximum(_convolved(values, weights, dilation) + bias, 0.0) * present
        means = values.sum(axis=1) / np.maximum(present.sum(axis=1), 1.0)
        return _connected(np.concatenate([values.max(axis=1), means, plain], axis=1), self.layers)


def _connected(values: Floats, layers: Sequence[Layer]) -> Floats:
    for weights, bias in layers[:-1]:
        values = np.maximum(values @ weights + bias, 0.0)
    weights, bias = layers[-1]
    outputs: Floats = values @ weights + bias
    return outputs


def divided(inputs: Floats, mean: Floats, std: Floats) -> tuple[Floats, Floats]:
    """Return the z-scored inputs (n, d) that are no strips, and the strips (n, r, SAMPLES, CHANNELS)."""
    plain = SUMMARY_SCALE * np.clip((inputs[:, : len(mean)] - mean) / std, -LARGEST_SCORE, LARGEST_SCORE)
    strips = inputs[:, len(mean) :]
    return plain, strips.reshape(len(inputs), strips.shape[1] // (SAMPLES * CHANNELS), SAMPLES, CHANNELS)


def side_by_side(strips: Floats) -> Floats:
    """Return strips (n, r, SAMPLES, CHANNELS) as (n, SAMPLES, r * CHANNELS)."""
    count, routes, samples, channels = strips.shape
    return np.swapaxes(strips, 1, 2).reshape(count, samples, routes * channels)


def present_in(strips: Floats) -> Floats:
    """Return (n, SAMPLES, 1), 1 where any of the strips side by side has a sample."""
    present: Floats = strips[:, :, PRESENT::CHANNELS].max(axis=2, keepdims=True)
    return present


def _convolved(values: Floats, weights: Floats, dilation: int) -> Floats:
    """Return the response (n, s, out) to filters (width, in, out), zeros beyond the ends of values (n, s, in).

    One small product per tap: a large one is spread over threads, and starting them takes longer than the product.
    """
    length = values.shape[1]
    reach = len(weights) // 2 * dilation
    padded = np.pad(values, ((0, 0), (reach, reach), (0, 0)))
    convolved: Floats = np.zeros((*values.shape[:2], weights.shape[2]))
    for number, tap in enumerate(weights):
        convolved += padded[:, number * dilation : number * dilation + length] @ tap
    return convolved
