"""Training of the difficulty model: networks along routes, trained with PyTorch.

Prediction evaluates the same networks with NumPy (`barn_metrics.model.predictor`).
"""

import hashlib
import math
from collections.abc import Iterator, Mapping, Sequence
from contextlib import contextmanager
from dataclasses import dataclass

import numpy as np
import torch
from evaluation import fold_masks
from torch import Tensor
from trial_sources import (
    RESERVED_DATASET,
    Trials,
    find_reserved_world,
    worlds_with_trials,
)

from barn_metrics.model import predictor
from barn_metrics.model.inputs import inputs_of, summary_names
from barn_metrics.model.predictor import DILATIONS, DifficultyModel, Layer, RouteNetwork
from barn_metrics.model.route import PRESENT, mirror_strips
from barn_worlds.base.arrays import Bools, Floats
from barn_worlds.base.errors import ModelError
from barn_worlds.worlds.world import World

TITLE = "networks convolved along the clearance beside three routes, and all inputs"
_NETWORKS = 3
_CALIBRATION_FOLDS = 5
_CALIBRATION_WORLDS = 300

# Weights and bias of a layer.
LayerTensors = tuple[Tensor, Tensor]


def train_model(
    worlds: Mapping[int, World], trials: Trials, seed: int = 0
) -> DifficultyModel:
    """Train a model in all worlds that every planner drove.

    The same arguments give the same model. Its uncertainty comes from further models,
    each trained without a fifth of the worlds: five, or as few as leave 300 worlds out.

    Args:
        worlds: Worlds by number.
        trials: Trials in these worlds.
        seed: Seed of all randomness.

    Raises:
        ModelError: If there are too few worlds, or one is reserved for judging.
    """
    trial_worlds = worlds_with_trials(worlds, trials)
    require_trainable(trial_worlds)
    inputs = inputs_of(trial_worlds)
    difficulty = trials.difficulty()

    fold_count = math.ceil(_CALIBRATION_WORLDS * _CALIBRATION_FOLDS / len(trial_worlds))
    folds = fold_masks(len(trial_worlds), _CALIBRATION_FOLDS, seed)[:fold_count]
    masks = np.concatenate([np.ones((1, len(trial_worlds)), np.bool_), folds])
    model, *fold_models = train_models(inputs, trials, masks, seed)

    _, predicted, _ = model.evaluate(inputs)
    # Sorted, so that the order of the worlds does not matter.
    checksums = "\n".join(sorted(world.checksum for world in trial_worlds))
    description = {
        "title": TITLE,
        "seed": seed,
        "planners": list(trials.planner_names),
        "training_worlds": len(trial_worlds),
        "training_trials": len(trials.in_worlds(trials.world_numbers)),
        "worlds_sha256": hashlib.sha256(checksums.encode()).hexdigest(),
        "training_mse": float(np.mean((predicted - difficulty) ** 2)),
    }
    return DifficultyModel(
        model.planners,
        model.networks,
        _relative_std(fold_models, folds, inputs, difficulty),
        description,
    )


def require_trainable(worlds: Sequence[World]) -> None:
    """Raise ModelError if a world is reserved for judging models."""
    reserved_world = find_reserved_world(worlds)
    if reserved_world is not None:
        raise ModelError(
            f"{reserved_world.name} is a world of {RESERVED_DATASET}, which judges "
            "models and is never trained on"
        )


def targets_of(trials: Trials) -> Floats:
    """Return what networks learn: times per meter and shares of failures (w, 2 p)."""
    times = trials.mean_by_world(trials.normalized_s_per_m)
    failure_rates = 1.0 - trials.mean_by_world(trials.succeeded)
    return np.concatenate([times, failure_rates], axis=1)


