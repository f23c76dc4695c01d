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
    """Return a DataFrame of the learned model's predicted time per meter of each world.

    Args:
        source: A data set's name, or a file or folder of worlds.
        select: World numbers, such as "0-49".
        weights: File of a model, .npz. Default: the shipped model.

    Returns:
        A row per world: world, name, difficulty_s_per_m (mean time per meter of path of
        trials under the paper's protocol), std_s_per_m (standard deviation of trials in
        a new world around that mean), and PLANNER_s_per_m, the same per planner.

    Raises:
        BarnError: If a world or the weights cannot be read.
    """
    _, _, rows = predict_rows(source, select, weights)
    return pandas_table(rows)


def predict_rows(
    source: str | Path, select: str, weights: str | Path | None
) -> tuple[DifficultyModel, str, list[dict[str, Any]]]:
    """Predict difficulty; return (model, name of the data set, a row per world).

    Args:
        source: A data set's name, or a file or folder of worlds.
        select: World numbers, such as "0-49".
        weights: File of a model, .npz. None stands for the shipped model.

    Returns:
        The model, the name of the data set, and the row of each world.
    """
    model = load_model(weights)
    dataset = open_dataset(source)
    rows = []
    for number, prediction in model.predict_dataset(dataset, select).items():
        # Predictions have the numbers of worlds, but not their names.
        name = dataset.load(number).name
        rows.append({"world": number, "name": name, **prediction.columns()})
    return model, dataset.name, rows
