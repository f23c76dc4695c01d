"""How well a difficulty model predicts worlds that it has not seen.

The yardstick is ridge regression on the paper's five metrics, trained and judged by
repeated k-fold cross-validation on the same worlds.
"""

import math
from collections.abc import Callable, Mapping
from dataclasses import dataclass
from functools import partial

import numpy as np
from trial_sources import Trials, find_reserved_world, worlds_with_trials

from barn_metrics import bootstrap
from barn_metrics.bootstrap import Interval
from barn_metrics.metrics import METRIC_NAMES
from barn_metrics.model.inputs import inputs_of
from barn_metrics.model.predictor import DifficultyModel, moments
from barn_worlds.base.arrays import Bools, Floats, Integers
from barn_worlds.base.config import Checked, quantity
from barn_worlds.base.errors import ModelError
from barn_worlds.worlds.world import World

RIDGE = "ridge"
WEIGHTS = "weights"
RIDGE_TITLE = "ridge regression on the five metrics"
_PENALTIES = np.logspace(-1.0, 4.0, 26)
_SPLITS = 50
# Fewer resamples than elsewhere: a rank correlation of several repeats takes long.
_interval = partial(bootstrap.bootstrap_interval, resamples=4000)


@dataclass(frozen=True)
class EvaluationConfig(Checked):
    """How models are cross-validated: each fold by a model that all others trained."""

    folds: int = quantity(10, "parts that the worlds are divided into", "", 2, 1000)
    repeats: int = quantity(5, "divisions", "", 1, 1000)
    seed: int = quantity(0, "of divisions, ceiling and random training", "", 0, 2**62)


@dataclass(frozen=True)
class ModelScore:
    """Errors of one kind of model in unseen worlds, averaged over repeats.

    Intervals are 95% over worlds.
    """

    name: str
    title: str
    # (s/m)^2 in the worlds that the models were trained on.
    training_mse: float
    # (s/m)^2
    mse: Interval
    # s/m
    mae: Interval
    r2: Interval
    spearman: Interval
    # Squared error of ridge regression minus this model's, (s/m)^2, both of predictions
    # averaged over repeats.
    gain: Interval | None
    # Of each world, s/m.
    predictions: tuple[float, ...]
    # Share of worlds within one standard deviation of the prediction.
    within_std: float | None = None


@dataclass(frozen=True)
class Evaluation:
    """How well models predict the difficulty that some trials measured."""

    worlds: int
    trials: int
    planners: tuple[str, ...]
    folds: int
    repeats: int
    seed: int
    world_numbers: tuple[int, ...]
    # Measured in each of these worlds, s/m.
    difficulty: tuple[float, ...]
    scores: tuple[ModelScore, ...]
    # Highest R2 that the trials allow; None where worlds have one trial per planner.
    ceiling: Interval | None

    def score(self, name: str) -> ModelScore:
        """Return the score of a kind of model that was evaluated."""
        return next(score for score in self.scores if score.name == name)


def evaluate(
    worlds: Mapping[int, World],
    trials: Trials,
    model: DifficultyModel,
    config: EvaluationConfig,
) -> Evaluation:
    """Judge a model beside ridge regression, in the worlds that every planner drove.

    Ridge regression is left out where worlds are reserved for judging: nothing is
    trained on those.

    Args:
        worlds: By number, at least those that the trials name.
        trials: Trials in these worlds.
        model: The model to judge; it must not have been trained in these worlds.
        config: Folds of ridge regression; its seed is the ceiling's, too.

    Raises:
        ModelError: If a world is missing or there are too few.
    """
    worlds_driven = worlds_with_trials(worlds, trials)
    trials = trials.in_worlds(trials.world_numbers)
    inputs = inputs_of(worlds_driven)
    difficulty = trials.difficulty()

    ridge_score = None
    if find_reserved_world(worlds_driven) is None:
        ridge_score = score_ridge(inputs, trials, config)

    predictions = model.predict_inputs(inputs)
    predicted = np.array([item.difficulty_s_per_m for item in predictions])
    std = np.array([item.std_s_per_m for item in predictions])
    is_within_std = np.abs(predicted - difficulty) <= std
    trained_in = model.about.get("training_worlds")
    model_score = score_predictions(
        WEIGHTS,
        f"{model.about.get('title')}; trained in {trained_in} other worlds",
        model.about.get("training_mse", math.nan),
        predicted[None],
        difficulty,
        ridge_score,
        float(is_within_std.mean()),
    )

    return Evaluation(
        worlds=len(worlds_driven),
        trials=len(trials),
        planners=trials.planner_names,
        folds=config.folds,
        repeats=config.repeats,
        seed=config.seed,
        world_numbers=trials.world_numbers,
        difficulty=tuple(difficulty.tolist()),
        scores=(ridge_score, model_score) if ridge_score else (model_score,),
        ceiling=noise_ceiling(trials, config.seed),
    )


