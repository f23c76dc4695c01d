"""Metrics of many worlds as a table, and the paper's published summary."""

from collections.abc import Callable, Iterable
from dataclasses import asdict, dataclass
from typing import Any

import numpy as np

from barn_metrics import metrics
from barn_worlds.base.arrays import Floats
from barn_worlds.base.errors import WorldError
from barn_worlds.base.files import make_json_safe, read_package_yaml
from barn_worlds.datasets.dataset import Dataset
from barn_worlds.worlds.world import World

SCHEMA_VERSION = 1
TABLE_II: dict[str, dict[str, float]] = read_package_yaml(
    "barn_metrics", "table_ii.yaml"
)
_SUMMARY_FUNCTIONS: dict[str, Callable[..., Floats]] = {
    "minimum": np.min,
    "maximum": np.max,
    "mean": np.mean,
    "std": np.std,
}
# Columns of the summary for people, by their key in the summary of a metric.
_SUMMARY_HEADINGS = {
    "cell_minimum": "Cell min.",
    "cell_maximum": "Cell max.",
    "minimum": "Min.",
    "maximum": "Max.",
    "mean": "Mean",
    "std": "Std.",
}


@dataclass(frozen=True, eq=False)
class MetricsTable:
    """The metrics of worlds."""

    formula: metrics.Formula
    # Numbers in their data set, or names.
    worlds: tuple[str, ...]
    # (n, 5) in the order of `METRICS`.
    values: Floats
    # (4,) over all cells of all paths, as in Table II.
    cell_minimum: Floats
    cell_maximum: Floats

    def rows(self) -> list[dict[str, float]]:
        """Return a dict for each world, from the name of a metric to its value."""
        return [
            dict(zip(metrics.METRIC_NAMES, row, strict=True))
            for row in self.values.tolist()
        ]

    def as_json(self) -> dict[str, Any]:
        """Return table and summary as a dict for JSON; NaN and infinity become None."""
        worlds = zip(self.worlds, self.rows(), strict=True)
        document = {
            "schema_version": SCHEMA_VERSION,
            "formula": asdict(self.formula),
            "units": {metric.name: metric.unit for metric in metrics.METRICS},
            "worlds": [{"world": world, **row} for world, row in worlds],
            "summary": {
                metric.name: self.summary_of(metric) for metric in metrics.METRICS
            },
        }
        return dict(make_json_safe(document))

    def summary_cells(self) -> tuple[list[str], list[list[str]]]:
        """Return headings and text rows of the summary, one row for each metric.

        Numbers have two decimals. The columns with the extremes of cells, which are in
        Table II as well, come before those with the extremes of worlds.
        """
        lines = []
        for metric in metrics.METRICS:
            summary = self.summary_of(metric)
            line = [metric.title]
            for key in _SUMMARY_HEADINGS:
                line.append(f"{summary[key]:.2f}" if key in summary else "-")
            lines.append(line)
        return ["Metric", *_SUMMARY_HEADINGS.values()], lines

    def summary_of(self, metric: metrics.Metric) -> dict[str, float]:
        """Return min, max, mean, population std over worlds; extremes of cells, if any.

        Metrics of cells have extremes over cells as well.
        """
        column = metrics.METRICS.index(metric)
        # Along the first axis of all metrics: the last bit of a sum depends on how
        # NumPy adds. Worlds without obstacles have infinite values, whose deviation is
        # NaN.
        summary = {}
        with np.errstate(invalid="ignore"):
            for name, function in _SUMMARY_FUNCTIONS.items():
                summary[name] = float(function(self.values, axis=0)[column])
        if metric in metrics.CELL_METRICS:
            summary["cell_minimum"] = float(self.cell_minimum[column])
            summary["cell_maximum"] = float(self.cell_maximum[column])
        return summary


def metrics_table(
    worlds: Dataset | Iterable[World],
    formula: metrics.Formula | str = metrics.CORRECTED,
) -> MetricsTable:
    """Return the metrics of all worlds as a table; WorldError if there are no worlds.

    Args:
        worlds: A data set, whose worlds are labeled by number, or worlds, by name.
        formula: A key of `FORMULAS`, or variants of your own.

    Raises:
        WorldError: If there is no world, or one cannot be read or is an arena.
    """
    formula = metrics.as_formula(formula)
    labeled_worlds: Iterable[tuple[str, World]]
    # World by world, so that not all of them are in memory at once.
    if isinstance(worlds, Dataset):
        dataset = worlds
        labeled_worlds = ((str(n), dataset.load(n)) for n in dataset.world_numbers)
    else:
        labeled_worlds = ((world.name, world) for world in worlds)

    labels = []
    rows = []
    lowest = []
    highest = []
    for label, world in labeled_worlds:
        labels.append(label)
        values = metrics.world_cell_metrics(world, formula)
        rows.append(metrics.mean_metrics(values, world.path).as_array())
        lowest.append(values.min(axis=0))
        highest.append(values.max(axis=0))
    if not rows:
        raise WorldError("there are no worlds to compute metrics for")

    return MetricsTable(
        formula,
        tuple(labels),
        np.array(rows),
        np.min(lowest, axis=0),
        np.max(highest, axis=0),
    )