def train_models(
    inputs: Floats, trials: Trials, masks: Bools, seed: int
) -> list[DifficultyModel]:
    """Train one model per mask.

    Args:
        inputs: (w, d) of the trials' worlds.
        trials: Trials in these worlds.
        masks: (b, w), True for the worlds that model b is trained in.
        seed: Seed of all randomness.
    """
    targets = targets_of(trials)
    models = []
    for number, mask in enumerate(masks):
        seeds = np.random.SeedSequence([seed, 0, number]).generate_state(_NETWORKS)
        networks = tuple(
            train_network(inputs[mask], targets[mask], int(network_seed))
            for network_seed in seeds
        )
        models.append(DifficultyModel(trials.planner_names, networks, 0.0, {}))
    return models


def _relative_std(
    models: Sequence[DifficultyModel], folds: Bools, inputs: Floats, difficulty: Floats
) -> float:
    """Return the relative error that 68.3% of the left-out worlds do not exceed.

    The disagreement of a model's networks is taken out of the error, since the
    prediction adds it again.
    """
    relative_errors = []
    for model, mask in zip(models, folds, strict=True):
        _, predicted, spread = model.evaluate(inputs[~mask])
        squared = (predicted - difficulty[~mask]) ** 2 - spread**2
        relative_errors.append(np.sqrt(np.maximum(squared, 0.0)) / predicted)
    return float(np.quantile(np.concatenate(relative_errors), math.erf(math.sqrt(0.5))))


@dataclass(frozen=True)
class NetworkConfig:
    """How a network is built and trained: AdamW on small, randomly mirrored batches."""

    # Of each of the layers along the route.
    filters: int = 48
    # Samples that a filter spans, odd.
    width: int = 7
    hidden_units: int = 64
    epochs: int = 20
    batch: int = 64
    # Highest of one cycle.
    learning_rate: float = 0.002
    weight_decay: float = 0.05
    dropout: float = 0.2


def train_network(
    inputs: Floats, targets: Floats, seed: int, config: NetworkConfig | None = None
) -> RouteNetwork:
    """Train a network; the same arguments give the same network on one machine.

    Args:
        inputs: (n, d).
        targets: (n, k), in their own unit.
        seed: Seed of weights, batches, mirroring and dropout.
        config: Size of the network and its training.
    """
    with _single_thread():
        return NetworkTraining(inputs, targets, config or NetworkConfig(), seed).run()


