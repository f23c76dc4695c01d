"""Ridge regression, whose penalty is chosen by leaving one world out."""

from __future__ import annotations

import numpy as np
import numpy.typing as npt

from barn_metrics.model.network import Network

Floats = npt.NDArray[np.float64]

_PENALTIES = np.logspace(-1.0, 4.0, 26)


def train_linear(inputs: Floats, targets: Floats) -> Network:
    """Return a network without hidden layers, fitted to inputs (n, d) and targets (n, k).

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
