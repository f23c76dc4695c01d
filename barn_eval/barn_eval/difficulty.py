"""The learned difficulty of worlds: predicted, trained and judged."""

from collections.abc import Sequence
from pathlib import Path
from typing import Any

import pandas as pd

from barn_eval.learning.difficulty import read_samples
from barn_eval.results.frames import frame_of
from barn_metrics.model import DifficultyModel, load_model, save_model
from barn_metrics.model.evaluation import Evaluation, EvaluationConfig
from barn_metrics.model.evaluation import evaluate as evaluate_models
from barn_metrics.model.training import train as train_model
from barn_worlds.base.errors import ConfigError
from barn_worlds.worlds.dataset import open_dataset

__all__ = ["evaluate", "predict", "train"]


Sources = str | Path | Sequence[str | Path]


def predict(source: str | Path = "barn300", select: str = "all", *, weights: str | Path | None = None) -> pd.DataFrame:
    """Return how difficult the model predicts worlds to be.

    Args:
        source: A data set's name, or a file or folder of worlds.
        select: Which worlds, such as "0-49".
        weights: File of a model. Default: the shipped one.

    Returns:
        A row per world: world, name, difficulty_s_per_m (time per metre of path that trials under the paper's protocol
        count on average), std_s_per_m (of trials in a new world around it), the same per planner as PLANNER_s_per_m,
        and failure_probability.

    Raises:
        BarnError: A world or the weights cannot be read.
    """
    return frame_of(predictions(source, select, weights)[2])


def predictions(
    source: str | Path, select: str, weights: str | Path | None
) -> tuple[DifficultyModel, str, list[dict[str, Any]]]:
    """Return the model, the data set's name and what is predicted of each world."""
    model, dataset = load_model(weights), open_dataset(source)
    found = model.predict_dataset(dataset, select)
    rows = [{"world": one, "name": dataset.load(one).name, **made.columns()} for one, made in found.items()]
    return model, dataset.name, rows


def train(sources: Sources, out: str | Path, *, planner: str = "", dataset: str = "", seed: int = 0) -> DifficultyModel:
    """Train a model of how difficult worlds are on trials, write its weights and return it.

    Args:
        sources: Folders of experiments, or tables of published times, .csv.
        out: Weights to write, .npz.
        planner: Learn the times of this one alone, not the mean of all.
        dataset: Where the worlds are, if not where the results say.
        seed: All randomness comes from it.

    Raises:
        BarnError: A source cannot be read, or there is too little to learn from.
    """
    if Path(out).suffix != ".npz":
        raise ConfigError(f"out {out}: must end in .npz")
    paths = [sources] if isinstance(sources, str | Path) else sources
    model = train_model(*read_samples([Path(path) for path in paths], planner, dataset), seed)
    save_model(model, Path(out))
    return model


def evaluate(
    source: str | Path,
    *,
    weights: str | Path | None = None,
    folds: int = 10,
    repeats: int = 5,
    planner: str = "",
    dataset: str = "",
    seed: int = 0,
) -> Evaluation:
    """Judge the model in worlds that it was not trained on, beside ridge regression on the paper's five metrics.

    It is repeated k-fold over the worlds of a source. Worlds of `barn_test` are never trained on; they judge weights.

    Args:
        source: As for `train`.
        weights: File of a model to judge in place of models trained on folds, "shipped" for the shipped one.
        folds: Parts of the worlds.
        repeats: Divisions into folds.
        planner: As for `train`.
        dataset: As for `train`.
        seed: All randomness comes from it.

    Returns:
        The errors of each kind of model, in (s/m)^2, with intervals of 95 % over worlds.

    Raises:
        BarnError: The source or the weights cannot be read, or there is too little to learn from.
    """
    config = EvaluationConfig(folds=folds, repeats=repeats, seed=seed)
    model = None if weights is None else load_model(None if str(weights) == "shipped" else weights)
    return evaluate_models(*read_samples([Path(source)], planner, dataset), config, model)
