"""Metrics of many worlds as a table, for people and as JSON, and what the paper publishes of its worlds."""

from collections.abc import Iterable
from dataclasses import asdict, dataclass
from typing import Any

import numpy as np

from barn_metrics import metrics
from barn_worlds.base.arrays import Floats
from barn_worlds.base.errors import WorldError
from barn_worlds.base.text_files import make_json_safe, read_package_yaml
from barn_worlds.datasets.dataset import Dataset
from barn_worlds.worlds.world import World

SCHEMA_VERSION = 1
TABLE_II: dict[str, dict[str, float]] = read_package_yaml(
    "barn_metrics", "table_ii.yaml"
)


@dataclass(frozen=True, eq=False)
class MetricsTable:
    """The metrics of worlds, by number in their data set or by name."""

    formula: metrics.Formula
    worlds: tuple[str, ...]
    values: Floats  # (n, 5), in the order of `METRICS`
    cell_minimum: Floats  # (4,) over all cells of all paths, as in Table II
    cell_maximum: Floats

    def rows(self) -> list[dict[str, float]]:
        """Return the metrics of each world by name."""
        return [
            dict(zip(metrics.METRIC_NAMES, row, strict=True))
            for row in self.values.tolist()
        ]

    def as_json(self) -> dict[str, Any]:
        """Return everything as plain data; values that are not finite become None."""
        document = {
            "schema_version": SCHEMA_VERSION,
            "formula": asdict(self.formula),
            "units": {metric.name: metric.unit for metric in metrics.METRICS},
            "worlds": [
                {"world": world, **row}
                for world, row in zip(self.worlds, self.rows(), strict=True)
            ],
            "summary": {
                metric.name: self.summary_of(metric) for metric in metrics.METRICS
            },
        }
        return dict(make_json_safe(document))

    def summary_cells(self) -> tuple[list[str], list[list[str]]]:
        """Return headings and lines of the summary, two decimals: extremes of cells (as Table II), then of worlds."""
        headings = ["Metric", "Cell min.", "Cell max.", "Min.", "Max.", "Mean", "Std."]
        lines = []
        for metric in metrics.METRICS:
            values = self.summary_of(metric)
            shown = (
                "cell_minimum",
                "cell_maximum",
                "minimum",
                "maximum",
                "mean",
                "std",
            )
            lines.append(
                [
                    metric.title,
                    *(
                        "-" if key not in values else f"{values[key]:.2f}"
                        for key in shown
                    ),
                ]
            )
        return headings, lines

    def summary_of(self, metric: metrics.Metric) -> dict[str, float]:
        """Return minimum, maximum, mean and std (population) of a metric over worlds, and its extremes over cells."""
        k = metrics.METRICS.index(metric)
        with np.errstate(
            invalid="ignore"
        ):  # worlds without obstacles have infinite values, whose deviation is NaN
            over_worlds = {
                "minimum": self.values.min(axis=0),
                "maximum": self.values.max(axis=0),
                "mean": self.values.mean(axis=0),
                "std": self.values.std(axis=0),
            }
        found = {name: float(values[k]) for name, values in over_worlds.items()}
        if metric in metrics.CELL_METRICS:
            found |= {
                "cell_minimum": float(self.cell_minimum[k]),
                "cell_maximum": float(self.cell_maximum[k]),
            }
        return found


def metrics_table(
    worlds: Dataset | Iterable[World],
    formula: metrics.Formula | str = metrics.CORRECTED,
) -> MetricsTable:
    """Return the metrics of a data set or of worlds; WorldError if there is none or one cannot be read."""
    chosen = metrics.as_formula(formula)
    if isinstance(worlds, Dataset):
        labelled = ((str(index), worlds.load(index)) for index in worlds.world_numbers)
    else:
        labelled = ((world.name, world) for world in worlds)
    labels, rows, lowest, highest = [], [], [], []
    for label, world in labelled:
        values = metrics.world_cell_metrics(world, chosen)
        labels.append(label)
        rows.append(metrics.mean_metrics(values, world.path).as_array())
        lowest.append(values.min(axis=0))
        highest.append(values.max(axis=0))
    if not rows:
        raise WorldError("there are no worlds to compute metrics of")
    return MetricsTable(
        chosen,
        tuple(labels),
        np.array(rows),
        np.min(lowest, axis=0),
        np.max(highest, axis=0),
    )
