"""The learned difficulty of worlds."""

from pathlib import Path
from typing import Any

import pandas as pd

from barn_eval.analysis.pandas_tables import pandas_table
from barn_metrics.model import DifficultyModel, load_model
from barn_worlds.datasets.dataset import open_dataset

__all__ = ["predict"]


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
    return pandas_table(predictions(source, select, weights)[2])


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
