"""What worlds measure: the five difficulty metrics."""

from functools import partial
from pathlib import Path

import pandas as pd

from barn_eval.results.frames import frame_of
from barn_eval.worlds.sets import fitting
from barn_metrics.metrics import as_formula
from barn_metrics.report import MetricsTable
from barn_metrics.report import metrics_table as table_of
from barn_worlds.robots.files import load_robot
from barn_worlds.worlds.dataset import Dataset, open_dataset, select_worlds
from barn_worlds.worlds.world import World


def metrics(
    source: str | Path = "barn300", select: str = "all", formula: str = "corrected", *, robot: str | Path = ""
) -> pd.DataFrame:
    """Return the five difficulty metrics of worlds; docs/metrics.md says what they measure, and their units.

    Args:
        source: A data set's name, or a file or folder of worlds.
        select: Which worlds, such as "0-49".
        formula: corrected, published (the numbers in print) or paper_text.
        robot: Whose C-space and path they are taken from, in place of the worlds' own.

    Returns:
        A row per world; its column `world` is the number.

    Raises:
        BarnError: A world cannot be read, or has no way for the robot.
    """
    table = metrics_table(source, select, formula, robot=robot)
    return frame_of({"world": int(world), **row} for world, row in zip(table.worlds, table.rows(), strict=True))


def metrics_table(
    source: str | Path, select: str = "all", formula: str = "corrected", *, robot: str | Path = ""
) -> MetricsTable:
    """Return the same with its summary, as in the paper's Table II."""
    chosen, dataset = as_formula(formula), open_dataset(source)
    driven = load_robot(robot) if robot else None

    def read(index: int) -> World:
        return dataset.load(index) if driven is None else fitting(dataset.load(index), driven)

    readers = {index: partial(read, index) for index in select_worlds(select, dataset.indices)}
    return table_of(Dataset(dataset.name, readers), chosen)
