"""Regression trees, evaluated with numpy."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
import numpy.typing as npt

Floats = npt.NDArray[np.float64]


@dataclass(frozen=True, eq=False)
class Forest:
    """The mean of regression trees, all in one table of nodes.

    roots: (t,) node at which each tree begins; column: (m,) input that a node looks at, -1 at a leaf; threshold: (m,)
    up to which it goes left; left, right: (m,) the nodes after it, always later ones; value: (m, k) output of a leaf.
    """

    roots: npt.NDArray[np.int32]
    column: npt.NDArray[np.int16]
    threshold: Floats
    left: npt.NDArray[np.int32]
    right: npt.NDArray[np.int32]
    value: npt.NDArray[np.float32]

    def __call__(self, inputs: Floats) -> Floats:
        """Return the outputs (n, k) of inputs (n, d), which are compared in single precision as in training."""
        seen = inputs.astype(np.float32)
        sample = np.arange(len(seen))[:, None]
        node = np.repeat(self.roots[None], len(seen), axis=0)
        while True:
            column = self.column[node]
            inner = column >= 0
            if not inner.any():
                break
            left = seen[sample, np.maximum(column, 0)] <= self.threshold[node]
            node = np.where(inner, np.where(left, self.left[node], self.right[node]), node)
        outputs: Floats = self.value[node].mean(axis=1, dtype=np.float64)
        return outputs
