"""Trials for the difficulty model from a campaign, its tables, or a table of published times, with their worlds."""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path

import numpy as np
import pyarrow as pa
import pyarrow.csv
import pyarrow.parquet

from barn_eval.analysis.published import read_published
from barn_eval.analysis.sources import read_source
from barn_eval.trials.result import TrialResult
from barn_metrics.model.trials import Trials
from barn_worlds.dataset import Dataset, open_dataset
from barn_worlds.errors import ConfigError, suggest
from barn_worlds.world import World

_LARGEST_TABLE_BYTES = 200_000_000
_SAME_LENGTH_M = 0.001  # tables of published times hold path lengths with six decimals
# Columns that are needed of a campaign's table: what they hold in words, and whether a column's type is that.
_KINDS = {
    "dataset": "name",
    "world": "whole number",
    "world_checksum": "checksum",
    "planner": "name",
    "normalised_time_s_per_m": "number",
    "success": "true or false",
}
_COLUMNS: dict[str, Callable[[pa.DataType], bool]] = {
    "dataset": pa.types.is_string,
    "world": pa.types.is_integer,
    "world_checksum": pa.types.is_string,
    "planner": pa.types.is_string,
    "normalised_time_s_per_m": lambda kind: pa.types.is_floating(kind) or pa.types.is_integer(kind),
    "success": pa.types.is_boolean,
}


@dataclass(frozen=True)
class _Row:
    """What is needed of one trial."""

    dataset: str
    world: int
    world_checksum: str
    planner: str
    normalised_time_s_per_m: float
    success: bool

    @classmethod
    def of_result(cls, result: TrialResult) -> _Row:
        """Return the row of a campaign's result."""
        scores = result.scores
        time = scores.normalised_time_s_per_m
        return cls(result.dataset, result.world, result.world_checksum, result.planner, time, scores.success)


def read_trials(source: Path, dataset: str | None = None) -> tuple[dict[int, World], Trials]:
    """Return the worlds by number and the trials made in them.

    source: folder of a campaign or run, finished or not; its results.parquet or results.csv; or a table of published
    times (world, path_length_m, dwa_1, ...). dataset: where the worlds are, if not in the data set that the results
    name or, for published times, in the folder of the table. Raises BarnError in one line for what cannot be read, or
    for worlds that are not those that the trials were made in.
    """
    if source.is_dir():
        found = read_source(source)
        return _of_campaign(
            [_Row.of_result(result) for result in found.results],
            source,
            open_dataset(dataset or str(found.configuration.get("dataset"))),
        )
    if source.suffix not in (".parquet", ".csv"):
        raise ConfigError(f"{source}: must be the folder of a campaign, or a table that ends in .parquet or .csv")
    _check_size(source)
    if source.suffix == ".csv" and not _is_campaign_table(source):
        return _of_published(source, open_dataset(dataset or source.resolve().parent))
    rows = _table_rows(source)
    return _of_campaign(rows, source, open_dataset(dataset or rows[0].dataset))


def _of_campaign(rows: Sequence[_Row], source: Path, dataset: Dataset) -> tuple[dict[int, World], Trials]:
    # A data set may have been numbered anew since: a world is known by its checksum.
    known = {(world := dataset.load(index)).checksum: (index, world) for index in dataset.indices}
    lost = next((row.world for row in rows if row.world_checksum not in known), None)
    if lost is not None:
        raise ConfigError(
            f"{source}: world {lost} of its trials is none of {dataset.name}; name the data set they ran in"
        )
    numbers = [known[row.world_checksum][0] for row in rows]
    tried = set(numbers)
    worlds = {number: world for number, world in known.values() if number in tried}
    trials = Trials(
        np.array(numbers, np.int64),
        tuple(row.planner for row in rows),
        np.array([row.normalised_time_s_per_m for row in rows]),
        np.array([row.success for row in rows], np.bool_),
    )
    return _common(worlds, trials)


def _of_published(source: Path, dataset: Dataset) -> tuple[dict[int, World], Trials]:
    published = read_published(source)
    lengths = next(iter(published.values())).lengths_m
    worlds = {number: dataset.load(number) for number in sorted(lengths)}
    for number, world in worlds.items():
        if abs(world.path_length_m - lengths[number]) > _SAME_LENGTH_M:
            raise ConfigError(
                f"{source}: path of world {number} has {lengths[number]:.3f} m, "
                f"{world.path_length_m:.3f} m in {dataset.name}"
            )
    trials = Trials(
        np.concatenate([one.worlds for one in published.values()]),
        tuple(planner for planner, one in published.items() for _ in one.worlds),
        np.concatenate([one.normalised_s_per_m for one in published.values()]),
        ~np.concatenate([one.failed for one in published.values()]),
    )
    return _common(worlds, trials)


def _common(worlds: Mapping[int, World], trials: Trials) -> tuple[dict[int, World], Trials]:
    """Return the worlds that every planner was tried in, ascending, and the trials there."""
    numbers = trials.world_numbers
    if not numbers:
        raise ConfigError(f"no world has trials of all of {', '.join(trials.planner_names)}")
    return {number: worlds[number] for number in numbers}, trials.only(numbers)


def _check_size(path: Path) -> None:
    try:
        size = path.stat().st_size
    except OSError as error:
        raise ConfigError(f"{path}: {error.strerror or error}") from None
    if size > _LARGEST_TABLE_BYTES:
        raise ConfigError(f"{path}: must be at most {_LARGEST_TABLE_BYTES} bytes, has {size}")


def _is_campaign_table(path: Path) -> bool:
    with path.open("rb") as file:
        return b"world_checksum" in file.readline(10_000)


def _table_rows(path: Path) -> list[_Row]:
    """Return the rows of a campaign's results.parquet or results.csv; ConfigError for a file that is none."""
    try:
        if path.suffix == ".parquet":
            table = pyarrow.parquet.read_table(path, memory_map=False)
        else:
            table = pyarrow.csv.read_csv(path)
    except (pa.ArrowException, OSError, ValueError) as error:
        raise ConfigError(f"{path}: cannot be read: {' '.join(str(error).split())[:200]}") from None
    for name, is_right in _COLUMNS.items():
        if name not in table.column_names:
            raise ConfigError(f"{path}: no column {name!r}{suggest(name, table.column_names)}")
        column = table.column(name)
        if not is_right(column.type) or column.null_count:
            raise ConfigError(f"{path}: column {name!r} must hold a {_KINDS[name]} in every row, has {column.type}")
    if not table.num_rows:
        raise ConfigError(f"{path}: has no rows")
    return [_Row(**row) for row in table.select(list(_COLUMNS)).to_pylist()]
