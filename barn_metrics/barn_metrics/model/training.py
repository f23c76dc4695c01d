"""Training of the difficulty model on trials, its networks in PyTorch."""

import hashlib
import math
from collections.abc import Iterator, Mapping, Sequence
from contextlib import contextmanager
from dataclasses import dataclass

import numpy as np
import torch
from torch import Tensor

from barn_metrics.model import predictor
from barn_metrics.model.inputs import inputs_of, summary_names
from barn_metrics.model.predictor import DILATIONS, DifficultyModel, Layer, RouteNetwork
from barn_metrics.model.route import PRESENT, mirror_strips
from barn_metrics.model.trials import (
    RESERVED_DATASET,
    Trials,
    find_reserved_world,
    fold_masks,
    worlds_with_trials,
)
from barn_worlds.base.arrays import Bools, Floats
from barn_worlds.base.errors import ModelError
from barn_worlds.worlds.world import World

TITLE = "networks convolved along the clearance beside three routes, and all inputs"
_NETWORKS = 3
_CALIBRATION_FOLDS, _CALIBRATION_WORLDS = 5, 300
Parameters = tuple[Tensor, Tensor]  # weights and bias


def train(
    worlds: Mapping[int, World], trials: Trials, seed: int = 0
) -> DifficultyModel:
    """Return a model trained on all worlds that every planner of the trials was tried in.

    The same arguments give the same model. Its uncertainty comes from further models, each trained without a fifth of
    the worlds: five, or as few as leave enough worlds out.
    Raises ModelError for too few worlds, or for worlds of `RESERVED_DATASET`.
    """
    used = worlds_with_trials(worlds, trials)
    if (found := find_reserved_world(used)) is not None:
        raise ModelError(
            f"{found.name} is a world of {RESERVED_DATASET}, which judges models and is never trained on"
        )
    inputs, difficulty = inputs_of(used), trials.difficulty()
    enough = math.ceil(_CALIBRATION_WORLDS * _CALIBRATION_FOLDS / len(used))
    folds = fold_masks(len(used), _CALIBRATION_FOLDS, seed)[:enough]
    kept = np.concatenate([np.ones((1, len(used)), np.bool_), folds])
    whole, *others = train_models(inputs, trials, kept, seed)
    about = {
        "title": TITLE,
        "seed": seed,
        "planners": list(trials.planner_names),
        "training_worlds": len(used),
        "training_trials": len(trials.only(trials.world_numbers)),
        # Of the worlds' own checksums, whatever the order of the worlds.
        "worlds_sha256": hashlib.sha256(
            "\n".join(sorted(world.checksum for world in used)).encode()
        ).hexdigest(),
        "training_mse": float(np.mean((whole.difficulty(inputs)[0] - difficulty) ** 2)),
    }
    return DifficultyModel(
        whole.planners,
        whole.networks,
        _relative_std(others, folds, inputs, difficulty),
        about,
    )


def train_models(
    inputs: Floats, trials: Trials, kept: Bools, seed: int
) -> list[DifficultyModel]:
    """Return a model per row of `kept` (b, w), trained on the worlds kept there, from inputs (w, d)."""
    targets = np.concatenate([trials.times(), trials.failures()], axis=1)
    made = []
    for index, mask in enumerate(kept):
        seeds = np.random.SeedSequence([seed, 0, index]).generate_state(_NETWORKS)
        networks = tuple(
            train_network(inputs[mask], targets[mask], int(one)) for one in seeds
        )
        made.append(DifficultyModel(trials.planner_names, networks, 0.0, {}))
    return made


def _relative_std(
    models: Sequence[DifficultyModel], folds: Bools, inputs: Floats, difficulty: Floats
) -> float:
    """Return by what share of it a prediction is off beyond the members' disagreement, in 68.3 % of worlds left out."""
    beyond = []
    for model, kept in zip(models, folds, strict=True):
        predicted, spread = model.difficulty(inputs[~kept])
        off = np.maximum((predicted - difficulty[~kept]) ** 2 - spread**2, 0.0)
        beyond.append(np.sqrt(off) / predicted)
    return float(np.quantile(np.concatenate(beyond), math.erf(math.sqrt(0.5))))


@dataclass(frozen=True)
class NetworkConfig:
    """How a network is built and trained: AdamW on small batches, mirrored at random, mean squared error."""

    filters: int = 48  # of each of the layers along the route
    width: int = 7  # samples that a filter spans, odd
    hidden_units: int = 64
    epochs: int = 20
    batch: int = 64
    learning_rate: float = 0.002  # highest of one cycle
    weight_decay: float = 0.05
    dropout: float = 0.2


def train_network(
    inputs: Floats, targets: Floats, seed: int, config: NetworkConfig | None = None
) -> RouteNetwork:
    """Return a network trained on inputs (n, d) and targets (n, k), the same for the same arguments on one machine."""
    with _one_thread():
        return NetworkTraining(inputs, targets, config or NetworkConfig(), seed).run()


@contextmanager
def _one_thread() -> Iterator[None]:
    """On one thread small products are quickest, and the order of their sums does not depend on the machine."""
    threads = torch.get_num_threads()
    try:
        torch.set_num_threads(1)
        yield
    finally:
        torch.set_num_threads(threads)


