"""How well difficulty models predict worlds that they have not seen.

They are trained on other worlds of the same trials, by repeated k-fold over worlds, or on further trials alone.
"""

from collections.abc import Callable, Iterable, Mapping, Sequence
from dataclasses import dataclass

import numpy as np

from barn_metrics.bootstrap import Interval
from barn_metrics.model.inputs import inputs_of
from barn_metrics.model.predictor import DifficultyModel
from barn_metrics.model.recipes import (
    PAPER,
    RECIPES,
    REGULARISED,
    SHIPPED,
    Recipe,
    recipe_named,
    targets_of,
    train_members,
)
from barn_metrics.model.scores import Ceiling, Errors, errors_of, noise_ceiling, paired_gain
from barn_metrics.model.training import fold_masks, refuse_held_out, trained_worlds
from barn_metrics.model.trials import Trials
from barn_worlds.base.arrays import Floats
from barn_worlds.base.config import Checked, quantity
from barn_worlds.base.errors import ModelError, suggest
from barn_worlds.worlds.world import World

# What is also judged on successful trials alone: how much of what is not explained comes from failures.
_OF_SUCCESSES = ("linear", REGULARISED, "rich", SHIPPED)

Sample = tuple[Mapping[int, World], Trials]


@dataclass(frozen=True)
class EvaluationConfig(Checked):
    """How models are judged: each fold by a model that was trained on all others, again with other folds."""

    folds: int = quantity(10, "parts that the worlds are divided into", minimum=2, maximum=1000)
    repeats: int = quantity(5, "divisions", minimum=1, maximum=1000)
    seed: int = quantity(0, "of divisions and training", minimum=0, maximum=2**62)


@dataclass(frozen=True)
class RecipeScore(Errors):
    """The errors of one recipe in worlds held out.

    training_mse: of the folds' models on the worlds that they were trained on, (s/m)^2. improvement,
    improvement_regularised: mean squared error of the paper's network, as published and held back from overfitting,
    minus this recipe's on the same worlds: above 0 this one is better. predictions: mean over repeats, of each of the
    evaluation's worlds, s/m.
    """

    recipe: str
    title: str
    training_mse: float
    improvement: Interval | None
    improvement_regularised: Interval | None
    predictions: tuple[float, ...]


