"""What difficulty models are compared with: the mean, ridge regression and randomised trees."""

from collections.abc import Callable

import numpy as np

from barn_metrics.model.networks import Network
from barn_worlds.arrays import Floats
from barn_worlds.errors import ModelError

_PENALTIES = np.logspace(-1.0, 4.0, 26)


def train_mean(inputs: Floats, targets: Floats, _seed: int = 0) -> Network:
    """Return the mean of targets (n, k), whatever the inputs (n, d)."""
    size = inputs.shape[1]
    return Network(np.zeros(size), np.ones(size), ((np.zeros((size, targets.shape[1])), targets.mean(axis=0)),))


def train_ridge(inputs: Floats, targets: Floats, _seed: int = 0) -> Network:
    """Return ridge regression of targets (n, k) on inputs (n, d), as a network without hidden layers.

    The penalty on z-scored inputs is, for each target, that of the lowest error of predicting each sample from all
    others.
    """
    mean, std = inputs.mean(axis=0), inputs.std(axis=0)
    std = np.where(std > 1e-9, std, 1.0)
    left, singular, right = np.linalg.svd((inputs - mean) / std, full_matrices=False)
    bias = targets.mean(axis=0)
    along = left.T @ (targets - bias)
    shrunk = singular**2 / (singular**2 + _PENALTIES[:, None])  # (penalties, r)
    fitted = np.einsum("nr,pr,rk->pnk", left, shrunk, along)
    leverage = np.einsum("nr,pr->pn", left**2, shrunk) + 1.0 / len(inputs)
    errors = (((targets - bias)[None] - fitted) / (1.0 - leverage)[:, :, None]) ** 2
    best = errors.mean(axis=1).argmin(axis=0)
    weights = right.T @ (shrunk[best].T / np.maximum(singular, 1e-12)[:, None] * along)
    return Network(mean, std, ((weights, bias),))


def train_trees(inputs: Floats, targets: Floats, seed: int, smallest_leaf: int) -> Callable[[Floats], Floats]:
    """Return the mean of 200 extremely randomised trees (Geurts et al. 2006) as a function of inputs (n, d).

    smallest_leaf: fewest samples in a leaf. Raises ModelError where scikit-learn, which is optional, is missing.
    """
    try:
        from sklearn.ensemble import ExtraTreesRegressor  # noqa: PLC0415
    except ImportError:
        raise ModelError("training of trees needs scikit-learn: pip install scikit-learn") from None
    fitted = ExtraTreesRegressor(200, min_samples_leaf=smallest_leaf, max_features=0.7, random_state=seed)
    fitted.fit(inputs, targets[:, 0] if targets.shape[1] == 1 else targets)

    def predict(unseen: Floats) -> Floats:
        each = [tree.predict(unseen).reshape(len(unseen), 1, -1) for tree in fitted.estimators_]
        # In single precision, as the numbers of docs/results.json were made.
        outputs: Floats = np.concatenate(each, axis=1).astype(np.float32).mean(axis=1, dtype=np.float64)
        return outputs

    return predict
