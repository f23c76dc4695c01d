"""Rows and tracks of trials, which survive a kill at any moment, and the tables made of them at the end."""

import io
import os
import re
import typing
import zlib
from collections.abc import Iterator, Sequence
from enum import Enum
from io import FileIO
from pathlib import Path
from typing import Any

import pyarrow as pa
import pyarrow.csv
import pyarrow.parquet

from barn_eval.trials.encounters import Encounters
from barn_eval.trials.outcome import Scores
from barn_eval.trials.result import (
    Rows,
    TrialResult,
    WallClock,
    from_json_line,
    to_json_line,
)
from barn_eval.trials.trajectory import Measures
from barn_worlds.base.config import as_dict
from barn_worlds.base.errors import ConfigError, StoreError, convert_os_errors
from barn_worlds.base.files import write_durably
from barn_worlds.base.text_files import parse_json, read_lines

ROWS_FILE = "results.jsonl"
TRACKS_FILE = "tracks.jsonl"
RESULTS, TIMING = "results", "timing"  # tables, which `tables` writes
TABLE_FILES = tuple(
    f"{name}.{ending}" for name in (RESULTS, TIMING) for ending in ("parquet", "csv")
)
_SEAL = re.compile(r',\s*"crc32":\s*"([0-9a-f]{8})"\}$')


class RowFile:
    """The rows of one folder, in the order in which the trials ended; one process writes at a time."""

    def __init__(self, folder: Path) -> None:
        self.path = folder / ROWS_FILE

    def append(self, result: TrialResult) -> None:
        """Add a row and see it onto the disk; StoreError, with the rows as they were, if that fails."""
        _append_line(self.path, to_json_line(result))

    def replace(self, results: Rows) -> None:
        """Keep these rows and no others; StoreError, with the rows as they were, if that fails."""
        write_durably(
            self.path,
            "".join(
                f"{seal_line(to_json_line(result))}\n" for result in results
            ).encode(),
        )

    def read(self) -> list[TrialResult]:
        """Return the rows without a last line that a kill cut off; the file is left as it is."""
        rows: dict[str, TrialResult] = {}
        for where, line in _whole_lines(self.path):
            row = from_json_line(line, where)
            if row.trial_id in rows:
                raise ConfigError(f"{where}: trial {row.trial_id} is there already")
            rows[row.trial_id] = row
        return list(rows.values())


class TrackFile:
    """The tracks of one folder; a trial that a kill left without a row is run again, and its last track counts."""

    def __init__(self, folder: Path) -> None:
        self.path = folder / TRACKS_FILE

    def append(self, line: str) -> None:
        """Add the line of a track and see it onto the disk; StoreError, with the lines as they were, if that fails."""
        _append_line(self.path, line)

    def read(self) -> dict[str, str]:
        """Return the lines by the name of their trial, without one that a kill cut off; empty without a file."""
        return {_trial_of(line, where): line for where, line in _whole_lines(self.path)}

    def arrange(self, order: Sequence[str]) -> None:
        """Bring the lines into an order of trials, one of each, so that the file no longer tells who ended when."""
        tracks = self.read()
        after = [
            seal_line(tracks[trial_id]) for trial_id in order if trial_id in tracks
        ]
        if after != [line for _, line in read_lines(self.path)]:
            write_durably(self.path, "".join(f"{line}\n" for line in after).encode())


def _append_line(path: Path, line: str) -> None:
    """Add a sealed line to a file and see it onto the disk; StoreError, with whole lines as they were, if not."""
    with (
        convert_os_errors(StoreError, f"{path}: cannot be written"),
        path.open("a+b", buffering=0) as file,
    ):
        whole = _drop_torn_line(file)
        try:
            data = memoryview(f"{seal_line(line)}\n".encode())
            while data:
                data = data[file.write(data) :]
            os.fsync(file.fileno())
        except OSError:
            file.truncate(whole)
            raise


