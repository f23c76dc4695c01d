"""Training of networks that are convolved along strips of routes, in PyTorch."""

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np
import numpy.typing as npt

from barn_metrics.model.inputs import input_names
from barn_metrics.model.network_training import as_arrays, in_unit, moments, torch_on_one_thread
from barn_metrics.model.networks import DILATIONS, SequenceNetwork, divided, present_in, side_by_side
from barn_metrics.model.route import PRESENT, mirrored
from barn_worlds.base.arrays import Floats
from barn_worlds.base.config import Checked, quantity
from barn_worlds.base.errors import ConfigError


@dataclass(frozen=True)
class SequenceConfig(Checked):
    """How such a network is built and trained: AdamW on small batches, mirrored at random, mean squared error."""

    filters: int = quantity(48, "filters of each of the layers along the route", minimum=1, maximum=1024)
    width: int = quantity(7, "samples that a filter spans, odd", minimum=1, maximum=31)
    hidden_units: int = quantity(64, "units of the hidden layer after them", minimum=1, maximum=1024)
    epochs: int = quantity(20, "passes over the training worlds", minimum=1, maximum=100_000)
    batch: int = quantity(64, "worlds of a batch", minimum=1, maximum=100_000)
    learning_rate: float = quantity(0.002, "highest step of AdamW, in one cycle", minimum=1e-6, maximum=1.0)
    weight_decay: float = quantity(0.05, "of AdamW", minimum=0.0, maximum=100.0)
    dropout: float = quantity(0.2, "share of units left out in training", minimum=0.0, maximum=0.9)

    def __post_init__(self) -> None:
        super().__post_init__()
        if self.width % 2 == 0:
            raise ConfigError(f"width must be odd, got {self.width}")


def train_sequence_network(inputs: Floats, targets: Floats, seed: int, config: SequenceConfig) -> SequenceNetwork:
    """Return a network trained on inputs (n, d) of the set `strips` and targets (n, k).

    The same arguments give the same network on the same machine. Raises ModelError where torch is missing.
    """
    with torch_on_one_thread() as torch:
        return _Training(torch, inputs, targets, config, seed).run()


class _Training:
    """The training of one network; parameters are pairs of weights and bias, filters first."""

    def __init__(self, torch: Any, inputs: Floats, targets: Floats, config: SequenceConfig, seed: int) -> None:
        self._torch, self._config = torch, config
        self._chance = torch.Generator().manual_seed(seed)
        every = np.ones((1, len(inputs)), np.bool_)
        self._mean, self._std = (one[0, 0] for one in moments(inputs[:, : len(input_names("rich"))], every))
        self._shift, self._spread = (one[0, 0] for one in moments(targets, every))
        plain, strips = divided(inputs, self._mean, self._std)
        self._plain = self._tensor(plain)
        longest = max(int(strips[..., PRESENT].any(axis=(0, 1)).sum()), 1)
        both = (side_by_side(way) for way in (strips, mirrored(strips)))
        self._ways = tuple(self._tensor(np.swapaxes(way, 1, 2))[:, :, :longest] for way in both)
        self._present = self._tensor(np.swapaxes(present_in(side_by_side(strips)), 1, 2))[:, :, :longest]
        self._targets = self._tensor((targets - self._shift) / self._spread)
        self._filters, self._layers = self._initial(self._ways[0].shape[1], plain.shape[1], targets.shape[1])

    def run(self) -> SequenceNetwork:
        """Return the trained network."""
        torch, config = self._torch, self._config
        parameters = [tensor for pair in (*self._filters, *self._layers) for tensor in pair]
        optimiser = torch.optim.AdamW(parameters, lr=config.learning_rate, weight_decay=config.weight_decay)
        batches = max(len(self._plain) // config.batch, 1)
        schedule = torch.optim.lr_scheduler.OneCycleLR(optimiser, config.learning_rate, config.epochs * batches)
        for _ in range(config.epochs):
            order = torch.randperm(len(self._plain), generator=self._chance)
            for number in range(batches):
                optimiser.zero_grad()
                self._loss(order[number * config.batch : (number + 1) * config.batch]).backward()
                optimiser.step()
                schedule.step()
        return self._network()

    def _loss(self, drawn: Any) -> Any:
        turned = self._torch.rand(len(drawn), 1, 1, generator=self._chance) < 0.5
        strips = self._torch.where(turned, self._ways[1][drawn], self._ways[0][drawn])
        error = self._outputs(strips, drawn) - self._targets[drawn]
        return (error**2).sum() / error.numel()

    def _outputs(self, values: Any, drawn: Any) -> Any:
        torch, present = self._torch, self._present[drawn]
        for (weights, bias), dilation in zip(self._filters, DILATIONS, strict=True):
            padding = weights.shape[2] // 2 * dilation
            values = torch.conv1d(values, weights, bias, padding=padding, dilation=dilation).relu() * present
        values = torch.cat([values.amax(2), values.sum(2) / present.sum(2).clamp(min=1.0), self._plain[drawn]], 1)
        for weights, bias in self._layers:
            values = self._dropped_out(values) @ weights + bias
            values = values if weights is self._layers[-1][0] else values.relu()
        return values

    def _dropped_out(self, values: Any) -> Any:
        kept = self._torch.rand(values.shape, generator=self._chance) >= self._config.dropout
        return values * kept / (1.0 - self._config.dropout)

    def _initial(self, channels: int, plain: int, outputs: int) -> tuple[Sequence[Any], Sequence[Any]]:
        config = self._config
        filters = [
            self._drawn((config.filters, before, config.width), before * config.width, config.filters)
            for before in (channels, *[config.filters] * (len(DILATIONS) - 1))
        ]
        sizes = (2 * config.filters + plain, config.hidden_units, outputs)
        layers = [self._drawn((sizes[0], sizes[1]), *sizes[:2]), self._drawn((sizes[1], sizes[2]), *sizes[1:])]
        return filters, layers

    def _drawn(self, shape: tuple[int, ...], seen: int, units: int) -> tuple[Any, Any]:
        """Return weights of that shape and biases (units,), uniform within 1 / sqrt(seen) as PyTorch's own."""
        both = [self._torch.rand(one, generator=self._chance) for one in (shape, (units,))]
        return tuple(((2.0 * one - 1.0) / seen**0.5).requires_grad_() for one in both)

    def _tensor(self, values: npt.NDArray[Any]) -> Any:
        return self._torch.tensor(values, dtype=self._torch.float32)

    def _network(self) -> SequenceNetwork:
        filters, layers = ([as_arrays(pair) for pair in pairs] for pairs in (self._filters, self._layers))
        along = tuple((np.ascontiguousarray(weights.transpose(2, 1, 0)), bias) for weights, bias in filters)
        return SequenceNetwork(self._mean, self._std, along, in_unit(layers, self._shift, self._spread))
