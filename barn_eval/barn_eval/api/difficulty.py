"""The learned difficulty of worlds: predicted, judged by trials, and trained on them."""

from collections.abc import Mapping, Sequence
from importlib import import_module
from pathlib import Path
from typing import Any

import numpy as np
import pandas as pd

from barn_eval.analysis.frames import frame_of
from barn_eval.analysis.sources import read_source
from barn_metrics.model import DifficultyModel, load_model, save_model
from barn_metrics.model.evaluation import Evaluation, EvaluationConfig
from barn_metrics.model.evaluation import evaluate as evaluate_model
from barn_metrics.model.trials import Trials, join_trials
from barn_worlds.base.errors import ConfigError
from barn_worlds.datasets.dataset import open_dataset
from barn_worlds.worlds.world import World

__all__ = ["evaluate", "predict", "train"]


def predict(
    source: str | Path = "barn300",
    select: str = "all",
    *,
    weights: str | Path | None = None,
) -> pd.DataFrame:
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
    rows = [
        {"world": one, "name": dataset.load(one).name, **made.columns()}
        for one, made in found.items()
    ]
    return model, dataset.name, rows


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
    """Judge the model by trials, beside ridge regression on the paper's five metrics.

    Ridge regression is judged by repeated k-fold over the worlds of the source; worlds of `barn_test` judge the model
    alone.

    Args:
        source: Folder of an experiment.
        weights: File of a model. Default: the shipped one.
        folds: Parts of the worlds.
        repeats: Divisions into folds.
        planner: Judge by the times of this one alone, not by the mean of all.
        dataset: Where the worlds are, if not where the results say.
        seed: All randomness comes from it.

    Returns:
        The errors of both, in (s/m)^2, with intervals of 95 % over worlds.

    Raises:
        BarnError: The source or the weights cannot be read, or there are too few worlds.
    """
    worlds, trials = joined_trials([source], planner, dataset)
    config = EvaluationConfig(folds=folds, repeats=repeats, seed=seed)
    return evaluate_model(worlds, trials, load_model(weights), config)


def train(
    sources: str | Path | Sequence[str | Path],
    out: str | Path,
    *,
    planner: str = "",
    dataset: str = "",
    seed: int = 0,
) -> None:
    """Train a model on trials and write its weights; it needs PyTorch (`make extras`).

    Args:
        sources: Folders of experiments.
        out: File to write, .npz.
        planner: Learn the times of this one alone, not the mean of all.
        dataset: Where the worlds are, if not where the results say.
        seed: All randomness comes from it.

    Raises:
        BarnError: A source cannot be read, there are too few worlds, some are of `barn_test`, or PyTorch is missing.
    """
    try:
        trainer = import_module("barn_metrics.model.training")
    except ModuleNotFoundError as error:
        if error.name != "torch":
            raise
        raise ConfigError(
            "training needs PyTorch: make extras, or pip install torch==2.13.0"
        ) from None
    paths = [sources] if isinstance(sources, str | Path) else sources
    save_model(trainer.train(*joined_trials(paths, planner, dataset), seed), Path(out))


def joined_trials(
    sources: Sequence[str | Path], planner: str = "", dataset: str = ""
) -> tuple[Mapping[int, World], Trials]:
    """Return worlds and trials of all sources as `read_trials` reads them, of one planner if it is named."""
    parts = [read_trials(Path(source), dataset) for source in sources]
    worlds, trials = parts[0] if len(parts) == 1 else join_trials(parts)
    return worlds, trials.of(planner) if planner else trials


def read_trials(source: Path, dataset: str = "") -> tuple[dict[int, World], Trials]:
    """Return worlds by number, those that every planner was tried in, and the trials in them of an experiment's folder.

    dataset: where the worlds are, if not where the experiment names them. BarnError in one line for what cannot be
    read, or for other worlds.
    """
    found = read_source(source)
    worlds = open_dataset(dataset or str(found.configuration.get("dataset")))
    known = {
        (world := worlds.load(index)).checksum: (index, world)
        for index in worlds.world_numbers
    }
    lost = next(
        (one.world for one in found.results if one.world_checksum not in known), None
    )
    if lost is not None:
        other = f"world {lost} of its trials is none of {worlds.name}"
        raise ConfigError(f"{source}: {other}; name the data set they ran in")
    trials = Trials(
        np.array([known[one.world_checksum][0] for one in found.results], np.int64),
        tuple(one.planner for one in found.results),
        np.array([one.scores.normalised_time_s_per_m for one in found.results]),
        np.array([one.scores.success for one in found.results], np.bool_),
    )
    if not trials.world_numbers:
        raise ConfigError(
            f"no world has trials of all of {', '.join(trials.planner_names)}"
        )
    numbered = dict(known.values())
    return {number: numbered[number] for number in trials.world_numbers}, trials.only(
        trials.world_numbers
    )
