"""A small network that is convolved along strips of routes, evaluated with numpy."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
import numpy.typing as npt

from barn_metrics.model.strips import CHANNELS, PRESENT, SAMPLES, mirrored

Floats = npt.NDArray[np.float64]

DILATIONS = (1, 1, 2)  # of the filters of each layer
LARGEST_SCORE = 5.0  # standard deviations by which an input is taken to be off at most
SUMMARY_SCALE = 0.3  # of z-scored inputs beside what filters give
_AT_ONCE = 64  # worlds, which bounds the memory


@dataclass(frozen=True, eq=False)
class SequenceNetwork:
    """Filters along the strips of r routes, their largest and mean response, and layers that see these and d inputs.

    mean, std: (d,) of the inputs that are not strips, which come first; filters: weights (width, in, out), width odd,
    and bias (out,) of each layer of filters, `DILATIONS` many; layers: weights (in, out) and bias (out,) of the fully
    connected ones. A world and its mirror image are looked at and give the same.
    """

    mean: Floats
    std: Floats
    filters: tuple[tuple[Floats, Floats], ...]
    layers: tuple[tuple[Floats, Floats], ...]

    def __call__(self, inputs: Floats) -> Floats:
        """Return the outputs (n, k) of inputs (n, d + r * SAMPLES * CHANNELS)."""
        starts = range(0, max(len(inputs), 1), _AT_ONCE)
        return np.concatenate([self._some(inputs[first : first + _AT_ONCE]) for first in starts])

    def _some(self, inputs: Floats) -> Floats:
        plain, strips = divided(inputs, self.mean, self.std)
        both = [self._one_way(plain, sequences(way)) for way in (strips, mirrored(strips))]
        outputs: Floats = 0.5 * (both[0] + both[1])
        return outputs

    def _one_way(self, plain: Floats, strips: Floats) -> Floats:
        present = present_in(strips)
        longest = max(int(present.any(axis=(0, 2)).sum()), 1)
        values, present = strips[:, :longest], present[:, :longest]
        for (weights, bias), dilation in zip(self.filters, DILATIONS, strict=True):
            # Zero after the end of a route, so that what follows it does not matter.
            values = np.maximum(_convolved(values, weights, dilation) + bias, 0.0) * present
        values = np.concatenate(
            [values.max(axis=1), values.sum(axis=1) / np.maximum(present.sum(axis=1), 1.0), plain], axis=1
        )
        for weights, bias in self.layers[:-1]:
            values = np.maximum(values @ weights + bias, 0.0)
        weights, bias = self.layers[-1]
        outputs: Floats = values @ weights + bias
        return outputs


def divided(inputs: Floats, mean: Floats, std: Floats) -> tuple[Floats, Floats]:
    """Return the z-scored inputs (n, d) that sum a world up, and the strips (n, r, SAMPLES, CHANNELS)."""
    plain = SUMMARY_SCALE * np.clip((inputs[:, : len(mean)] - mean) / std, -LARGEST_SCORE, LARGEST_SCORE)
    strips = inputs[:, len(mean) :]
    return plain, strips.reshape(len(inputs), strips.shape[1] // (SAMPLES * CHANNELS), SAMPLES, CHANNELS)


def sequences(strips: Floats) -> Floats:
    """Return strips (n, r, SAMPLES, CHANNELS) side by side, (n, SAMPLES, r * CHANNELS)."""
    count, routes, samples, channels = strips.shape
    return np.swapaxes(strips, 1, 2).reshape(count, samples, routes * channels)


def present_in(side_by_side: Floats) -> Floats:
    """Return (n, SAMPLES, 1) where any of the strips side by side has a sample."""
    present: Floats = side_by_side[:, :, PRESENT::CHANNELS].max(axis=2, keepdims=True)
    return present


def _convolved(values: Floats, weights: Floats, dilation: int) -> Floats:
    """Return the response (n, s, out) to filters (width, in, out), zeros beyond the ends of values (n, s, in).

    One small product per tap: a large one would be spread over threads, which takes longer to begin than it lasts.
    """
    length = values.shape[1]
    reach = len(weights) // 2 * dilation
    padded = np.pad(values, ((0, 0), (reach, reach), (0, 0)))
    convolved: Floats = np.zeros((*values.shape[:2], weights.shape[2]))
    for number, tap in enumerate(weights):
        convolved += padded[:, number * dilation : number * dilation + length] @ tap
    return convolved
