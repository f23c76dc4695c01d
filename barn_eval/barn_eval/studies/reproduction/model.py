"""The difficulty model on this run's trials: training loss as the paper quotes it, beside that in held-out worlds."""

from collections.abc import Callable, Iterable, Mapping, Sequence
from dataclasses import dataclass
from importlib.util import find_spec

import numpy as np

from barn_eval.studies.reproduction.config import ReproduceConfig
from barn_eval.studies.reproduction.trials import PlannerTrials
from barn_metrics.bootstrap import Interval
from barn_metrics.model import DifficultyModel, ModelError, load_model
from barn_metrics.model.evaluation import EvaluationConfig, evaluate
from barn_metrics.model.scores import Errors, check_weights, paired_gain
from barn_metrics.model.training import train
from barn_metrics.model.trials import Trials
from barn_worlds.worlds.world import World

# The paper's network as it stands, the same held back from overfitting, one that sees more, all trained on this run's
# trials; and the weights that the suite ships, which were trained elsewhere.
PAPER, SHIPPED = "paper", "shipped"
RECIPES = ("mean", "linear", "trees", PAPER, "paper_regularised", "rich")
TITLES = {PAPER: "the paper's network", SHIPPED: "the suite's model"}


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


def require_training() -> None:
    """Raise ModelError, before hours of trials, where models cannot be trained for lack of a library."""
    for module, package in (("torch", "torch"), ("sklearn", "scikit-learn")):
        if find_spec(module) is None:
            missing = f"{package} is not installed; make extras, or pip install {package}"
            raise ModelError(f"difficulty models cannot be trained: {missing}")


def model_trials(found: Mapping[str, PlannerTrials]) -> Trials:
    """Return trials as the model takes them."""
    return Trials(
        np.concatenate([one.world_of_each for one in found.values()]),
        tuple(planner for planner, one in found.items() for _ in one.world_of_each),
        np.concatenate([one.normalised_s_per_m.ravel() for one in found.values()]),
        np.concatenate([one.succeeded.ravel() for one in found.values()]),
    )


def learning_finding(
    worlds: Mapping[int, World],
    trials: Trials,
    config: ReproduceConfig,
    track: Callable[[Sequence[str]], Iterable[str]] = iter,
) -> tuple[LearningFinding, dict[str, DifficultyModel]]:
    """Return what models make of the trials, and the two that are used further: the paper's, and the shipped one.

    track: as `evaluate` takes it.
    """
    chosen = EvaluationConfig(folds=config.folds, repeats=config.repeats, seed=config.seed)
    found = evaluate(worlds, trials, RECIPES, chosen, track=track)
    models = {recipe: train(recipe, worlds, trials, seed=config.seed) for recipe in RECIPES}
    shipped = load_model()
    check = check_weights(shipped, worlds, trials)
    gain = paired_gain(found.score(PAPER).predictions, check.predictions, found.difficulty)
    title = f"{shipped.about['title']}; trained in {shipped.about['training_worlds']} other worlds"
    fitted = models[PAPER].predict_worlds([worlds[number] for number in trials.world_numbers])
    finding = LearningFinding(
        config.folds,
        config.repeats,
        (
            *(_recipe(one.recipe, one.title, models[one.recipe], one, one.improvement) for one in found.scores),
            _recipe(SHIPPED, title, shipped, check, gain),
        ),
        float(trials.difficulty().var()),
        found.ceiling.reliability,
        found.notes,
        trials.world_numbers,
        {PAPER: tuple(one.difficulty_s_per_m for one in fitted)},
        {PAPER: found.score(PAPER).predictions, SHIPPED: check.predictions},
    )
    return finding, {PAPER: models[PAPER], SHIPPED: shipped}


def _recipe(
    recipe: str, title: str, model: DifficultyModel, errors: Errors, improvement: Interval | None
) -> RecipeFinding:
    training_mse = float(model.about["training_mse"])
    return RecipeFinding(recipe, title, training_mse, errors.mse, errors.mae, errors.r2, errors.spearman, improvement)


def predictions(models: Mapping[str, DifficultyModel], worlds: Mapping[int, World]) -> dict[str, dict[int, float]]:
    """Return the predicted time per metre by model and world."""
    return {
        name: {index: model.predict(world).difficulty_s_per_m for index, world in worlds.items()}
        for name, model in models.items()
    }
