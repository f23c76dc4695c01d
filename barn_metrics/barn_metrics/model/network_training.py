"""Training of small fully connected networks in PyTorch, many at once."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from itertools import pairwise
from typing import Any

import numpy as np
import numpy.typing as npt

from barn_metrics.model.network import Network
from barn_metrics.model.torch_import import torch_on_one_thread
from barn_worlds.config import Checked, quantity

Floats = npt.NDArray[np.float64]


@dataclass(frozen=True)
class NetworkConfig(Checked):
    """How a network is built and trained: full batches, AdamW, mean squared error, rectified linear units."""

    hidden_layers: int = quantity(2, "number of hidden layers", minimum=1, maximum=8)
    hidden_units: int = quantity(64, "units of each", minimum=1, maximum=1024)
    epochs: int = quantity(2000, "passes over the training worlds", minimum=1, maximum=100_000)
    learning_rate: float = quantity(0.003, "step of AdamW, falling to zero along a cosine", minimum=1e-6, maximum=1.0)
    weight_decay: float = quantity(0.0, "of AdamW", minimum=0.0, maximum=100.0)


def train_networks(
    inputs: Floats, targets: Floats, kept: npt.NDArray[np.bool_], config: NetworkConfig, seeds: Sequence[int]
) -> list[Network]:
    """Return one network per row of `kept`, each trained on its own samples and from its own seed.

    inputs: (n, d); targets: (n, k), NaN where unknown, which then counts nothing; kept: (b, n), the samples that a
    network sees. Inputs and targets are z-scored with the mean and standard deviation of these samples, as in the paper
    (Sec. IV-A2). All networks are trained side by side in one batched product; the result of one does not depend on the
    others. Raises ModelError where torch is missing.
    """
    with torch_on_one_thread() as torch:
        return _train(torch, inputs, targets, kept, config, seeds)


def _train(
    torch: Any,
    inputs: Floats,
    targets: Floats,
    kept: npt.NDArray[np.bool_],
    config: NetworkConfig,
    seeds: Sequence[int],
) -> list[Network]:
    known = kept[:, :, None] & np.isfinite(targets)[None]
    mean, std = moments(np.broadcast_to(inputs, (len(kept), *inputs.shape)), kept[:, :, None])
    target_mean, target_std = moments(np.broadcast_to(targets, (len(kept), *targets.shape)), known)
    x = torch.tensor((inputs - mean) / std, dtype=torch.float32)
    y = torch.tensor(np.where(known, (targets - target_mean) / target_std, 0.0), dtype=torch.float32)
    share = torch.tensor(known / known.sum(axis=(1, 2), keepdims=True), dtype=torch.float32)
    layers = _initial(torch, [inputs.shape[1], *[config.hidden_units] * config.hidden_layers, targets.shape[1]], seeds)
    parameters = [tensor for layer in layers for tensor in layer]
    optimiser = torch.optim.AdamW(parameters, lr=config.learning_rate, weight_decay=config.weight_decay)
    schedule = torch.optim.lr_scheduler.CosineAnnealingLR(optimiser, config.epochs)
    for _ in range(config.epochs):
        optimiser.zero_grad()
        # A sum over networks, so that each has the gradient of its own mean squared error.
        loss = (share * (_forward(torch, layers, x) - y) ** 2).sum()
        loss.backward()
        optimiser.step()
        schedule.step()
    trained = [[tensor.detach().numpy().astype(np.float64) for tensor in layer] for layer in layers]
    return [
        _network(mean[b, 0], std[b, 0], [(weights[b], bias[b, 0]) for weights, bias in trained], scale)
        for b, scale in enumerate(zip(target_mean[:, 0], target_std[:, 0], strict=True))
    ]


def moments(values: Floats, known: npt.NDArray[np.bool_]) -> tuple[Floats, Floats]:
    """Return mean and standard deviation over the known samples (b, n, d), each (b, 1, d); 1 for what does not vary."""
    count = np.maximum(known.sum(axis=1, keepdims=True), 1)
    mean = np.where(known, values, 0.0).sum(axis=1, keepdims=True) / count
    std = np.sqrt((np.where(known, values - mean, 0.0) ** 2).sum(axis=1, keepdims=True) / count)
    return mean, np.where(std > 1e-9, std, 1.0)


def _initial(torch: Any, sizes: Sequence[int], seeds: Sequence[int]) -> list[tuple[Any, Any]]:
    """Return weights (b, in, out) and biases (b, 1, out) per layer, uniform within 1 / sqrt(in) as PyTorch's own."""
    generators = [torch.Generator().manual_seed(seed) for seed in seeds]
    layers = []
    for first, second in pairwise(sizes):
        drawn = [torch.rand(first + 1, second, generator=one) for one in generators]
        both = (2.0 * torch.stack(drawn) - 1.0) / first**0.5
        layers.append((both[:, :first].clone().requires_grad_(), both[:, first:].clone().requires_grad_()))
    return layers


def _forward(torch: Any, layers: Sequence[tuple[Any, Any]], x: Any) -> Any:
    for weights, bias in layers[:-1]:
        x = torch.relu(torch.baddbmm(bias, x, weights))
    return torch.baddbmm(layers[-1][1], x, layers[-1][0])


def _network(mean: Floats, std: Floats, layers: list[tuple[Floats, Floats]], scale: tuple[Floats, Floats]) -> Network:
    """Return a network that gives the targets in their own unit: the last layer takes their scale in."""
    shift, spread = scale
    weights, bias = layers[-1]
    layers[-1] = (weights * spread, bias * spread + shift)
    return Network(mean, std, tuple(layers))
