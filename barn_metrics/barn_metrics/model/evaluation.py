"""What difficulty models are worth on worlds that they have not seen.

They are trained on other worlds of the same trials, by repeated k-fold over worlds, or on further trials alone.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass

import numpy as np
import numpy.typing as npt

from barn_metrics.bootstrap import Interval
from barn_metrics.model.ceiling import Ceiling, noise_ceiling
from barn_metrics.model.errors import ModelError
from barn_metrics.model.inputs import inputs_of
from barn_metrics.model.intervals import over_worlds, pearson_of_ranks
from barn_metrics.model.predictor import DifficultyModel
from barn_metrics.model.recipes import RECIPES, recipe_named, targets_of, train_members
from barn_metrics.model.training import fold_masks, trained_worlds
from barn_metrics.model.trials import Trials
from barn_worlds.config import Checked, quantity
from barn_worlds.errors import suggest
from barn_worlds.world import World

Floats = npt.NDArray[np.float64]
Progress = Callable[[int, int], None]

PAPER, REGULARISED = "paper", "paper_regularised"


@dataclass(frozen=True)
class EvaluationConfig(Checked):
    """How models are judged: each fold by a model that was trained on all others, again with other folds."""

    folds: int = quantity(10, "parts that the worlds are divided into", minimum=2, maximum=1000)
    repeats: int = quantity(5, "divisions", minimum=1, maximum=1000)
    seed: int = quantity(0, "of divisions and training", minimum=0, maximum=2**62)


@dataclass(frozen=True)
class RecipeScore:
    """The errors of one recipe; squared errors in (s/m)^2, absolute ones in s/m, intervals of 95 % over worlds.

    training_mse: of the folds' models on the worlds that they were trained on. mse, mae, r2, spearman: of held-out
    worlds, averaged over repeats. improvement, improvement_regularised: mean squared error of the paper's network, as
    published and held back from overfitting, minus this recipe's on the same worlds (paired): above 0 this one is
    better. predictions: held-out, mean over repeats, of each of the evaluation's worlds.
    """

    recipe: str
    title: str
    training_mse: float
    mse: Interval
    mae: Interval
    r2: Interval
    spearman: Interval
    improvement: Interval | None
    improvement_regularised: Interval | None
    predictions: tuple[float, ...]


@dataclass(frozen=True)
class Evaluation:
    """What recipes are worth on some trials.

    difficulty: of each of world_numbers, measured, s/m; notes: what was left out, and why. further_worlds,
    further_trials: how many other ones the models were trained on; 0 where they were trained on folds.
    """

    worlds: int
    trials: int
    planners: tuple[str, ...]
    folds: int
    repeats: int
    seed: int
    world_numbers: tuple[int, ...]
    difficulty: tuple[float, ...]
    scores: tuple[RecipeScore, ...]
    ceiling: Ceiling
    notes: tuple[str, ...]
    further_worlds: int = 0
    further_trials: int = 0

    def score(self, recipe: str) -> RecipeScore:
        """Return the score of a recipe; ModelError if it was not evaluated."""
        found = {score.recipe: score for score in self.scores}
        if recipe not in found:
            raise ModelError(f"recipe {recipe!r} was not evaluated{suggest(recipe, found)}")
        return found[recipe]


@dataclass(frozen=True, eq=False)
class _Sample:
    """Worlds, in the order of the trials' world_numbers, and the trials in them."""

    worlds: list[World]
    trials: Trials


@dataclass(frozen=True, eq=False)
class _HeldOut:
    """Predictions (repeats, w) by models that had not seen the world, and the mean error of training."""

    predicted: Floats
    training_mse: float


def evaluate(
    worlds: Mapping[int, World],
    trials: Trials,
    recipes: Sequence[str] = RECIPES,
    config: EvaluationConfig | None = None,
    progress: Progress | None = None,
    further: tuple[Mapping[int, World], Trials] | None = None,
) -> Evaluation:
    """Return the held-out errors of recipes on the worlds that every planner was tried in.

    progress is called with the number of recipes that are done and that of all. further: other worlds and the trials
    in them; models are trained on these alone and not on folds. A recipe whose library is missing is left out with a
    note, unless it is the only one. Raises ModelError for too few worlds, an unknown recipe, or further trials in a
    world that is judged, or of other planners.
    """
    chosen = config or EvaluationConfig()
    own = _sample(worlds, trials)
    if further is None and len(own.worlds) < 2 * chosen.folds:
        raise ModelError(f"{chosen.folds} folds need at least {2 * chosen.folds} worlds, got {len(own.worlds)}")
    other = None if further is None else _sample(*further)
    if other is not None:
        _check_apart(own, other)
    difficulty = own.trials.difficulty()
    sets = {recipe_named(recipe).inputs for recipe in recipes}
    inputs = {name: [inputs_of(one.worlds, name) for one in (own, other) if one] for name in sets}
    found: dict[str, _HeldOut] = {}
    notes: list[str] = []
    for count, recipe in enumerate(recipes):
        if progress is not None:
            progress(count, len(recipes))
        try:
            found[recipe] = _held_out(recipe, inputs[recipe_named(recipe).inputs], own, other, chosen)
        except ModelError as error:
            notes.append(f"{recipe} is left out: {error}")
    if not found:
        raise ModelError(notes[0])
    if progress is not None:
        progress(len(recipes), len(recipes))
    errors = {recipe: ((one.predicted - difficulty) ** 2).mean(axis=0) for recipe, one in found.items()}
    return Evaluation(
        len(own.worlds),
        len(own.trials),
        own.trials.planner_names,
        chosen.folds,
        chosen.repeats,
        chosen.seed,
        own.trials.world_numbers,
        tuple(difficulty.tolist()),
        tuple(_score(recipe, one, errors, difficulty) for recipe, one in found.items()),
        noise_ceiling(own.trials, chosen.seed),
        tuple(notes),
        len(other.worlds) if other else 0,
        len(other.trials) if other else 0,
    )