@contextmanager
def _single_thread() -> Iterator[None]:
    """Run PyTorch on one thread.

    Small products are fastest there, and the order of their sums does not depend on the
    number of processors.
    """
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
        """Prepare tensors and draw the first weights.

        Args:
            inputs: (n, d).
            targets: (n, k), in their own unit.
            config: Size of the network and its training.
            seed: Seed of all randomness.
        """
        self._config = config
        self._generator = torch.Generator().manual_seed(seed)
        self._mean, self._std = predictor.moments(inputs[:, : len(summary_names())])
        self.target_mean, self.target_std = predictor.moments(targets)
        summary, strips = predictor.split_inputs(inputs, self._mean, self._std)
        self._summary = _tensor(summary)
        self._targets = _tensor((targets - self.target_mean) / self.target_std)

        # Samples beyond the end of the longest route are zero in all worlds.
        longest = max(int(strips[..., PRESENT].any(axis=(0, 1)).sum()), 1)
        channels = predictor.side_by_side(strips)
        mirrored_channels = predictor.side_by_side(mirror_strips(strips))
        # Strips (n, channels, samples) as they are and mirrored.
        self.strips = _samples_last(channels)[:, :, :longest]
        self.mirrored_strips = _samples_last(mirrored_channels)[:, :, :longest]
        sample_mask = predictor.sample_mask(channels)
        self._present = _samples_last(sample_mask)[:, :, :longest]

        self._filters: list[LayerTensors] = []
        input_channels = self.strips.shape[1]
        for _ in DILATIONS:
            shape = (config.filters, input_channels, config.width)
            fan_in = input_channels * config.width
            self._filters.append(self._random_layer(shape, fan_in, config.filters))
            input_channels = config.filters

        sizes = (
            2 * config.filters + summary.shape[1],
            config.hidden_units,
            targets.shape[1],
        )
        self._layers = [
            self._random_layer((sizes[0], sizes[1]), sizes[0], sizes[1]),
            self._random_layer((sizes[1], sizes[2]), sizes[1], sizes[2]),
        ]

    def run(self) -> RouteNetwork:
        """Train all epochs and return the network."""
        config = self._config
        parameters = [
            tensor for layer in (*self._filters, *self._layers) for tensor in layer
        ]
        optimizer = torch.optim.AdamW(
            parameters, lr=config.learning_rate, weight_decay=config.weight_decay
        )
        batches = max(len(self._summary) // config.batch, 1)
        schedule = torch.optim.lr_scheduler.OneCycleLR(
            optimizer, config.learning_rate, config.epochs * batches
        )
        for _ in range(config.epochs):
            order = torch.randperm(len(self._summary), generator=self._generator)
            for number in range(batches):
                batch = order[number * config.batch : (number + 1) * config.batch]
                optimizer.zero_grad()
                torch.autograd.backward(self._loss(batch))
                optimizer.step()
                schedule.step()

        return self.network()

    def _loss(self, batch: Tensor) -> Tensor:
        """Return the mean squared error; each world of the batch is mirrored or not."""
        mirrored = torch.rand(len(batch), 1, 1, generator=self._generator) < 0.5
        strips = torch.where(mirrored, self.mirrored_strips[batch], self.strips[batch])
        error = self.outputs(strips, batch) - self._targets[batch]
        return (error**2).sum() / error.numel()

    def outputs(self, strips: Tensor, batch: Tensor) -> Tensor:
        """Return z-scored outputs (b, k).

        Args:
            strips: (b, channels, samples) of the worlds of the batch.
            batch: Numbers (b,) of these worlds.
        """
        present = self._present[batch]
        values = strips
        for (weights, bias), dilation in zip(self._filters, DILATIONS, strict=True):
            padding = weights.shape[2] // 2 * dilation
            response = torch.conv1d(
                values, weights, bias, padding=padding, dilation=dilation
            )
            # What follows the end of a route must not count.
            values = response.relu() * present

        means = values.sum(2) / present.sum(2).clamp(min=1.0)
        values = torch.cat([values.amax(2), means, self._summary[batch]], 1)
        hidden_layer, output_layer = self._layers
        weights, bias = hidden_layer
        values = (self._drop_out(values) @ weights + bias).relu()
        weights, bias = output_layer
        return self._drop_out(values) @ weights + bias

    def _drop_out(self, values: Tensor) -> Tensor:
        dropout = self._config.dropout
        mask = torch.rand(values.shape, generator=self._generator) >= dropout
        return values * mask / (1.0 - dropout)

    def _random_layer(
        self, shape: tuple[int, ...], fan_in: int, units: int
    ) -> LayerTensors:
        """Return weights of a shape and biases (units,), as PyTorch draws them."""
        weights = torch.rand(shape, generator=self._generator)
        bias = torch.rand((units,), generator=self._generator)
        scale = fan_in**0.5
        return (
            ((2.0 * weights - 1.0) / scale).requires_grad_(),
            ((2.0 * bias - 1.0) / scale).requires_grad_(),
        )

    def network(self) -> RouteNetwork:
        """Return the network as it stands, with outputs in the targets' own unit."""
        filters = []
        for layer in self._filters:
            weights, bias = _layer_arrays(layer)
            filters.append((np.ascontiguousarray(weights.transpose(2, 1, 0)), bias))

        *layers, (weights, bias) = map(_layer_arrays, self._layers)
        output_layer = (
            weights * self.target_std,
            bias * self.target_std + self.target_mean,
        )
        return RouteNetwork(
            self._mean, self._std, tuple(filters), (*layers, output_layer)
        )


def _tensor(values: Floats) -> Tensor:
    return torch.tensor(values, dtype=torch.float32)


def _samples_last(values: Floats) -> Tensor:
    """Return values (n, samples, channels) as PyTorch convolves them."""
    return _tensor(np.swapaxes(values, 1, 2))


def _layer_arrays(layer: LayerTensors) -> Layer:
    weights, bias = (tensor.detach().numpy().astype(np.float64) for tensor in layer)
    return weights, bias