def fit_ridge(inputs: Floats, targets: Floats) -> Callable[[Floats], Floats]:
    """Fit ridge regression on z-scored inputs.

    Of the penalties, it takes the one with the least leave-one-out error.

    Args:
        inputs: (n, d).
        targets: (n,).

    Returns:
        A function from inputs (m, d) to predictions (m,).
    """
    mean, std = moments(inputs)
    left, singular, right = np.linalg.svd((inputs - mean) / std, full_matrices=False)
    bias = targets.mean()
    residuals = targets - bias
    coordinates = left.T @ residuals
    shrinkage = singular**2 / (singular**2 + _PENALTIES[:, None])  # (penalties, r)

    # The leverage of a row gives its leave-one-out error without another fit.
    leverage = shrinkage @ (left**2).T + 1.0 / len(inputs)
    fitted = (shrinkage * coordinates) @ left.T
    errors = ((residuals - fitted) / (1.0 - leverage)) ** 2
    best = errors.mean(axis=1).argmin()
    weights = right.T @ (shrinkage[best] / np.maximum(singular, 1e-12) * coordinates)
    return lambda unseen: (unseen - mean) / std @ weights + bias


def score_ridge(inputs: Floats, trials: Trials, config: EvaluationConfig) -> ModelScore:
    """Judge ridge regression on the five metrics by cross-validation.

    Args:
        inputs: (w, d) of the trials' worlds; the metrics are their first columns.
        trials: Trials in these worlds.
        config: Folds, repeats and seed.
    """
    difficulty = trials.difficulty()
    metrics = inputs[:, : len(METRIC_NAMES)]

    def predict(training_masks: Bools, _: int) -> list[Floats]:
        return [
            fit_ridge(metrics[mask], difficulty[mask])(metrics)
            for mask in training_masks
        ]

    predicted, training_mse = cross_validate(predict, difficulty, config)
    return score_predictions(RIDGE, RIDGE_TITLE, training_mse, predicted, difficulty)


def cross_validate(
    predict: Callable[[Bools, int], list[Floats]],
    difficulty: Floats,
    config: EvaluationConfig,
) -> tuple[Floats, float]:
    """Predict each world by models that were trained without it.

    Args:
        predict: Takes masks of training worlds (folds, w) and a seed. It returns, per
            fold, predictions (w,) for all worlds by a model trained on that fold's
            mask.
        difficulty: Measured difficulty (w,).
        config: Folds, repeats and seed.

    Returns:
        Predictions (repeats, w), and the mean squared error in training worlds.

    Raises:
        ModelError: If there are fewer than two worlds per fold.
    """
    if len(difficulty) < 2 * config.folds:
        raise ModelError(
            f"{config.folds} folds need at least {2 * config.folds} worlds, "
            f"got {len(difficulty)}"
        )

    predicted = np.zeros((config.repeats, len(difficulty)))
    training_errors = []
    for repeat in range(config.repeats):
        seed = config.seed + repeat
        training_masks = fold_masks(len(difficulty), config.folds, seed)
        fold_predictions = predict(training_masks, seed)
        for mask, fold_prediction in zip(training_masks, fold_predictions, strict=True):
            predicted[repeat, ~mask] = fold_prediction[~mask]
            errors = (fold_prediction - difficulty)[mask]
            training_errors.append(np.mean(errors**2))

    return predicted, float(np.mean(training_errors))


def fold_masks(world_count: int, folds: int, seed: int) -> Bools:
    """Return the training worlds of each fold; each world is left out exactly once.

    Args:
        world_count: Number of worlds w.
        folds: Number of parts.
        seed: Seed of the division.

    Returns:
        (folds, w), True where a world is trained on.
    """
    order = np.random.default_rng(seed).permutation(world_count)
    masks = np.ones((folds, world_count), np.bool_)
    for fold, left_out in enumerate(np.array_split(order, folds)):
        masks[fold, left_out] = False
    return masks


