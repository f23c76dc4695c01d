"""What the difficulty model is trained on, from campaigns and tables, and scores of worlds."""

import math
from collections import defaultdict
from collections.abc import Iterable, Mapping, Sequence
from pathlib import Path
from typing import Any

import numpy as np
import pyarrow as pa
import pyarrow.csv
import pyarrow.parquet

from barn_eval.analysis.published import read_published
from barn_eval.analysis.sources import read_source
from barn_eval.trials.outcome import ENVIRONMENT, SIMULATOR
from barn_metrics.model.trials import Trials, joined
from barn_worlds.base.errors import ConfigError, one_line, shown, suggest
from barn_worlds.base.files import read_at_most
from barn_worlds.base.text_files import read_csv
from barn_worlds.worlds.dataset import Dataset, open_dataset
from barn_worlds.worlds.world import World

_LARGEST_TABLE_BYTES = 200_000_000
_MOST_ROWS = 1_000_000
# What is needed of a campaign's table.
_COLUMNS = {
    "dataset": pa.string(),
    "world": pa.int64(),
    "world_checksum": pa.string(),
    "planner": pa.string(),
    "normalised_time_s_per_m": pa.float64(),
    "success": pa.bool_(),
}
_FAULT = "fault"  # who failed; tables of earlier versions do not have it


def read_samples(sources: Sequence[Path], planner: str = "", dataset: str = "") -> tuple[Mapping[int, World], Trials]:
    """Return worlds and trials of all sources as `read_trials` reads them, of one planner if it is named."""
    parts = [read_trials(source, dataset) for source in sources]
    worlds, trials = parts[0] if len(parts) == 1 else joined(parts)
    return worlds, trials.of(planner) if planner else trials


def read_trials(source: Path, dataset: str = "") -> tuple[dict[int, World], Trials]:
    """Return the worlds by number and the trials made in them.

    source: folder of a campaign or run, finished or not; its results.parquet or results.csv; or a table of published
    times (world, path_length_m, dwa_1, ...). dataset: where the worlds are, if not in the data set that the results
    name or, for published times, in the folder of the table. Raises BarnError in one line for what cannot be read, or
    for worlds that are not those that the trials were made in.
    """
    if source.is_dir():
        found = read_source(source)
        rows = [vars(one.scores) | vars(one) for one in found.results]
        return _of_campaign(rows, source, open_dataset(dataset or str(found.configuration.get("dataset"))))
    if source.suffix not in (".parquet", ".csv"):
        raise ConfigError(f"{source}: must be the folder of a campaign, or a table that ends in .parquet or .csv")
    table = _read_table(source)
    if source.suffix == ".csv" and "world_checksum" not in table.column_names:
        return _of_published(source, open_dataset(dataset or source.resolve().parent))
    rows = _campaign_rows(table, source)
    return _of_campaign(rows, source, open_dataset(dataset or rows[0]["dataset"]))


def read_scores(file: Path, column: str, worlds: Sequence[int]) -> tuple[float, ...]:
    """Return one score per world: the mean of a column over the rows of a CSV file with the world's number in `world`.

    A campaign's results.csv is such a file. Raises ConfigError in one line for a file that cannot be read, a missing
    column, a value that is not a finite number, or a world without a row.
    """
    values: dict[int, list[float]] = defaultdict(list)
    for where, row in read_csv(file, ("world", column)):
        try:
            world, value = int(row["world"]), float(row[column])
        except ValueError:
            got = f"{shown(row['world'])} and {shown(row[column])}"
            raise ConfigError(f"{where}: must hold a world's number and a score, got {got}") from None
        if not math.isfinite(value):
            raise ConfigError(f"{where}: score must be finite, got {shown(row[column])}")
        values[world].append(value)
    missing = next((world for world in worlds if world not in values), None)
    if missing is not None:
        raise ConfigError(f"{file}: no row for world {missing}")
    return tuple(math.fsum(values[world]) / len(values[world]) for world in worlds)


