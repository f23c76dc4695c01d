"""A small fully connected network, evaluated with numpy."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
import numpy.typing as npt

Floats = npt.NDArray[np.float64]


@dataclass(frozen=True, eq=False)
class Network:
    """Rectified linear units between fully connected layers.

    mean, std: (d,) by which inputs are z-scored; layers: weights (in, out) and bias (out,) of each, first to last.
    """

    mean: Floats
    std: Floats
    layers: tuple[tuple[Floats, Floats], ...]

    def __call__(self, inputs: Floats) -> Floats:
        """Return the outputs (n, k) of inputs (n, d)."""
        values = (inputs - self.mean) / self.std
        for weights, bias in self.layers[:-1]:
            values = np.maximum(values @ weights + bias, 0.0)
        weights, bias = self.layers[-1]
        outputs: Floats = values @ weights + bias
        return outputs