@dataclass(frozen=True)
class Evaluation:
    """How well recipes predict some trials.

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
    notes: tuple[str, ...] = ()
    further_worlds: int = 0
    further_trials: int = 0

    def score(self, recipe: str) -> RecipeScore:
        """Return the score of a recipe; ModelError if it was not evaluated."""
        found = {score.recipe: score for score in self.scores}
        if recipe not in found:
            raise ModelError(f"recipe {recipe!r} was not evaluated{suggest(recipe, found)}")
        return found[recipe]


def evaluate(
    worlds: Mapping[int, World],
    trials: Trials,
    recipes: Sequence[str] = RECIPES,
    config: EvaluationConfig | None = None,
    further: Sample | None = None,
    track: Callable[[Sequence[str]], Iterable[str]] = iter,
) -> Evaluation:
    """Return the held-out errors of recipes on the worlds that every planner was tried in.

    further: other worlds and the trials in them; models are trained on these alone and not on folds. track: gives the
    recipes one after the other, such as `rich.progress.track`. A recipe whose library is missing is left out with a
    note, unless it is the only one. Raises ModelError for too few worlds, an unknown recipe, training in a
    world kept apart, or further trials in a world that is judged, or of other planners.
    """
    chosen = config or EvaluationConfig()
    own, judged = _sample(worlds, trials)
    other, more = _sample(*further) if further else ([], None)
    refuse_held_out(own if more is None else other)
    if more is not None:
        _check_apart(own, judged, other, more)
    elif len(own) < 2 * chosen.folds:
        raise ModelError(f"{chosen.folds} folds need at least {2 * chosen.folds} worlds, got {len(own)}")
    inputs = {name: inputs_of([*own, *other], name) for name in {recipe_named(recipe).inputs for recipe in recipes}}
    found: dict[str, tuple[Floats, float]] = {}
    notes: list[str] = []
    for name in track(recipes):
        recipe = recipe_named(name)
        try:
            found[name] = _held_out(recipe, inputs[recipe.inputs], judged, more, chosen)
        except ModelError as error:
            notes.append(f"{name} is left out: {error}")
    if not found:
        raise ModelError(notes[0])
    return Evaluation(
        len(own),
        len(judged),
        judged.planner_names,
        chosen.folds,
        chosen.repeats,
        chosen.seed,
        judged.world_numbers,
        tuple(judged.difficulty().tolist()),
        tuple(_score(name, found, judged.difficulty()) for name in found),
        noise_ceiling(judged, chosen.seed),
        tuple(notes),
        len(other),
        len(more) if more is not None else 0,
    )


def evaluate_successes(
    worlds: Mapping[int, World], trials: Trials, recipes: Sequence[str], config: EvaluationConfig
) -> Evaluation | None:
    """Return the evaluation of some of the recipes on the time of successful trials alone.

    None where too few worlds have any.
    """
    chosen = [recipe for recipe in recipes if recipe in _OF_SUCCESSES]
    successes = trials.successes()
    if successes is None or not chosen or successes.planner_names != trials.planner_names:
        return None
    return evaluate(worlds, successes, chosen, config) if len(successes.world_numbers) >= 2 * config.folds else None


def _sample(worlds: Mapping[int, World], trials: Trials) -> tuple[list[World], Trials]:
    """Return the worlds that every planner was tried in, and the trials there."""
    return trained_worlds(worlds, trials), trials.only(trials.world_numbers)


def _check_apart(own: Sequence[World], trials: Trials, other: Sequence[World], further: Trials) -> None:
    judged = {world.checksum: number for number, world in zip(trials.world_numbers, own, strict=True)}
    both = next((judged[world.checksum] for world in other if world.checksum in judged), None)
    if both is not None:
        raise ModelError(f"world {both} is judged and among the further trials; a model must not have seen it")
    if trials.planner_names != further.planner_names:
        names = [", ".join(one.planner_names) for one in (trials, further)]
        raise ModelError(f"further trials must be of the same planners, {names[0]}, got {names[1]}")


def _held_out(
    recipe: Recipe, inputs: Floats, judged: Trials, further: Trials | None, config: EvaluationConfig
) -> tuple[Floats, float]:
    """Return predictions (repeats, w) for the judged worlds, and the mean training error of their models.

    The models were trained on folds of these worlds, or on further trials. inputs: of the worlds of both.
    """
    samples = [judged] if further is None else [judged, further]
    targets = np.concatenate([targets_of(recipe, one) for one in samples])
    difficulty = np.concatenate([one.difficulty() for one in samples])
    planners = judged.planner_names if recipe.per_planner else ()
    count = len(judged.world_numbers)
    predicted = np.zeros((config.repeats, count))
    training = []
    for repeat in range(config.repeats):
        seed = config.seed + repeat
        kept = fold_masks(count, config.folds, seed) if further is None else np.arange(len(inputs))[None] >= count
        for mask, members in zip(kept, train_members(recipe, inputs, targets, kept, seed), strict=True):
            given, _ = DifficultyModel("", recipe.inputs, planners, members, 0.0, {}).difficulty(inputs)
            predicted[repeat, ~mask[:count]] = given[:count][~mask[:count]]
            training.append(float(np.mean((given - difficulty)[mask] ** 2)))
    return predicted, float(np.mean(training))


def _score(recipe: str, found: Mapping[str, tuple[Floats, float]], difficulty: Floats) -> RecipeScore:
    predicted, training_mse = found[recipe]

    def gain_over(other: str) -> Interval | None:
        return paired_gain(found[other][0], predicted, difficulty) if other in found and other != recipe else None

    return RecipeScore(
        **vars(errors_of(predicted, difficulty)),
        recipe=recipe,
        title=recipe_named(recipe).title,
        training_mse=training_mse,
        improvement=gain_over(PAPER),
        improvement_regularised=gain_over(REGULARISED),
        predictions=tuple(predicted.mean(axis=0).tolist()),
    )
