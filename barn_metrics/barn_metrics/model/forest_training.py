"""Training of forests with scikit-learn: the only place that imports it."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

import numpy as np
import numpy.typing as npt

from barn_metrics.model.errors import ModelError
from barn_metrics.model.forest import Forest
from barn_worlds.config import Checked, quantity

Floats = npt.NDArray[np.float64]


@dataclass(frozen=True)
class ForestConfig(Checked):
    """Extremely randomised trees (Geurts et al. 2006): thresholds are drawn, the best of them is taken."""

    trees: int = quantity(200, "number of trees", minimum=1, maximum=10_000)
    smallest_leaf: int = quantity(2, "fewest worlds in a leaf", minimum=1, maximum=1000)
    inputs_share: float = quantity(0.7, "share of the inputs looked at for a split", minimum=0.01, maximum=1.0)


def train_forest(inputs: Floats, targets: Floats, config: ForestConfig, seed: int) -> Forest:
    """Return trees trained on inputs (n, d) and targets (n, k); ModelError where scikit-learn is missing."""
    try:
        from sklearn.ensemble import ExtraTreesRegressor  # noqa: PLC0415 (optional)
    except ImportError:
        raise ModelError("training of trees needs scikit-learn: pip install scikit-learn") from None
    fitted = ExtraTreesRegressor(
        config.trees,
        min_samples_leaf=config.smallest_leaf,
        max_features=config.inputs_share,
        random_state=seed,
        n_jobs=1,
    ).fit(inputs, targets[:, 0] if targets.shape[1] == 1 else targets)
    return joined([tree.tree_ for tree in fitted.estimators_])


def joined(trees: list[Any]) -> Forest:
    """Return scikit-learn's trees as one table of nodes."""
    first = np.cumsum([0] + [tree.node_count for tree in trees])
    leaf = np.concatenate([tree.children_left for tree in trees]) < 0
    shift = np.repeat(first[:-1], np.diff(first))

    def after(name: str) -> npt.NDArray[np.int32]:
        return np.where(leaf, 0, np.concatenate([getattr(tree, name) for tree in trees]) + shift).astype(np.int32)

    return Forest(
        first[:-1].astype(np.int32),
        np.where(leaf, -1, np.concatenate([tree.feature for tree in trees])).astype(np.int16),
        np.where(leaf, 0.0, np.concatenate([tree.threshold for tree in trees])),
        after("children_left"),
        after("children_right"),
        np.concatenate([tree.value[:, :, 0] for tree in trees]).astype(np.float32),
    )
