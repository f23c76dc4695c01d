"""How well a difficulty model predicts unseen worlds (repeated k-fold), beside ridge regression on the five metrics."""

import math
from collections.abc import Callable, Mapping
from dataclasses import dataclass, replace
from functools import partial

import numpy as np

from barn_metrics import bootstrap
from barn_metrics.bootstrap import Interval
from barn_metrics.metrics import METRIC_NAMES
from barn_metrics.model.inputs import inputs_of
from barn_metrics.model.predictor import DifficultyModel, moments
from barn_metrics.model.trials import (
    Trials,
    find_reserved_world,
    fold_masks,
    worlds_with_trials,
)
from barn_worlds.base.arrays import Bools, Floats, Integers
from barn_worlds.base.config import Checked, quantity
from barn_worlds.base.errors import ModelError
from barn_worlds.worlds.world import World

RIDGE, WEIGHTS = "ridge", "weights"
RIDGE_TITLE = "ridge regression on the five metrics"
_PENALTIES = np.logspace(-1.0, 4.0, 26)
_SPLITS = 50
# Rank correlations of several repeats are slow.
over_worlds = partial(bootstrap.bootstrap_interval, resamples=4000)


@dataclass(frozen=True)
class EvaluationConfig(Checked):
    """How models that are trained here are judged: each fold by one of all others, again with other folds."""

    folds: int = quantity(10, "parts that the worlds are divided into", "", 2, 1000)
    repeats: int = quantity(5, "divisions", "", 1, 1000)
    seed: int = quantity(0, "of divisions and training", "", 0, 2**62)


@dataclass(frozen=True)
class ModelScore:
    """The errors of one kind of model in worlds held out, averaged over repeats; intervals are of 95 % over worlds."""

    name: str
    title: str
    training_mse: float  # in the worlds that the models were trained on
    mse: Interval  # (s/m)^2
    mae: Interval  # s/m
    r2: Interval
    spearman: Interval
    gain: Interval | None  # how much lower the error is than ridge regression's
    predictions: tuple[float, ...]  # of each world, s/m
    within_std: float | None = (
        None  # share of worlds within one standard deviation of what weights say
    )


@dataclass(frozen=True)
class Evaluation:
    """How well models predict some trials."""

    worlds: int
    trials: int
    planners: tuple[str, ...]
    folds: int
    repeats: int
    seed: int
    world_numbers: tuple[int, ...]
    difficulty: tuple[float, ...]  # of each of them, measured, s/m
    scores: tuple[ModelScore, ...]
    ceiling: (
        Interval | None
    )  # highest R2 possible; None where worlds have one trial per planner

    def score(self, name: str) -> ModelScore:
        """Return the score of a kind of model that was evaluated."""
        return next(score for score in self.scores if score.name == name)


def evaluate(
    worlds: Mapping[int, World],
    trials: Trials,
    model: DifficultyModel,
    config: EvaluationConfig | None = None,
) -> Evaluation:
    """Return the errors of a model and of ridge regression, on the worlds that every planner has.

    Worlds of `RESERVED_DATASET` judge the model alone. ModelError for too few worlds.
    """
    chosen = config or EvaluationConfig()
    own, judged = worlds_with_trials(worlds, trials), trials.only(trials.world_numbers)
    inputs, difficulty = inputs_of(own), judged.difficulty()
    scores = [] if find_reserved_world(own) else [ridge_score(inputs, judged, chosen)]
    predicted, training_mse = (
        model.difficulty(inputs)[0][None],
        model.about.get("training_mse", math.nan),
    )
    title = f"{model.about.get('title')}; trained in {model.about.get('training_worlds')} other worlds"
    found = score_of(
        WEIGHTS,
        title,
        training_mse,
        predicted,
        difficulty,
        scores[0] if scores else None,
    )
    std = np.array([one.std_s_per_m for one in model.predict_inputs(inputs)])
    scores.append(
        replace(
            found, within_std=float((np.abs(predicted[0] - difficulty) <= std).mean())
        )
    )
    return Evaluation(
        len(own),
        len(judged),
        judged.planner_names,
        chosen.folds,
        chosen.repeats,
        chosen.seed,
        judged.world_numbers,
        tuple(difficulty.tolist()),
        tuple(scores),
        noise_ceiling(judged, chosen.seed),
    )


def fit_ridge(inputs: Floats, targets: Floats) -> Callable[[Floats], Floats]:
    """Return ridge regression of targets (n,) on z-scored inputs (n, d) as a function, its penalty by leave-one-out."""
    mean, std = moments(inputs)
    left, singular, right = np.linalg.svd((inputs - mean) / std, full_matrices=False)
    bias = targets.mean()
    along = left.T @ (targets - bias)
    shrunk = singular**2 / (singular**2 + _PENALTIES[:, None])  # (penalties, r)
    leverage = shrunk @ (left**2).T + 1.0 / len(inputs)
    errors = ((targets - bias - (shrunk * along) @ left.T) / (1.0 - leverage)) ** 2
    best = errors.mean(axis=1).argmin()
    weights = right.T @ (shrunk[best] / np.maximum(singular, 1e-12) * along)
    return lambda unseen: (unseen - mean) / std @ weights + bias


