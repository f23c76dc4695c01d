"""The five difficulty metrics of the data set beside Table II."""

from dataclasses import dataclass

import numpy as np

from barn_eval.analysis.means import mean_interval
from barn_eval.studies.reproduction.trials import deviation
from barn_metrics.bootstrap import Interval
from barn_metrics.formula import CORRECTED, PUBLISHED
from barn_metrics.metrics import METRICS
from barn_metrics.report import metrics_table
from barn_worlds.worlds.dataset import Dataset, shipped
from barn_worlds.worlds.generate import DatasetParameters, generate_dataset


@dataclass(frozen=True)
class MetricRow:
    """One metric over all worlds of the data set, with 95 % intervals over worlds.

    minimum, maximum: over the cells of all paths, for tortuosity over paths. corrected_mean, corrected_std: by
    the corrected formula, from which the published one (historical visibility, uneven dispersion, four axes) differs.
    """

    name: str
    title: str
    minimum: float
    maximum: float
    mean: Interval
    std: Interval
    corrected_mean: float
    corrected_std: float


@dataclass(frozen=True)
class MetricsFinding:
    """Table II of the data set, by the formula that reproduces the published numbers from the published worlds.

    regenerated: whether the shipped data set, generated anew from its seed, has the same worlds; None for another one.
    """

    worlds: int
    rows: tuple[MetricRow, ...]
    regenerated: bool | None


def metrics_finding(dataset: Dataset, seed: int) -> MetricsFinding:
    """Return the table of a whole data set."""
    table, corrected = (metrics_table(dataset, formula) for formula in (PUBLISHED, CORRECTED))
    rows = []
    for metric, values in zip(METRICS, table.values.T, strict=True):
        ours, better = table.summary_of(metric), corrected.summary_of(metric)
        rows.append(
            MetricRow(
                metric.name,
                metric.title,
                ours.get("cell_minimum", ours["minimum"]),
                ours.get("cell_maximum", ours["maximum"]),
                mean_interval(values, np.arange(len(values))),
                deviation(values, seed),
                better["mean"],
                better["std"],
            )
        )
    return MetricsFinding(len(table.worlds), tuple(rows), _regenerated(dataset))


def _regenerated(dataset: Dataset) -> bool | None:
    parameters = DatasetParameters()
    if dataset.name != parameters.name or dataset.name not in shipped():
        return None
    made = {world.checksum for world in generate_dataset(parameters)}
    return made == {dataset.load(index).checksum for index in dataset.indices}
