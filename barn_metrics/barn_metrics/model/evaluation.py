"""How well difficulty models predict worlds that they have not seen, beside ridge regression on the five metrics.

They are trained on other worlds of the same trials, by repeated k-fold over worlds, or on further trials alone.
"""

from collections.abc import Callable, Iterable, Iterator, Mapping, Sequence
from dataclasses import dataclass

import numpy as np

from barn_metrics.bootstrap import Interval
from barn_metrics.metrics import METRIC_NAMES
from barn_metrics.model.inputs import inputs_of
from barn_metrics.model.predictor import DifficultyModel
from barn_metrics.model.scores import Ceiling, Errors, errors_of, noise_ceiling, over_worlds, paired_gain
from barn_metrics.model.training import TITLE, Mask, fold_masks, refuse_held_out, train_models, trained_worlds
from barn_metrics.model.trials import Trials
from barn_worlds.base.arrays import Floats
from barn_worlds.base.config import Checked, quantity
from barn_worlds.base.errors import ModelError
from barn_worlds.worlds.world import World

RIDGE, ROUTES = "ridge", "routes"
TITLES = {RIDGE: "ridge regression on the five metrics", ROUTES: TITLE}
_PENALTIES = np.logspace(-1.0, 4.0, 26)

Sample = tuple[Mapping[int, World], Trials]


@dataclass(frozen=True)
class EvaluationConfig(Checked):
    """How models are judged: each fold by a model that was trained on all others, again with other folds."""

    folds: int = quantity(10, "parts that the worlds are divided into", minimum=2, maximum=1000)
    repeats: int = quantity(5, "divisions", minimum=1, maximum=1000)
    seed: int = quantity(0, "of divisions and training", minimum=0, maximum=2**62)


@dataclass(frozen=True)
class ModelScore(Errors):
    """The errors of one kind of model in worlds held out.

    training_mse: of the models on the worlds that they were trained on, (s/m)^2. gain: the mean squared error of ridge
    regression minus this one's on the same worlds: above 0 this one is better; None for ridge regression itself.
    predictions: mean over repeats, of each of the evaluation's worlds, s/m.
    """

    name: str
    title: str
    training_mse: float
    gain: Interval | None
    predictions: tuple[float, ...]


@dataclass(frozen=True)
class Evaluation:
    """How well models predict some trials.

    difficulty: of each of world_numbers, measured, s/m. further_worlds, further_trials: how many other ones the models
    were trained on; 0 where they were trained on folds.
    """

    worlds: int
    trials: int
    planners: tuple[str, ...]
    folds: int
    repeats: int
    seed: int
    world_numbers: tuple[int, ...]
    difficulty: tuple[float, ...]
    scores: tuple[ModelScore, ...]
    ceiling: Ceiling
    further_worlds: int = 0
    further_trials: int = 0

    def score(self, name: str) -> ModelScore:
        """Return the score of a kind of model that was evaluated."""
        return next(score for score in self.scores if score.name == name)


@dataclass(frozen=True)
class WeightsCheck(Errors):
    """Errors of a trained model on trials.

    bias_s_per_m: mean of prediction minus measurement; within_two_std: share of the worlds whose measured difficulty
    lies within two of the model's standard deviations. predictions: of each world, s/m.
    """

    worlds: int
    trials: int
    bias_s_per_m: Interval
    within_two_std: float
    predictions: tuple[float, ...]


def evaluate(
    worlds: Mapping[int, World],
    trials: Trials,
    config: EvaluationConfig | None = None,
    *,
    further: Sample | None = None,
    models: Sequence[str] = (RIDGE, ROUTES),
    track: Callable[[Sequence[str]], Iterable[str]] = iter,
) -> Evaluation:
    """Return the held-out errors of models on the worlds that every planner was tried in.

    further: other worlds and the trials in them; models are trained on these alone and not on folds. models: of
    `TITLES`, ridge regression first. track: gives these one after the other, such as `rich.progress.track`.
    Raises ModelError for too few worlds, training in a world kept apart, further trials in a world that is judged, or
    of other planners, or where PyTorch is missing.
    """
    chosen = config or EvaluationConfig()
    own, judged = trained_worlds(worlds, trials), trials.only(trials.world_numbers)
    inputs, difficulty = inputs_of(own), judged.difficulty()
    if further is None:
        refuse_held_out(own)
        if len(own) < 2 * chosen.folds:
            raise ModelError(f"{chosen.folds} folds need at least {2 * chosen.folds} worlds, got {len(own)}")
        other, other_trials = [], None
    else:
        other, other_trials = trained_worlds(*further), further[1].only(further[1].world_numbers)
        refuse_held_out(other)
        _check_apart(own, judged, other, other_trials)
    other_inputs = inputs_of(other)
    found: dict[str, tuple[Floats, float]] = {}
    for name in track(models):
        fit = _fit_ridge if name == RIDGE else _fit_routes
        if other_trials is None:
            found[name] = _on_folds(fit, inputs, judged, chosen)
        else:
            found[name] = _elsewhere(fit, inputs, other_inputs, other_trials, chosen)
    return Evaluation(
        len(own),
        len(judged),
        judged.planner_names,
        chosen.folds,
        chosen.repeats,
        chosen.seed,
        judged.world_numbers,
        tuple(difficulty.tolist()),
        tuple(_score(name, found, difficulty) for name in found),
        noise_ceiling(judged, chosen.seed),
        len(other),
        len(other_trials) if other_trials else 0,
    )


