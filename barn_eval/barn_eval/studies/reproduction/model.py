"""The difficulty model on this run's trials: the suite's, which was trained elsewhere, beside ridge regression."""

from collections.abc import Mapping
from dataclasses import replace

import numpy as np

from barn_eval.studies.reproduction.config import ReproduceConfig
from barn_eval.studies.reproduction.trials import PlannerTrials
from barn_metrics.model import DifficultyModel
from barn_metrics.model.evaluation import RIDGE, Evaluation, EvaluationConfig, ModelScore, check_weights, evaluate
from barn_metrics.model.scores import Errors, paired_gain
from barn_metrics.model.trials import Trials
from barn_worlds.worlds.world import World

SHIPPED = "shipped"


def model_trials(found: Mapping[str, PlannerTrials]) -> Trials:
    """Return trials as the model takes them."""
    return Trials(
        np.concatenate([one.world_of_each for one in found.values()]),
        tuple(planner for planner, one in found.items() for _ in one.world_of_each),
        np.concatenate([one.normalised_s_per_m.ravel() for one in found.values()]),
        np.concatenate([one.succeeded.ravel() for one in found.values()]),
    )


def learning_finding(
    model: DifficultyModel, worlds: Mapping[int, World], trials: Trials, config: ReproduceConfig
) -> Evaluation:
    """Return how ridge regression, trained on folds of the trials, and the trained model predict them.

    The training error of the latter is that in the worlds that it was trained in.
    """
    chosen = EvaluationConfig(folds=config.folds, repeats=config.repeats, seed=config.seed)
    found = evaluate(worlds, trials, chosen, models=(RIDGE,))
    check = check_weights(model, worlds, trials)
    shipped = ModelScore(
        **{name: getattr(check, name) for name in Errors.__dataclass_fields__},
        name=SHIPPED,
        title=f"{model.about['title']}; trained in {model.about['training_worlds']} other worlds",
        training_mse=float(model.about["training_mse"]),
        gain=paired_gain(found.score(RIDGE).predictions, check.predictions, found.difficulty),
        predictions=check.predictions,
    )
    return replace(found, scores=(*found.scores, shipped))
