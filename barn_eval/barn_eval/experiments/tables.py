"""The tables of an experiment: what repeats to the last bit in one, wall-clock figures in another."""

import dataclasses
import io
import types
import typing
from collections.abc import Iterator, Sequence
from enum import Enum
from pathlib import Path
from typing import Any

import pyarrow as pa
import pyarrow.csv
import pyarrow.parquet

from barn_eval.experiments.rows import RESULTS, TIMING
from barn_eval.trials.encounters import Encounters
from barn_eval.trials.result import TrialResult, WallClock
from barn_eval.trials.scores import Scores
from barn_eval.trials.trajectory import Measures
from barn_worlds.base.config import as_dict
from barn_worlds.base.files import write_whole

_APART = ("wall_clock", "motion")  # not among the columns of every table
_COLUMNS: dict[type, pa.DataType] = {bool: pa.bool_(), int: pa.int64(), float: pa.float64(), str: pa.string()}


def results_table(results: Sequence[TrialResult]) -> pa.Table:
    """Return a row per result, in the order given, without wall-clock figures.

    Columns are the fields of `TrialResult` and, in place of its parts, those of `Scores` and `Measures`, and of
    `Encounters` where any result has them.
    """
    moving = any(result.motion is not None for result in results)
    schema = pa.schema([*_columns(TrialResult), *(_columns(Encounters) if moving else ())])
    return pa.Table.from_pylist([_flat(result.repeatable()) for result in results], schema)


def timing_table(results: Sequence[TrialResult]) -> pa.Table:
    """Return a row per result with its trial and the fields of `WallClock`."""
    schema = pa.schema([("trial_id", pa.string()), *_columns(WallClock)])
    return pa.Table.from_pylist(
        [{"trial_id": result.trial_id} | as_dict(result.wall_clock) for result in results], schema
    )


def write_tables(folder: Path, results: Sequence[TrialResult]) -> None:
    """Write both tables, each as Parquet and CSV; StoreError, with the earlier files in place, if one cannot be."""
    for name, table in ((RESULTS, results_table(results)), (TIMING, timing_table(results))):
        write_whole(folder / f"{name}.parquet", _parquet(table))
        write_whole(folder / f"{name}.csv", csv_bytes(table))


def _parquet(table: pa.Table) -> bytes:
    buffer = io.BytesIO()
    pyarrow.parquet.write_table(table, buffer, compression="zstd")
    return buffer.getvalue()


def csv_bytes(table: pa.Table) -> bytes:
    """Return a table as CSV, its header first."""
    buffer = io.BytesIO()
    pyarrow.csv.write_csv(table, buffer)
    return buffer.getvalue()


def _columns(record: type[Any]) -> Iterator[tuple[str, pa.DataType]]:
    kinds = typing.get_type_hints(record)
    for field in dataclasses.fields(record):
        kind = _plain(kinds[field.name])
        if field.name in _APART:
            continue
        if issubclass(kind, (Scores, Measures)):
            yield from _columns(kind)
        else:
            yield field.name, pa.string() if issubclass(kind, Enum) else _COLUMNS[kind]


def _plain(kind: object) -> Any:
    if typing.get_origin(kind) in (typing.Union, types.UnionType):
        (kind,) = (one for one in typing.get_args(kind) if one is not type(None))
    return kind


def _flat(row: dict[str, Any]) -> dict[str, Any]:
    flat: dict[str, Any] = {}
    for name, value in row.items():
        flat |= value if isinstance(value, dict) else {name: value}
    return flat
