"""Tables of published trial times, and how well the difficulty model knows them.

    python qa/fidelity/published.py ../shared/barn_original/trials.csv

A row per world: `world`, `path_length_m` and columns PLANNER_1, PLANNER_2, ... of times
in seconds. The worlds are in the folder of the table. The shipped weights are judged
beside ridge regression on the five metrics in worlds held out; intervals are of 95%,
over worlds.
"""

import csv
import math
import re
import sys
from collections.abc import Iterable, Mapping
from dataclasses import dataclass
from pathlib import Path

import click
import numpy as np
import numpy.typing as npt

sys.path.insert(0, str(Path(__file__).parents[1] / "studies/difficulty"))

from evaluation import EvaluationConfig, evaluate
from trial_sources import Trials

from barn_metrics.model import load_model
from barn_worlds.base.arrays import Floats, Integers
from barn_worlds.base.errors import (
    BarnError,
    ConfigError,
    convert_os_errors,
    format_value,
)
from barn_worlds.datasets.dataset import open_dataset
from barn_worlds.worlds.world import World

# How failures stand in the paper's table: exactly 30 s, or cut off at 50 s.
FAILURE_TIME_S = 30.0
LIMIT_S = 50.0
SAME_LENGTH_M = (
    0.001  # path lengths of the same world: tables hold them with six decimals
)
_COLUMN = re.compile(r"(.+)_([1-9][0-9]*)")


@dataclass(frozen=True, eq=False)
class TimedTrials:
    """Trials of one planner.

    Number of the world, time as counted in seconds, whether it failed (each (n,)).

    lengths_m: arc length of the path of each world in meters.
    """

    worlds: Integers
    times_s: Floats
    failed: npt.NDArray[np.bool_]
    lengths_m: Mapping[int, float]

    @property
    def normalised_s_per_m(self) -> Floats:
        """The times by the length of the world's path (n,)."""
        lengths_m: Floats = np.array(
            [self.lengths_m[int(world)] for world in self.worlds]
        )
        return self.times_s / lengths_m

    def other_length(self, lengths_m: Iterable[tuple[int, float]]) -> int | None:
        """Return the first of some worlds whose path has another length here."""
        return next(
            (
                world
                for world, length_m in lengths_m
                if abs(length_m - self.lengths_m[world]) > SAME_LENGTH_M
            ),
            None,
        )


def read_published(path: Path) -> dict[str, TimedTrials]:
    """Return the published trials by planner.

    Raises:
        ConfigError: For a file that is no such table. The message is one line.
    """
    lengths: dict[int, float] = {}
    times: dict[str, list[tuple[int, float]]] = {}
    with convert_os_errors(ConfigError, path), path.open(newline="") as file:
        for line, row in enumerate(csv.DictReader(file, strict=True), 2):
            where = f"{path}, line {line}"
            world = int(_above(-1.0, where, "world", row))
            lengths[world] = _above(0.0, where, "path_length_m", row)
            for column in row:
                if match := _COLUMN.fullmatch(column or ""):
                    times.setdefault(match[1], []).append(
                        (world, _above(0.0, where, column, row))
                    )
    if not times:
        raise ConfigError(
            f"{path}: must have at least one world and columns of times, such as dwa_1"
        )
    return {planner: _trials(pairs, lengths) for planner, pairs in times.items()}


def _trials(
    times_by_world: list[tuple[int, float]], lengths: Mapping[int, float]
) -> TimedTrials:
    times = np.array([time for _, time in times_by_world])
    failed = np.isclose(times, FAILURE_TIME_S, rtol=0.0, atol=1e-9) | (times >= LIMIT_S)
    return TimedTrials(
        np.array([world for world, _ in times_by_world], np.int64),
        times,
        failed,
        lengths,
    )


def _above(low: float, where: str, column: str, row: Mapping[str, str]) -> float:
    try:
        value = float(row.get(column) or "")
    except ValueError:
        value = math.nan
    if not low < value < math.inf:
        text = format_value(row.get(column))
        raise ConfigError(
            f"{where}: {column} must be a number above {low:g}, got {text}"
        )
    return value


def published_trials(path: Path) -> tuple[dict[int, World], Trials]:
    """Return the worlds of a table, by number, and the trials in them.

    Raises:
        ConfigError: For worlds with other paths.
    """
    published = read_published(path)
    dataset = open_dataset(path.resolve().parent)
    first = next(iter(published.values()))
    worlds = {number: dataset.load(number) for number in sorted(first.lengths_m)}
    lengths_m = [(number, world.path_length_m) for number, world in worlds.items()]
    other = first.other_length(lengths_m)
    if other is not None:
        raise ConfigError(
            f"{path}: path of world {other} has another length in {dataset.name}"
        )
    tables = published.values()
    trials = Trials(
        np.concatenate([table.worlds for table in tables]),
        tuple(name for name, table in published.items() for _ in table.worlds),
        np.concatenate([table.normalised_s_per_m for table in tables]),
        ~np.concatenate([table.failed for table in tables]),
    )
    return worlds, trials


@click.command()
@click.argument("table", type=click.Path(path_type=Path))
def main(table: Path) -> None:
    """Judge the shipped weights by published times."""
    try:
        report = evaluate(*published_trials(table), load_model(), EvaluationConfig())
    except BarnError as error:
        raise click.ClickException(str(error)) from None
    for score in report.scores:
        click.echo(
            f"{score.name}: error {score.mse.text()}, R2 {score.r2.text()}, Spearman {score.spearman.text()}"
        )


if __name__ == "__main__":
    main()
