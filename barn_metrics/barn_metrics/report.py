"""Metrics of many worlds as a table, for people and as CSV and JSON, and what the paper publishes of its worlds."""

import csv
import io
import json
from collections.abc import Iterable, Iterator
from dataclasses import asdict, astuple, dataclass
from pathlib import Path

import numpy as np

from barn_metrics.formula import CORRECTED, Formula, as_formula
from barn_metrics.metrics import (
    CELL_METRICS,
    METRIC_NAMES,
    METRICS,
    Metric,
    MetricsSummary,
    WorldMetrics,
    averaged,
    summarise,
    world_cell_metrics,
)
from barn_worlds.base.arrays import Floats
from barn_worlds.base.errors import WorldError
from barn_worlds.base.files import write_bytes
from barn_worlds.base.text_files import finite
from barn_worlds.worlds.dataset import Dataset
from barn_worlds.worlds.world import World

SCHEMA_VERSION = 1


@dataclass(frozen=True)
class PublishedRow:
    """One line of Table II. The paper takes minimum and maximum over cells, for tortuosity over paths."""

    minimum: float
    maximum: float
    mean: float
    std: float


# Values by the name of the field of `barn_worlds.worlds.parameters.WorldParameters`; each combination was repeated.
TABLE_I: dict[str, tuple[float, ...]] = {
    "initial_fill": (0.15, 0.20, 0.25, 0.30),
    "smoothing_iterations": (2, 3, 4),
    "fill_threshold": (5,),
    "clear_threshold": (1,),
}
REPETITIONS = 25

TABLE_II: dict[str, PublishedRow] = dict(
    zip(
        METRIC_NAMES,
        (
            PublishedRow(1.0, 10.20, 2.37, 0.93),
            PublishedRow(1.0, 14.00, 4.42, 1.64),
            PublishedRow(0.0, 12.00, 4.35, 0.89),
            PublishedRow(0.0, 20.00, 4.05, 2.66),
            PublishedRow(1.0, 1.71, 1.21, 0.14),
        ),
        strict=True,
    )
)


@dataclass(frozen=True)
class MetricsRow:
    """The metrics of one world; `world` is its number in a data set, else its name."""

    world: str
    metrics: WorldMetrics


@dataclass(frozen=True, eq=False)
class MetricsTable:
    """The metrics of worlds and their summary.

    cell_minimum, cell_maximum: (4,) extremes of the cell metrics over all cells of all paths, as in the first two
    columns of Table II.
    """

    formula: Formula
    rows: tuple[MetricsRow, ...]
    summary: MetricsSummary
    cell_minimum: Floats
    cell_maximum: Floats

    def to_csv(self, path: Path) -> None:
        """Write one line per world, in full precision, atomically; WorldError if that fails."""
        text = io.StringIO()
        writer = csv.writer(text, lineterminator="\n")
        writer.writerow(["world", *METRIC_NAMES])
        writer.writerows([row.world, *map(repr, astuple(row.metrics))] for row in self.rows)
        write_bytes(path, text.getvalue().encode())

    def to_json(self) -> str:
        """Return everything as JSON; values that are not finite become null."""
        document = {
            "schema_version": SCHEMA_VERSION,
            "formula": asdict(self.formula),
            "units": {metric.name: metric.unit for metric in METRICS},
            "worlds": [{"world": row.world, **asdict(row.metrics)} for row in self.rows],
            "summary": {metric.name: self.summary_of(metric) for metric in METRICS},
        }
        return json.dumps(finite(document), indent=2, allow_nan=False) + "\n"

    def summary_cells(self) -> tuple[list[str], list[list[str]]]:
        """Return headings and lines of the summary, two decimals: extremes of cells (as Table II), then of worlds."""
        headings = ["Metric", "Cell min.", "Cell max.", "Min.", "Max.", "Mean", "Std."]
        lines = []
        for metric in METRICS:
            values = self.summary_of(metric)
            shown = ("cell_minimum", "cell_maximum", "minimum", "maximum", "mean", "std")
            lines.append([metric.title, *("-" if key not in values else f"{values[key]:.2f}" for key in shown)])
        return headings, lines

    def summary_of(self, metric: Metric) -> dict[str, float]:
        """Return minimum, maximum, mean and std of a metric over worlds; its extremes over cells if they have it."""
        k = METRICS.index(metric)
        found = {key: float(getattr(self.summary, key)[k]) for key in ("minimum", "maximum", "mean", "std")}
        if metric in CELL_METRICS:
            found |= {"cell_minimum": float(self.cell_minimum[k]), "cell_maximum": float(self.cell_maximum[k])}
        return found


def metrics_table(worlds: Dataset | Iterable[World], formula: Formula | str = CORRECTED) -> MetricsTable:
    """Return the metrics of a data set or of worlds; WorldError if there is none or one cannot be read."""
    chosen = as_formula(formula)
    rows, lowest, highest = [], [], []
    for label, world in _labelled(worlds):
        values = world_cell_metrics(world, chosen)
        rows.append(MetricsRow(label, averaged(values, world.path)))
        lowest.append(values.min(axis=0))
        highest.append(values.max(axis=0))
    if not rows:
        raise WorldError("there are no worlds to compute metrics of")
    summary = summarise([row.metrics for row in rows])
    return MetricsTable(chosen, tuple(rows), summary, np.min(lowest, axis=0), np.max(highest, axis=0))


def _labelled(worlds: Dataset | Iterable[World]) -> Iterator[tuple[str, World]]:
    if isinstance(worlds, Dataset):
        yield from ((str(index), worlds.load(index)) for index in worlds.indices)
    else:
        yield from ((world.name, world) for world in worlds)