class NetworkTraining:
    """The training of one network; targets and all inputs but strips are z-scored."""

    def __init__(
        self, inputs: Floats, targets: Floats, config: NetworkConfig, seed: int
    ) -> None:
        self._config = config
        self._chance = torch.Generator().manual_seed(seed)
        self._mean, self._std = predictor.moments(inputs[:, : len(summary_names())])
        self.shift, self.spread = predictor.moments(targets)
        plain, strips = predictor.split_inputs(inputs, self._mean, self._std)
        self._plain = _tensor(plain)
        longest = max(int(strips[..., PRESENT].any(axis=(0, 1)).sum()), 1)
        both = (predictor.side_by_side(way) for way in (strips, mirror_strips(strips)))
        self.ways = tuple(
            _tensor(np.swapaxes(way, 1, 2))[:, :, :longest] for way in both
        )
        self._present = _tensor(
            np.swapaxes(predictor.sample_mask(predictor.side_by_side(strips)), 1, 2)
        )[:, :, :longest]
        self._targets = _tensor((targets - self.shift) / self.spread)
        self._filters = [
            self._drawn(
                (config.filters, before, config.width),
                before * config.width,
                config.filters,
            )
            for before in (
                self.ways[0].shape[1],
                *[config.filters] * (len(DILATIONS) - 1),
            )
        ]
        sizes = (
            2 * config.filters + plain.shape[1],
            config.hidden_units,
            targets.shape[1],
        )
        self._layers = [
            self._drawn((sizes[0], sizes[1]), *sizes[:2]),
            self._drawn((sizes[1], sizes[2]), *sizes[1:]),
        ]

    def run(self) -> RouteNetwork:
        """Train, and return the network."""
        config = self._config
        parameters = [
            tensor for pair in (*self._filters, *self._layers) for tensor in pair
        ]
        optimiser = torch.optim.AdamW(
            parameters, lr=config.learning_rate, weight_decay=config.weight_decay
        )
        batches = max(len(self._plain) // config.batch, 1)
        schedule = torch.optim.lr_scheduler.OneCycleLR(
            optimiser, config.learning_rate, config.epochs * batches
        )
        for _ in range(config.epochs):
            order = torch.randperm(len(self._plain), generator=self._chance)
            for number in range(batches):
                optimiser.zero_grad()
                torch.autograd.backward(
                    self._loss(
                        order[number * config.batch : (number + 1) * config.batch]
                    )
                )
                optimiser.step()
                schedule.step()
        return self.network()

    def _loss(self, drawn: Tensor) -> Tensor:
        turned = torch.rand(len(drawn), 1, 1, generator=self._chance) < 0.5
        strips = torch.where(turned, self.ways[1][drawn], self.ways[0][drawn])
        error = self.outputs(strips, drawn) - self._targets[drawn]
        return (error**2).sum() / error.numel()

    def outputs(self, values: Tensor, drawn: Tensor) -> Tensor:
        """Return the z-scored outputs (b, k) for strips (b, channels, samples) of the drawn worlds (b,)."""
        present = self._present[drawn]
        for (weights, bias), dilation in zip(self._filters, DILATIONS, strict=True):
            padding = weights.shape[2] // 2 * dilation
            values = (
                torch.conv1d(
                    values, weights, bias, padding=padding, dilation=dilation
                ).relu()
                * present
            )
        values = torch.cat(
            [
                values.amax(2),
                values.sum(2) / present.sum(2).clamp(min=1.0),
                self._plain[drawn],
            ],
            1,
        )
        for weights, bias in self._layers:
            values = self._dropped_out(values) @ weights + bias
            values = values if weights is self._layers[-1][0] else values.relu()
        return values

    def _dropped_out(self, values: Tensor) -> Tensor:
        kept = torch.rand(values.shape, generator=self._chance) >= self._config.dropout
        return values * kept / (1.0 - self._config.dropout)

    def _drawn(self, shape: tuple[int, ...], seen: int, units: int) -> Parameters:
        """Return weights of that shape and biases (units,), uniform within 1 / sqrt(seen) as PyTorch's own."""
        weights, bias = (
            (
                (2.0 * torch.rand(one, generator=self._chance) - 1.0) / seen**0.5
            ).requires_grad_()
            for one in (shape, (units,))
        )
        return weights, bias

    def network(self) -> RouteNetwork:
        """Return the network as it stands, with targets in their own unit."""
        found = map(_arrays, self._filters)
        filters = tuple(
            (np.ascontiguousarray(one.transpose(2, 1, 0)), bias) for one, bias in found
        )
        *layers, (weights, bias) = map(_arrays, self._layers)
        last = weights * self.spread, bias * self.spread + self.shift
        return RouteNetwork(self._mean, self._std, filters, (*layers, last))


def _tensor(values: Floats) -> Tensor:
    return torch.tensor(values, dtype=torch.float32)


def _arrays(pair: Parameters) -> Layer:
    weights, bias = (tensor.detach().numpy().astype(np.float64) for tensor in pair)
    return weights, bias