def paired_gain(worse: Sequence[float], better: Sequence[float], measured: Sequence[float]) -> Interval:
    """Return by how much the mean squared error of predictions lies below that of others, with 95 % over worlds.

    Predictions (w,) are of the same worlds, so that models of two evaluations can be compared.
    """
    squared = [(np.array(one) - np.array(measured)) ** 2 for one in (worse, better)]
    return over_worlds(lambda drawn: (squared[0] - squared[1])[drawn].mean(axis=-1), len(measured))


def _sample(worlds: Mapping[int, World], trials: Trials) -> _Sample:
    numbers = trained_worlds(worlds, trials)
    return _Sample([worlds[number] for number in numbers], trials.only(numbers))


def _check_apart(own: _Sample, other: _Sample) -> None:
    judged = {world.checksum: number for number, world in zip(own.trials.world_numbers, own.worlds, strict=True)}
    both = next((judged[world.checksum] for world in other.worlds if world.checksum in judged), None)
    if both is not None:
        raise ModelError(f"world {both} is judged and among the further trials; a model must not have seen it")
    if own.trials.planner_names != other.trials.planner_names:
        names = [", ".join(one.trials.planner_names) for one in (own, other)]
        raise ModelError(f"further trials must be of the same planners, {names[0]}, got {names[1]}")


def _held_out(
    recipe: str, inputs: Sequence[Floats], own: _Sample, other: _Sample | None, config: EvaluationConfig
) -> _HeldOut:
    """Return predictions of the own worlds by models that were trained on folds of them, or on the other ones."""
    chosen = recipe_named(recipe)
    samples = [one for one in (own, other) if one is not None]
    seen = np.concatenate(inputs)
    targets = np.concatenate([targets_of(chosen, one.trials) for one in samples])
    difficulty = np.concatenate([one.trials.difficulty() for one in samples])
    count = len(own.worlds)
    predicted = np.zeros((config.repeats, count))
    training = []
    for repeat in range(config.repeats):
        seed = config.seed + repeat
        kept = fold_masks(count, config.folds, seed) if other is None else np.arange(len(seen))[None] >= count
        planners = own.trials.planner_names if chosen.per_planner else ()
        for mask, members in zip(kept, train_members(chosen, seen, targets, kept, seed), strict=True):
            model = DifficultyModel(recipe, chosen.inputs, planners, members, 0.0, {})
            given = model.difficulty(seen)
            predicted[repeat, ~mask[:count]] = given[:count][~mask[:count]]
            training.append(float(np.mean((given - difficulty)[mask] ** 2)))
    return _HeldOut(predicted, float(np.mean(training)))


def _score(recipe: str, found: _HeldOut, errors: Mapping[str, Floats], difficulty: Floats) -> RecipeScore:
    squared = errors[recipe]
    absolute = np.abs(found.predicted - difficulty).mean(axis=0)

    def r2(drawn: npt.NDArray[np.int64]) -> Floats:
        explained: Floats = 1.0 - squared[drawn].mean(axis=-1) / difficulty[drawn].var(axis=-1)
        return explained

    def spearman(drawn: npt.NDArray[np.int64]) -> Floats:
        each = [pearson_of_ranks(one[drawn], difficulty[drawn]) for one in found.predicted]
        mean: Floats = np.mean(each, axis=0)
        return mean

    def against(other: str) -> Interval | None:
        if other not in errors or other == recipe:
            return None
        return over_worlds(lambda drawn: (errors[other] - squared)[drawn].mean(axis=-1), len(difficulty))

    return RecipeScore(
        recipe,
        recipe_named(recipe).title,
        found.training_mse,
        over_worlds(lambda drawn: squared[drawn].mean(axis=-1), len(difficulty)),
        over_worlds(lambda drawn: absolute[drawn].mean(axis=-1), len(difficulty)),
        over_worlds(r2, len(difficulty)),
        over_worlds(spearman, len(difficulty)),
        against(PAPER),
        against(REGULARISED),
        tuple(found.predicted.mean(axis=0).tolist()),
    )