def ridge_score(inputs: Floats, trials: Trials, config: EvaluationConfig) -> ModelScore:
    """Return the errors of ridge regression on the five metrics, which are the first of the inputs (w, d)."""
    difficulty, five = trials.difficulty(), inputs[:, : len(METRIC_NAMES)]

    def fitted(kept: Bools, _: int) -> list[Floats]:
        return [fit_ridge(five[mask], difficulty[mask])(five) for mask in kept]

    predicted, training_mse = on_folds(fitted, difficulty, config)
    return score_of(RIDGE, RIDGE_TITLE, training_mse, predicted, difficulty, None)


def on_folds(
    fitted: Callable[[Bools, int], list[Floats]],
    difficulty: Floats,
    config: EvaluationConfig,
) -> tuple[Floats, float]:
    """Return predictions (repeats, w) by models that were trained without the world, and their mean training error.

    fitted: gives the predictions for all worlds of a model per row of worlds that are kept, with a seed.
    """
    if len(difficulty) < 2 * config.folds:
        raise ModelError(
            f"{config.folds} folds need at least {2 * config.folds} worlds, got {len(difficulty)}"
        )
    predicted, training = np.zeros((config.repeats, len(difficulty))), []
    for repeat in range(config.repeats):
        kept = fold_masks(len(difficulty), config.folds, config.seed + repeat)
        for mask, given in zip(kept, fitted(kept, config.seed + repeat), strict=True):
            predicted[repeat, ~mask] = given[~mask]
            training.append(np.mean((given - difficulty)[mask] ** 2))
    return predicted, float(np.mean(training))


def score_of(
    name: str,
    title: str,
    training_mse: float,
    predicted: Floats,
    measured: Floats,
    yardstick: ModelScore | None,
) -> ModelScore:
    """Return the errors of predictions (r, w), averaged over their r repeats, against measured times (w,)."""
    squared, means = ((predicted - measured) ** 2).mean(axis=0), predicted.mean(axis=0)

    def mean_of(values: Floats) -> Interval:
        return over_worlds(lambda drawn: values[drawn].mean(axis=-1), len(measured))

    def spearman(drawn: Integers) -> Floats:
        each = [bootstrap.spearman(one[drawn], measured[drawn]) for one in predicted]
        mean: Floats = np.nan_to_num(each).mean(
            axis=0
        )  # what does not vary orders nothing
        return mean

    return ModelScore(
        name,
        title,
        training_mse,
        mean_of(squared),
        mean_of(np.abs(predicted - measured).mean(axis=0)),
        determination(predicted, measured),
        over_worlds(spearman, len(measured)),
        mean_of((yardstick.predictions - measured) ** 2 - (means - measured) ** 2)
        if yardstick
        else None,
        tuple(means.tolist()),
    )


def determination(predicted: Floats, measured: Floats) -> Interval:
    """Return R2 of predictions (r, w) of measured (w,), averaged over their r repeats; NaN where these do not vary."""
    if not measured.var() > 0.0:
        return Interval(math.nan)
    squared = ((predicted - measured) ** 2).mean(axis=0)
    return over_worlds(
        lambda drawn: 1.0 - squared[drawn].mean(axis=-1) / measured[drawn].var(axis=-1),
        len(measured),
    )


def noise_ceiling(trials: Trials, seed: int = 0) -> Interval | None:
    """Return the correlation of random halves of the repetitions, carried to all of them (Spearman and Brown)."""
    values = [
        [
            mine.normalised_s_per_m[mine.worlds == world]
            for world in trials.world_numbers
        ]
        for mine in map(trials.of, trials.planner_names)
    ]
    fewest = min(min(map(len, rows)) for rows in values)
    if fewest < 2:
        return None
    generator = np.random.default_rng(seed)
    halves = np.array(
        [_split(values, fewest // 2, generator) for _ in range(_SPLITS)]
    )  # (splits, 2, w)
    factor = fewest / (fewest // 2)

    def reliability(drawn: Integers) -> Floats:
        each = [
            bootstrap.correlation(first[drawn], second[drawn])
            for first, second in halves
        ]
        mean = np.nan_to_num(each).mean(
            axis=0
        )  # what does not vary agrees with nothing
        full: Floats = factor * mean / (1.0 + (factor - 1.0) * mean)
        return full

    return over_worlds(reliability, len(trials.world_numbers))


def _split(
    values: list[list[Floats]], half: int, generator: np.random.Generator
) -> Floats:
    """Return the difficulty of each world by two halves that share no trial, (2, w)."""
    means = []
    for rows in values:
        drawn = [
            generator.permutation(row)[: 2 * half].reshape(2, half).mean(axis=1)
            for row in rows
        ]
        means.append(np.array(drawn).T)
    mean: Floats = np.mean(means, axis=0)
    return mean
