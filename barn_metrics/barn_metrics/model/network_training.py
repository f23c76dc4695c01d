"""Training of small fully connected networks in PyTorch, many at once."""

from collections.abc import Iterator, Sequence
from contextlib import contextmanager
from dataclasses import dataclass
from itertools import pairwise
from typing import Any

import numpy as np
import numpy.typing as npt

from barn_metrics.model.networks import Layer, Network
from barn_worlds.base.arrays import Floats
from barn_worlds.base.config import Checked, quantity
from barn_worlds.base.errors import ModelError

Mask = npt.NDArray[np.bool_]


@dataclass(frozen=True)
class NetworkConfig(Checked):
    """How a network is built and trained: full batches, AdamW, mean squared error, rectified linear units."""

    hidden_layers: int = quantity(2, "number of hidden layers", minimum=1, maximum=8)
    hidden_units: int = quantity(64, "units of each", minimum=1, maximum=1024)
    epochs: int = quantity(2000, "passes over the training worlds", minimum=1, maximum=100_000)
    learning_rate: float = quantity(0.003, "step of AdamW, falling to zero along a cosine", minimum=1e-6, maximum=1.0)
    weight_decay: float = quantity(0.0, "of AdamW", minimum=0.0, maximum=100.0)


@contextmanager
def torch_on_one_thread() -> Iterator[Any]:
    """Give torch, which is optional and slow to load; ModelError where it is missing.

    On one thread small products are quickest, and the order of their sums does not depend on the machine.
    """
    try:
        import torch  # noqa: PLC0415
    except ImportError:
        raise ModelError("training of networks needs PyTorch: pip install torch") from None
    threads = torch.get_num_threads()
    try:
        torch.set_num_threads(1)
        yield torch
    finally:
        torch.set_num_threads(threads)


def train_networks(
    inputs: Floats, targets: Floats, kept: Mask, config: NetworkConfig, seeds: Sequence[int]
) -> list[Network]:
    """Return one network per row of `kept`, each trained on its own samples and from its own seed.

    inputs: (n, d); targets: (n, k); kept: (b, n), the samples that a network sees. Inputs and targets are z-scored with
    the mean and standard deviation of these samples, as in the paper (Sec. IV-A2).
    All networks are trained side by side in one batched product; the result of one does not depend on the others.
    Raises ModelError where torch is missing.
    """
    mean, std = moments(inputs, kept)
    shift, spread = moments(targets, kept)
    with torch_on_one_thread() as torch:
        x = torch.tensor((inputs - mean) / std, dtype=torch.float32)
        y = torch.tensor(np.where(kept[:, :, None], (targets - shift) / spread, 0.0), dtype=torch.float32)
        count = kept.sum(axis=1)[:, None, None] * targets.shape[1]
        share = torch.tensor(kept[:, :, None] / count, dtype=torch.float32)
        sizes = [inputs.shape[1], *[config.hidden_units] * config.hidden_layers, targets.shape[1]]
        layers = _initial(torch, sizes, seeds)
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
    trained = [as_arrays(layer) for layer in layers]
    return [
        Network(mean[b, 0], std[b, 0], in_unit([(weights[b], bias[b, 0]) for weights, bias in trained], *scale))
        for b, scale in enumerate(zip(shift[:, 0], spread[:, 0], strict=True))
    ]


def moments(values: Floats, kept: Mask) -> tuple[Floats, Floats]:
    """Return mean and standard deviation of values (n, d) over each row of kept (b, n), each (b, 1, d).

    The deviation of what does not vary is 1.
    """
    some, count = kept[:, :, None], kept.sum(axis=1)[:, None, None]
    mean = np.where(some, values, 0.0).sum(axis=1, keepdims=True) / count
    std = np.sqrt((np.where(some, values - mean, 0.0) ** 2).sum(axis=1, keepdims=True) / count)
    return mean, np.where(std > 1e-9, std, 1.0)


def as_arrays(layer: tuple[Any, Any]) -> Layer:
    """Return trained weights and bias as numpy's arrays."""
    weights, bias = (tensor.detach().numpy().astype(np.float64) for tensor in layer)
    return weights, bias


def in_unit(layers: Sequence[Layer], shift: Floats, spread: Floats) -> tuple[Layer, ...]:
    """Return layers trained on z-scored targets (k,) as layers that give the targets in their own unit."""
    weights, bias = layers[-1]
    return (*layers[:-1], (weights * spread, bias * spread + shift))


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
