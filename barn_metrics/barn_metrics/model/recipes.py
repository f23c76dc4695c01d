"""The ways to predict difficulty that are compared: what each sees, what it consists of."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
import numpy.typing as npt

from barn_metrics.model.errors import ModelError
from barn_metrics.model.forest import Forest
from barn_metrics.model.forest_training import ForestConfig, train_forest
from barn_metrics.model.linear import train_linear
from barn_metrics.model.network import Network
from barn_metrics.model.network_training import NetworkConfig, train_networks
from barn_metrics.model.predictor import Member
from barn_metrics.model.sequence_training import SequenceConfig, train_sequence_network
from barn_metrics.model.trials import Trials, mean_by
from barn_worlds.errors import suggest

Floats = npt.NDArray[np.float64]
Kept = npt.NDArray[np.bool_]

_AT_ONCE = 60  # networks that are trained side by side


@dataclass(frozen=True)
class Mean:
    """The mean of the training worlds, whatever the world."""


@dataclass(frozen=True)
class Linear:
    """Ridge regression."""


@dataclass(frozen=True)
class Networks:
    """Networks that differ in their seed."""

    config: NetworkConfig
    count: int = 1


@dataclass(frozen=True)
class Sequences:
    """Networks along strips of routes that differ in their seed."""

    config: SequenceConfig
    count: int = 3


Part = Mean | Linear | Networks | Sequences | ForestConfig


@dataclass(frozen=True)
class Recipe:
    """What a model sees and what it averages.

    inputs: a set of `barn_metrics.model.inputs`; parts: each weighs the same; per_planner: the time of each planner and
    its share of failures are predicted instead of the difficulty alone.
    """

    title: str
    inputs: str
    parts: tuple[Part, ...]
    per_planner: bool = False


_RICH_NETWORKS = Networks(NetworkConfig(epochs=100, weight_decay=10.0), count=3)
_RECIPES = {
    "mean": Recipe("mean of the training worlds", "five", (Mean(),)),
    "linear": Recipe("ridge regression on the five metrics", "five", (Linear(),)),
    "trees": Recipe("randomised trees on the five metrics", "five", (ForestConfig(smallest_leaf=5),)),
    "paper": Recipe("the paper's network", "five", (Networks(NetworkConfig(epochs=700, learning_rate=0.01)),)),
    "paper_regularised": Recipe(
        "the paper's network, held back from overfitting",
        "five",
        (Networks(NetworkConfig(epochs=150, weight_decay=10.0)),),
    ),
    "rich_linear": Recipe("ridge regression on all inputs", "rich", (Linear(),), per_planner=True),
    "rich_trees": Recipe("randomised trees on all inputs", "rich", (ForestConfig(),), per_planner=True),
    "rich_networks": Recipe("networks on all inputs", "rich", (_RICH_NETWORKS,), per_planner=True),
    "rich": Recipe(
        "ridge regression, randomised trees and networks on all inputs, averaged",
        "rich",
        (Linear(), ForestConfig(), _RICH_NETWORKS),
        per_planner=True,
    ),
    "routes": Recipe(
        "networks convolved along the clearance beside three routes, and all inputs",
        "strips",
        (Sequences(SequenceConfig()),),
        per_planner=True,
    ),
}
RECIPES = tuple(_RECIPES)


def recipe_named(name: str) -> Recipe:
    """Return the recipe of that name; ModelError names the near one."""
    if name not in _RECIPES:
        raise ModelError(f"unknown recipe {name!r}{suggest(name, RECIPES)}")
    return _RECIPES[name]


def targets_of(recipe: Recipe, trials: Trials) -> Floats:
    """Return what the recipe learns of each of the trials' worlds: (w, 1) or, of p planners, (w, 2 p)."""
    if not recipe.per_planner:
        return trials.difficulty()[:, None]
    times, failures = [], []
    for planner in trials.planner_names:
        mine = trials.of(planner)
        times.append(trials.means(planner))
        failures.append(1.0 - mean_by(mine.worlds, mine.succeeded.astype(np.float64), trials.world_numbers))
    return np.stack(times + failures, axis=1)


def train_members(recipe: Recipe, inputs: Floats, targets: Floats, kept: Kept, seed: int) -> list[tuple[Member, ...]]:
    """Return the members of one model per row of `kept` (b, w), each trained on the worlds kept there.

    inputs: (w, d); targets: (w, k). The models do not depend on each other, but each on its place among them.
    """
    made: list[list[Member]] = [[] for _ in kept]
    for number, part in enumerate(recipe.parts):
        weight = 1.0 / len(recipe.parts)
        if isinstance(part, Networks):
            networks = _networks(part, inputs, targets, kept, (seed, number))
            for index, members in enumerate(made):
                mine = networks[index * part.count : (index + 1) * part.count]
                members += [Member(network, weight / part.count) for network in mine]
            continue
        for index, members in enumerate(made):
            x, y = inputs[kept[index]], targets[kept[index]]
            members.extend(_several(part, x, y, (seed, number, index), weight))
    return [tuple(members) for members in made]


def _several(
    part: Mean | Linear | ForestConfig | Sequences, x: Floats, y: Floats, entropy: tuple[int, ...], weight: float
) -> list[Member]:
    if not isinstance(part, Sequences):
        return [Member(_one(part, x, y, _seeds(entropy, 1)[0]), weight)]
    made = [train_sequence_network(x, y, part.config, seed) for seed in _seeds(entropy, part.count)]
    return [Member(network, weight / part.count) for network in made]


def _one(part: Mean | Linear | ForestConfig, x: Floats, y: Floats, seed: int) -> Network | Forest:
    if isinstance(part, ForestConfig):
        return train_forest(x, y, part, seed)
    if isinstance(part, Linear):
        return train_linear(x, y)
    flat = np.zeros(x.shape[1])
    return Network(flat, flat + 1.0, ((np.zeros((x.shape[1], y.shape[1])), y.mean(axis=0)),))


def _networks(part: Networks, inputs: Floats, targets: Floats, kept: Kept, entropy: tuple[int, ...]) -> list[Network]:
    repeated = np.repeat(kept, part.count, axis=0)
    seeds = _seeds(entropy, len(repeated))
    made: list[Network] = []
    for first in range(0, len(repeated), _AT_ONCE):
        some = slice(first, first + _AT_ONCE)
        made += train_networks(inputs, targets, repeated[some], part.config, seeds[some])
    return made


def _seeds(entropy: Sequence[int], count: int) -> list[int]:
    return [int(state) for state in np.random.SeedSequence(list(entropy)).generate_state(count)]
