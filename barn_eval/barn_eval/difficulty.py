"""The learned difficulty of worlds: predicted, trained and judged."""

from collections.abc import Sequence
from dataclasses import dataclass
from functools import partial
from pathlib import Path
from typing import Any

import pandas as pd
from rich.console import Console
from rich.progress import track

from barn_eval.learning.difficulty import model_card, read_samples
from barn_eval.results.frames import frame_of
from barn_metrics.model import DifficultyModel, load_model, save_model
from barn_metrics.model.evaluation import Evaluation, EvaluationConfig, WeightsCheck, check_weights
from barn_metrics.model.evaluation import evaluate as evaluate_models
from barn_metrics.model.training import HELD_OUT, held_out
from barn_metrics.model.training import train as train_model
from barn_worlds.base.config import Checked, quantity
from barn_worlds.base.errors import ConfigError
from barn_worlds.base.files import write_bytes
from barn_worlds.worlds.dataset import open_dataset

__all__ = ["Judged", "check", "evaluate", "predict", "train"]


@dataclass(frozen=True)
class Training(Checked):
    """How a model of difficulty is trained."""

    planner: str = quantity("", "planner whose times alone are learned, empty for the mean of all")
    dataset: str = quantity("", "where the worlds are, empty for where the results say")
    seed: int = quantity(0, "seed of training", minimum=0, maximum=2**62)


@dataclass(frozen=True)
class Judging(Training):
    """How models of difficulty are judged."""

    folds: int = quantity(10, "parts of the worlds", minimum=2, maximum=1000)
    repeats: int = quantity(5, "divisions into folds", minimum=1, maximum=1000)


Sources = str | Path | Sequence[str | Path]


@dataclass(frozen=True)
class Judged:
    """What `evaluate` found; errors are in (s/m)^2, intervals of 95 % over worlds.

    on_folds: models trained on folds; None for worlds of `barn_test`, which are never trained on.
    trained_elsewhere: models trained on further sources alone; None without any.
    """

    on_folds: Evaluation | None
    trained_elsewhere: Evaluation | None


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
    model, dataset = load_model(Path(weights) if weights else None), open_dataset(source)
    found = model.predict_dataset(dataset, select)
    rows = [{"world": one, "name": dataset.load(one).name, **made.columns()} for one, made in found.items()]
    return model, dataset.name, rows


def train(sources: Sources, out: str | Path, *, planner: str = "", dataset: str = "", seed: int = 0) -> DifficultyModel:
    """Train a model of how difficult worlds are on trials, write its weights and return it.

    Args:
        sources: Folders of results, their results.parquet or results.csv, or tables of published times.
        out: Weights to write, .npz.
        planner: Learn the times of this one alone, not the mean of all.
        dataset: Where the worlds are, if not where the results say.
        seed: All randomness comes from it.

    Raises:
        BarnError: A source cannot be read, or there is too little to learn from.
    """
    if Path(out).suffix != ".npz":
        raise ConfigError(f"out {out}: must end in .npz")
    model = train_model(*read_samples(_paths(sources), planner, dataset), seed)
    save_model(model, Path(out))
    return model


def evaluate(
    source: str | Path,
    *,
    folds: int = 10,
    repeats: int = 5,
    further: Sources = (),
    card: str | Path | None = None,
    planner: str = "",
    dataset: str = "",
    seed: int = 0,
    progress: bool = True,
) -> Judged:
    """Judge the model in worlds that it was not trained on, beside ridge regression on the paper's five metrics.

    It is repeated k-fold over the worlds of a source. Worlds of `barn_test` are left whole; they judge models that were
    trained on further sources.

    Args:
        source: As for `train`.
        folds: Parts of the worlds.
        repeats: Divisions into folds.
        further: Sources with other worlds; models trained on these alone are judged too.
        card: Model card to write, .md; of the weights of the same name beside it, if there are any.
        planner: As for `train`.
        dataset: As for `train`.
        seed: All randomness comes from it.
        progress: Show how far it is.

    Raises:
        BarnError: A source cannot be read, or there is too little to learn from.
    """
    config = EvaluationConfig(folds=folds, repeats=repeats, seed=seed)
    sample = read_samples([Path(source)], planner, dataset)
    other = read_samples(_paths(further), planner) if further else None
    whole = held_out(sample[0].values()) is not None
    if whole and other is None:
        raise ConfigError(f"{source}: {HELD_OUT} is never trained on; name trials in other worlds (--further)")
    if whole and card is not None:
        raise ConfigError(f"card {card}: a card needs trials of another data set than {HELD_OUT}")
    shown = partial(track, description="models", console=Console(stderr=True), transient=True, disable=not progress)
    judge = partial(evaluate_models, *sample, config, track=shown)
    found = Judged(
        on_folds=None if whole else judge(),
        trained_elsewhere=judge(further=other) if other else None,
    )
    if card is not None and found.on_folds is not None:
        text = model_card(found.on_folds, Path(card).with_suffix(".npz"), found.trained_elsewhere)
        write_bytes(Path(card), text.encode())
    return found


def check(
    source: str | Path, *, weights: str | Path | None = None, planner: str = "", dataset: str = ""
) -> WeightsCheck:
    """Compare trained weights with the trials of a source, in worlds not trained on.

    Args:
        source: As for `train`.
        weights: File of a model. Default: the shipped one.
        planner: As for `train`.
        dataset: As for `train`.

    Raises:
        BarnError: The source or the weights cannot be read.
    """
    model = load_model(Path(weights) if weights else None)
    return check_weights(model, *read_samples([Path(source)], planner, dataset))


def _paths(sources: Sources) -> list[Path]:
    return [Path(sources)] if isinstance(sources, str | Path) else [Path(source) for source in sources]