def score_predictions(
    name: str,
    title: str,
    training_mse: float,
    predicted: Floats,
    measured: Floats,
    ridge_score: ModelScore | None = None,
    within_std: float | None = None,
) -> ModelScore:
    """Score predictions against measured difficulty.

    Args:
        name: Name of the kind of model.
        title: What it is, for people.
        training_mse: Mean squared error in its training worlds, (s/m)^2.
        predicted: (r, w) of r repeats, s/m.
        measured: (w,), s/m.
        ridge_score: Score of ridge regression on the same worlds, to compare with.
        within_std: Share of worlds within one standard deviation of the prediction.
    """
    means = predicted.mean(axis=0)
    squared_errors = ((predicted - measured) ** 2).mean(axis=0)

    def mean_interval(values: Floats) -> Interval:
        return _interval(lambda rows: values[rows].mean(axis=-1), len(measured))

    def spearman(rows: Integers) -> Floats:
        correlations = [
            bootstrap.spearman(repeat[rows], measured[rows]) for repeat in predicted
        ]
        # Constant predictions order nothing: NaN counts as no correlation.
        mean: Floats = np.nan_to_num(correlations).mean(axis=0)
        return mean

    gain = None
    if ridge_score is not None:
        ridge_errors = (ridge_score.predictions - measured) ** 2
        gain = mean_interval(ridge_errors - (means - measured) ** 2)

    return ModelScore(
        name=name,
        title=title,
        training_mse=training_mse,
        mse=mean_interval(squared_errors),
        mae=mean_interval(np.abs(predicted - measured).mean(axis=0)),
        r2=determination(predicted, measured),
        spearman=_interval(spearman, len(measured)),
        gain=gain,
        predictions=tuple(means.tolist()),
        within_std=within_std,
    )


def determination(predicted: Floats, measured: Floats) -> Interval:
    """Return R2 of predictions, averaged over repeats.

    Args:
        predicted: (r, w) of r repeats.
        measured: (w,).

    Returns:
        R2 with its interval over worlds; NaN where the measured values do not vary.
    """
    if not measured.var() > 0.0:
        return Interval(math.nan)

    squared_errors = ((predicted - measured) ** 2).mean(axis=0)

    def r2(rows: Integers) -> Floats:
        unexplained = squared_errors[rows].mean(axis=-1)
        share: Floats = 1.0 - unexplained / measured[rows].var(axis=-1)
        return share

    return _interval(r2, len(measured))


def noise_ceiling(trials: Trials, seed: int = 0) -> Interval | None:
    """Return the highest R2 that a model can have, given the noise of the trials.

    Random halves of the repetitions are correlated; the formula of Spearman and Brown
    carries the correlation to all repetitions.

    Args:
        trials: Trials with repetitions.
        seed: Seed of the halves.

    Returns:
        The ceiling, or None if a planner has only one trial in a world.
    """
    # World by world for one planner after the other.
    times: list[Floats] = []
    for planner_trials in map(trials.by_planner, trials.planner_names):
        for world in trials.world_numbers:
            is_there = planner_trials.worlds == world
            times.append(planner_trials.normalized_s_per_m[is_there])
    repetitions = min(map(len, times))
    if repetitions < 2:
        return None

    half = repetitions // 2
    factor = repetitions / half
    generator = np.random.default_rng(seed)
    # Difficulty by two halves that share no trial, (2, w) for each split.
    halves = []
    for _ in range(_SPLITS):
        means = []
        for values in times:
            parts = generator.permutation(values)[: 2 * half].reshape(2, half)
            means.append(parts.mean(axis=1))
        by_planner = np.reshape(means, (len(trials.planner_names), -1, 2))
        halves.append(by_planner.mean(axis=0).T)

    def reliability(rows: Integers) -> Floats:
        correlations = [
            bootstrap.correlation(first[rows], second[rows]) for first, second in halves
        ]
        # Halves that do not vary agree on nothing: NaN counts as no correlation.
        mean = np.nan_to_num(correlations).mean(axis=0)
        carried: Floats = factor * mean / (1.0 + (factor - 1.0) * mean)
        return carried

    return _interval(reliability, len(trials.world_numbers))