def _of_campaign(rows: Sequence[Mapping[str, Any]], source: Path, dataset: Dataset) -> tuple[dict[int, World], Trials]:
    # A data set may have been numbered anew since: a world is known by its checksum.
    known = {(world := dataset.load(index)).checksum: (index, world) for index in dataset.indices}
    lost = next((row["world"] for row in rows if row["world_checksum"] not in known), None)
    if lost is not None:
        raise ConfigError(
            f"{source}: world {lost} of its trials is none of {dataset.name}; name the data set they ran in"
        )
    trials = Trials(
        np.array([known[row["world_checksum"]][0] for row in rows], np.int64),
        tuple(row["planner"] for row in rows),
        np.array([row["normalised_time_s_per_m"] for row in rows]),
        np.array([row["success"] for row in rows], np.bool_),
    )
    return _common(known.values(), trials)


def _of_published(source: Path, dataset: Dataset) -> tuple[dict[int, World], Trials]:
    published = read_published(source)
    first = next(iter(published.values()))
    worlds = {number: dataset.load(number) for number in sorted(first.lengths_m)}
    other = first.other_length((number, world.path_length_m) for number, world in worlds.items())
    if other is not None:
        raise ConfigError(
            f"{source}: path of world {other} has {first.lengths_m[other]:.3f} m, "
            f"{worlds[other].path_length_m:.3f} m in {dataset.name}"
        )
    trials = Trials(
        np.concatenate([one.worlds for one in published.values()]),
        tuple(planner for planner, one in published.items() for _ in one.worlds),
        np.concatenate([one.normalised_s_per_m for one in published.values()]),
        ~np.concatenate([one.failed for one in published.values()]),
    )
    return _common(worlds.items(), trials)


def _common(worlds: Iterable[tuple[int, World]], trials: Trials) -> tuple[dict[int, World], Trials]:
    """Return the worlds that every planner was tried in, ascending, and the trials there."""
    if not trials.world_numbers:
        raise ConfigError(f"no world has trials of all of {', '.join(trials.planner_names)}")
    known = dict(worlds)
    return {number: known[number] for number in trials.world_numbers}, trials.only(trials.world_numbers)


def _read_table(path: Path) -> pa.Table:
    try:
        content = read_at_most(path, _LARGEST_TABLE_BYTES)
    except OSError as error:
        raise ConfigError(f"{path}: {error.strerror or error}") from None
    try:
        if path.suffix == ".parquet":
            return _parquet(content, path)
        return pyarrow.csv.read_csv(
            pa.BufferReader(content),
            convert_options=pyarrow.csv.ConvertOptions(column_types=_COLUMNS | {_FAULT: pa.string()}),
        )
    except (pa.ArrowException, ValueError, OSError, KeyError) as error:
        raise ConfigError(f"{path}: cannot be read: {one_line(error)}") from None


def _parquet(content: bytes, path: Path) -> pa.Table:
    """Return what is needed of a Parquet file; a few bytes of it can stand for any number of rows."""
    file = pyarrow.parquet.ParquetFile(pa.BufferReader(content))
    if file.metadata.num_rows > _MOST_ROWS:
        raise ConfigError(f"{path}: must have at most {_MOST_ROWS} rows, has {file.metadata.num_rows}")
    return file.read([name for name in (*_COLUMNS, _FAULT) if name in file.schema_arrow.names])


def _campaign_rows(table: pa.Table, path: Path) -> list[dict[str, Any]]:
    """Return what is needed of the rows of a campaign's table; ConfigError for a table that does not hold it.

    Trials that did not fail by the planner's fault are left out.
    """
    needed = _COLUMNS if _FAULT not in table.column_names else _COLUMNS | {_FAULT: pa.string()}
    for name, kind in needed.items():
        if name not in table.column_names:
            raise ConfigError(f"{path}: no column {name!r}{suggest(name, table.column_names)}")
        column = table.column(name)
        if column.null_count or column.type != kind:
            got = f"{column.type}, {column.null_count} missing"
            raise ConfigError(f"{path}: column {name!r} must hold {kind} in every row, has {got}")
    rows = [row for row in table.select(list(needed)).to_pylist() if row.get(_FAULT) not in (SIMULATOR, ENVIRONMENT)]
    if not rows:
        raise ConfigError(f"{path}: has no rows of trials that count")
    return rows