def _whole_lines(path: Path) -> Iterator[tuple[str, str]]:
    return ((where, unseal_line(line, where)) for where, line in read_lines(path))


def seal_line(line: str) -> str:
    """Return a line of a JSON object with its checksum as the last key."""
    return f'{line[:-1]},"crc32":"{zlib.crc32(line.encode()):08x}"}}'


def unseal_line(line: str, where: str) -> str:
    """Return a line without its checksum; ConfigError, beginning with `where`, if that is missing or wrong."""
    seal = _SEAL.search(line)
    if seal is None:
        raise ConfigError(f"{where}: damaged or edited: has no crc32 at its end")
    content = line[: seal.start()] + "}"
    found = f"{zlib.crc32(content.encode()):08x}"
    if found != seal[1]:
        raise ConfigError(
            f"{where}: damaged or edited: its crc32 is {seal[1]}, that of its content {found}"
        )
    return content


def _trial_of(line: str, where: str) -> str:
    content = parse_json(line, where)
    trial_id = content.get("trial_id") if isinstance(content, dict) else None
    if not isinstance(trial_id, str):
        raise ConfigError(f"{where}: not the track of a trial")
    return trial_id


def _drop_torn_line(file: FileIO) -> int:
    """Cut the file back to its last whole line and return its size."""
    size = file.seek(0, os.SEEK_END)
    file.seek(max(size - 1, 0))
    if size == 0 or file.read(1) == b"\n":
        return size
    file.seek(0)
    whole = file.read().rfind(b"\n") + 1
    file.truncate(whole)
    return whole


_APART = ("wall_clock", "motion", "delays")  # not among the columns of every table
_COLUMNS: dict[type, pa.DataType] = {
    bool: pa.bool_(),
    int: pa.int64(),
    float: pa.float64(),
    str: pa.string(),
}


def results_table(results: Rows) -> pa.Table:
    """Return a row per result, in the order given, without wall-clock figures."""
    moving = any(result.motion is not None for result in results)
    schema = pa.schema(
        [*_columns(TrialResult), *(_columns(Encounters) if moving else ())]
    )
    return pa.Table.from_pylist(
        [_flat(result.repeatable()) for result in results], schema
    )


def timing_table(results: Rows) -> pa.Table:
    """Return a row per result with its trial and the fields of `WallClock`."""
    schema = pa.schema([("trial_id", pa.string()), *_columns(WallClock)])
    rows = [
        {"trial_id": result.trial_id} | as_dict(result.wall_clock) for result in results
    ]
    return pa.Table.from_pylist(rows, schema)


def write_tables(folder: Path, results: Rows) -> None:
    """Write both tables, each as Parquet and CSV; StoreError, with the earlier files in place, if one cannot be."""
    for name, table in (
        (RESULTS, results_table(results)),
        (TIMING, timing_table(results)),
    ):
        buffer = io.BytesIO()
        pyarrow.parquet.write_table(table, buffer, compression="zstd")
        write_durably(folder / f"{name}.parquet", buffer.getvalue())
        write_durably(folder / f"{name}.csv", csv_bytes(table))


def csv_bytes(table: pa.Table) -> bytes:
    """Return a table as CSV, its header first."""
    buffer = io.BytesIO()
    pyarrow.csv.write_csv(table, buffer)
    return buffer.getvalue()


def _columns(record: type[Any]) -> Iterator[tuple[str, pa.DataType]]:
    for name, kind in typing.get_type_hints(record).items():
        if name in _APART:
            continue
        plain = next(
            (one for one in typing.get_args(kind) if one is not type(None)), kind
        )  # of an optional one
        if issubclass(plain, (Scores, Measures)):
            yield from _columns(plain)
        else:
            yield name, pa.string() if issubclass(plain, Enum) else _COLUMNS[plain]


def _flat(row: dict[str, Any]) -> dict[str, Any]:
    flat: dict[str, Any] = {}
    for name, value in row.items():
        flat |= value if isinstance(value, dict) else {name: value}
    return flat