def check_weights(model: DifficultyModel, worlds: Mapping[int, World], trials: Trials) -> WeightsCheck:
    """Return how well a trained model predicts the difficulty that trials give; ModelError for too few worlds.

    It is held-out only where the model was not trained on these worlds.
    """
    used = trained_worlds(worlds, trials)
    found = model.predict_worlds(used)
    predicted = np.array([one.difficulty_s_per_m for one in found])
    std = np.array([one.std_s_per_m for one in found])
    measured = trials.difficulty()
    error = predicted - measured
    return WeightsCheck(
        **vars(errors_of(predicted[None], measured)),
        worlds=len(used),
        trials=len(trials.only(trials.world_numbers)),
        bias_s_per_m=over_worlds(lambda drawn: error[drawn].mean(axis=-1), len(used)),
        within_two_std=float((np.abs(error) <= 2.0 * std).mean()),
        predictions=tuple(predicted.tolist()),
    )


def ridge(inputs: Floats, targets: Floats) -> Callable[[Floats], Floats]:
    """Return ridge regression of targets (n,) on inputs (n, d), a function of inputs (m, d).

    The penalty on z-scored inputs is that of the lowest error of predicting each sample from all others.
    """
    mean, std = inputs.mean(axis=0), inputs.std(axis=0)
    std = np.where(std > 1e-9, std, 1.0)
    left, singular, right = np.linalg.svd((inputs - mean) / std, full_matrices=False)
    bias = targets.mean()
    along = left.T @ (targets - bias)
    shrunk = singular**2 / (singular**2 + _PENALTIES[:, None])  # (penalties, r)
    leverage = shrunk @ (left**2).T + 1.0 / len(inputs)
    errors = ((targets - bias - (shrunk * along) @ left.T) / (1.0 - leverage)) ** 2
    best = errors.mean(axis=1).argmin()
    weights = right.T @ (shrunk[best] / np.maximum(singular, 1e-12) * along)
    return lambda unseen: (unseen - mean) / std @ weights + bias


# Trains a model per row of a mask (b, w) on inputs (w, d) and trials, from a seed; yields what each predicts for other
# inputs (n, d).
_Fit = Callable[[Floats, Trials, Mask, int, Floats], Iterator[Floats]]


def _fit_ridge(inputs: Floats, trials: Trials, kept: Mask, _seed: int, asked: Floats) -> Iterator[Floats]:
    five, difficulty = len(METRIC_NAMES), trials.difficulty()
    yield from (ridge(inputs[mask, :five], difficulty[mask])(asked[:, :five]) for mask in kept)


def _fit_routes(inputs: Floats, trials: Trials, kept: Mask, seed: int, asked: Floats) -> Iterator[Floats]:
    yield from (model.difficulty(asked)[0] for model in train_models(inputs, trials, kept, seed))


def _on_folds(fit: _Fit, inputs: Floats, trials: Trials, config: EvaluationConfig) -> tuple[Floats, float]:
    """Return predictions (repeats, w) by models that were trained without the world, and their mean training error."""
    difficulty = trials.difficulty()
    predicted, training = np.zeros((config.repeats, len(inputs))), []
    for repeat in range(config.repeats):
        kept = fold_masks(len(inputs), config.folds, config.seed + repeat)
        for mask, given in zip(kept, fit(inputs, trials, kept, config.seed + repeat, inputs), strict=True):
            predicted[repeat, ~mask] = given[~mask]
            training.append(np.mean((given - difficulty)[mask] ** 2))
    return predicted, float(np.mean(training))


def _elsewhere(
    fit: _Fit, inputs: Floats, other: Floats, trials: Trials, config: EvaluationConfig
) -> tuple[Floats, float]:
    """Return predictions (repeats, w) by models that were trained on other inputs and trials, and their error there."""
    every, asked = np.ones((1, len(other)), np.bool_), np.concatenate([other, inputs])
    seeds = range(config.seed, config.seed + config.repeats)
    given = np.array([next(fit(other, trials, every, seed, asked)) for seed in seeds])
    return given[:, len(other) :], float(((given[:, : len(other)] - trials.difficulty()) ** 2).mean())


def _check_apart(own: Sequence[World], trials: Trials, other: Sequence[World], further: Trials) -> None:
    judged = {world.checksum: number for number, world in zip(trials.world_numbers, own, strict=True)}
    both = next((judged[world.checksum] for world in other if world.checksum in judged), None)
    if both is not None:
        raise ModelError(f"world {both} is judged and among the further trials; a model must not have seen it")
    if trials.planner_names != further.planner_names:
        names = [", ".join(one.planner_names) for one in (trials, further)]
        raise ModelError(f"further trials must be of the same planners, {names[0]}, got {names[1]}")


def _score(name: str, found: Mapping[str, tuple[Floats, float]], difficulty: Floats) -> ModelScore:
    predicted, training_mse = found[name]
    return ModelScore(
        **vars(errors_of(predicted, difficulty)),
        name=name,
        title=TITLES[name],
        training_mse=training_mse,
        gain=None if name == RIDGE else paired_gain(found[RIDGE][0], predicted, difficulty),
        predictions=tuple(predicted.mean(axis=0).tolist()),
    )
