"""The models that are compared: what each sees, and what it averages."""

from collections.abc import Callable, Sequence
from dataclasses import dataclass
from functools import partial

import numpy as np

from barn_metrics.model.network_training import Mask, NetworkConfig, train_networks
from barn_metrics.model.networks import Network
from barn_metrics.model.predictor import Function, Member
from barn_metrics.model.sequence_training import SequenceConfig, train_sequence_network
from barn_metrics.model.trials import Trials, mean_by
from barn_worlds.base.arrays import Floats
from barn_worlds.base.errors import ModelError, suggest

_PENALTIES = np.logspace(-1.0, 4.0, 26)
# Trains a function on inputs (w, d), targets (w, k) and a seed; of networks only the configuration is given, as they
# are trained side by side.
Train = Callable[[Floats, Floats, int], Function] | NetworkConfig

_AT_ONCE = 60  # networks that are trained side by side


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


@dataclass(frozen=True)
class Recipe:
    """A way to make a model.

    inputs: a set of `barn_metrics.model.inputs`; parts: each weighs the same, and is the average of as many functions
    as its number says; per_planner: the time of each planner and its share of failures are predicted instead of the
    difficulty alone; stored: weights of such a model fit in a file, which has no place for trees.
    """

    title: str
    inputs: str
    parts: tuple[tuple[Train, int], ...]
    per_planner: bool = False
    stored: bool = True


SHIPPED, PAPER, REGULARISED = "routes", "paper", "paper_regularised"
_RECIPES = {
    "mean": Recipe("mean of the training worlds", "five", ((train_mean, 1),)),
    "linear": Recipe("ridge regression on the five metrics", "five", ((train_ridge, 1),)),
    "trees": Recipe(
        "randomised trees on the five metrics", "five", ((partial(train_trees, smallest_leaf=5), 1),), stored=False
    ),
    PAPER: Recipe("the paper's network", "five", ((NetworkConfig(epochs=700, learning_rate=0.01), 1),)),
    REGULARISED: Recipe(
        "the paper's network, held back from overfitting",
        "five",
        ((NetworkConfig(epochs=150, weight_decay=10.0), 1),),
    ),
    "rich": Recipe(
        "ridge regression, randomised trees and networks on all inputs, averaged",
        "rich",
        (
            (train_ridge, 1),
            (partial(train_trees, smallest_leaf=2), 1),
            (NetworkConfig(epochs=100, weight_decay=10.0), 3),
        ),
        per_planner=True,
        stored=False,
    ),
    SHIPPED: Recipe(
        "networks convolved along the clearance beside three routes, and all inputs",
        "strips",
        ((partial(train_sequence_network, config=SequenceConfig()), 3),),
        per_planner=True,
    ),
}
RECIPES = tuple(_RECIPES)


def recipe_named(name: str) -> Recipe:
    """Return the recipe of that name; ModelError names the near one."""
    if name not in _RECIPES:
        raise ModelError(f"unknown recipe {name!r}{suggest(name, RECIPES)}")
    return _RECIPES[name]


def check_stored(name: str) -> None:
    """Raise ModelError for a recipe whose models cannot be written to a file of weights."""
    if not recipe_named(name).stored:
        others = ", ".join(one for one in RECIPES if _RECIPES[one].stored)
        raise ModelError(f"recipe {name!r} has trees, which a file of weights cannot hold; choose from {others}")


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


def train_members(recipe: Recipe, inputs: Floats, targets: Floats, kept: Mask, seed: int) -> list[tuple[Member, ...]]:
    """Return the members of one model per row of `kept` (b, w), each trained on the worlds kept there.

    inputs: (w, d); targets: (w, k). The models do not depend on each other, but each on its place among them.
    """
    made: list[list[Member]] = [[] for _ in kept]
    for number, (train, count) in enumerate(recipe.parts):
        if isinstance(train, NetworkConfig):
            functions = _networks(train, count, inputs, targets, kept, (seed, number))
        else:
            seeds = [_seeds((seed, number, index), count) for index in range(len(kept))]
            functions = [
                train(inputs[mask], targets[mask], one) for mask, own in zip(kept, seeds, strict=True) for one in own
            ]
        for index, members in enumerate(made):
            own = functions[index * count : (index + 1) * count]
            members += [Member(one, 1.0 / len(recipe.parts) / count) for one in own]
    return [tuple(members) for members in made]


def _networks(
    config: NetworkConfig, count: int, inputs: Floats, targets: Floats, kept: Mask, entropy: tuple[int, ...]
) -> list[Function]:
    """Return so many networks for each row of `kept`, one row after the other."""
    repeated = np.repeat(kept, count, axis=0)
    seeds = _seeds(entropy, len(repeated))
    made: list[Function] = []
    for first in range(0, len(repeated), _AT_ONCE):
        some = slice(first, first + _AT_ONCE)
        made += train_networks(inputs, targets, repeated[some], config, seeds[some])
    return made


def _seeds(entropy: Sequence[int], count: int) -> list[int]:
    return [int(state) for state in np.random.SeedSequence(list(entropy)).generate_state(count)]
