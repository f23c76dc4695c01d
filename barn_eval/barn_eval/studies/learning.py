"""The difficulty model on this run's trials: training loss as the paper quotes it, beside what held-out worlds show."""

from __future__ import annotations

from collections.abc import Callable, Mapping
from dataclasses import dataclass
from importlib.util import find_spec
from typing import Any, Protocol

import numpy as np

from barn_eval.studies.config import ReproduceConfig
from barn_eval.studies.trials import Grid
from barn_metrics.bootstrap import Interval
from barn_metrics.model import DifficultyModel, load_model
from barn_metrics.model.errors import ModelError
from barn_metrics.model.evaluation import Evaluation, EvaluationConfig, RecipeScore, evaluate, paired_gain
from barn_metrics.model.training import train
from barn_metrics.model.transfer import Transfer, transfer
from barn_metrics.model.trials import Trials
from barn_worlds.world import World

# The paper's network as it stands, the same held back from overfitting, one that sees more, all trained on this run's
# trials; and the weights that the suite ships, which were trained elsewhere.
PAPER, SHIPPED = "paper", "shipped"
RECIPES = ("mean", "linear", "trees", PAPER, "paper_regularised", "rich")
TITLES = {PAPER: "the paper's network", SHIPPED: "the suite's model"}
Progress = Callable[[int, int], None]


@dataclass(frozen=True)
class RecipeFinding:
    """One way to predict: mean squared errors in (s/m)^2, held-out figures with 95 % intervals over worlds.

    training_mse: of one model trained on all worlds, on these; of the shipped weights, in the worlds that they were
    trained in. improvement: by how much the held-out error lies below that of the paper's network, None for that one.
    """

    recipe: str
    title: str
    training_mse: float
    mse: Interval
    mae_s_per_m: Interval
    r2: Interval
    spearman: Interval
    improvement: Interval | None


@dataclass(frozen=True)
class LearningFinding:
    """All models, the highest R2 that the trials allow (from split halves), and predictions by world.

    variance: of the difficulty over worlds, (s/m)^2. ceiling_r2: None where worlds have one trial per planner.
    fitted, held_out: by recipe and in the order of `worlds`, predictions in s/m of a model that has seen the world, and
    of those that have not. There is no shipped model that has seen them.
    """

    folds: int
    repeats: int
    recipes: tuple[RecipeFinding, ...]
    variance: float
    ceiling_r2: Interval | None
    notes: tuple[str, ...]
    worlds: tuple[int, ...]
    fitted: dict[str, tuple[float, ...]]
    held_out: dict[str, tuple[float, ...]]

    def of(self, recipe: str) -> RecipeFinding:
        """Return one recipe's figures."""
        return next(one for one in self.recipes if one.recipe == recipe)


class Predictor(Protocol):
    """What a trained model can do."""

    def predict(self, world: World) -> Any:
        """Return the prediction of a world."""


def require_training() -> None:
    """Raise ModelError, before hours of trials, where models cannot be trained for lack of a library."""
    for module, package in (("torch", "torch"), ("sklearn", "scikit-learn")):
        if find_spec(module) is None:
            raise ModelError(f"difficulty models cannot be trained: {package} is not installed; pip install {package}")


def model_trials(found: Mapping[str, Grid]) -> Trials:
    """Return trials as the model takes them."""
    parts = [(planner, grid) for planner, grid in found.items()]
    return Trials(
        np.concatenate([np.repeat(grid.worlds, grid.time_s.shape[1]) for _, grid in parts]),
        tuple(planner for planner, grid in parts for _ in range(grid.time_s.size)),
        np.concatenate([grid.normalised_s_per_m.ravel() for _, grid in parts]),
        np.concatenate([grid.succeeded.ravel() for _, grid in parts]),
    )


def learning_finding(
    worlds: Mapping[int, World], trials: Trials, config: ReproduceConfig, progress: Progress | None = None
) -> tuple[LearningFinding, dict[str, Predictor]]:
    """Return what models make of the trials, and the two that are used further: the paper's, and the shipped one."""
    chosen = EvaluationConfig(folds=config.folds, repeats=config.repeats, seed=config.seed)
    found = evaluate(worlds, trials, RECIPES, chosen, progress)
    models = {recipe: train(recipe, worlds, trials, seed=config.seed) for recipe in RECIPES}
    numbers = trials.world_numbers
    shipped = load_model()
    errors = transfer(shipped, worlds, trials)
    fitted = models[PAPER].predict_worlds([worlds[index] for index in numbers])
    finding = LearningFinding(
        config.folds,
        config.repeats,
        (
            *(_recipe(score, float(models[score.recipe].about["training_mse"])) for score in found.scores),
            _shipped(shipped, found, errors),
        ),
        float(trials.difficulty().var()),
        found.ceiling.reliability,
        found.notes,
        numbers,
        {PAPER: tuple(one.difficulty_s_per_m for one in fitted)},
        {PAPER: tuple(map(float, found.score(PAPER).predictions)), SHIPPED: errors.predictions},
    )
    return finding, {PAPER: models[PAPER], SHIPPED: shipped}


def _recipe(score: RecipeScore, training_mse: float) -> RecipeFinding:
    return RecipeFinding(
        score.recipe,
        score.title,
        training_mse,
        score.mse,
        score.mae,
        score.r2,
        score.spearman,
        score.improvement,
    )


def _shipped(model: DifficultyModel, found: Evaluation, errors: Transfer) -> RecipeFinding:
    """Return what the shipped weights are worth, in the same worlds as the others."""
    return RecipeFinding(
        SHIPPED,
        f"{model.about['title']}; trained in {model.about['training_worlds']} other worlds",
        float(model.about["training_mse"]),
        errors.mse,
        errors.mae,
        errors.r2,
        errors.spearman,
        paired_gain(found.score(PAPER).predictions, errors.predictions, found.difficulty),
    )


def predictions(models: Mapping[str, Predictor], worlds: Mapping[int, World]) -> dict[str, dict[int, float]]:
    """Return the predicted time per metre by model and world."""
    return {
        name: {index: float(model.predict(world).difficulty_s_per_m) for index, world in worlds.items()}
        for name, model in models.items()
    }
