"""Read and write rows, tracks and commands, safe against a kill; write result tables."""

import io
import os
import re
import weakref
import zlib
from collections.abc import Iterable, Iterator, Mapping, Set
from contextlib import suppress
from functools import cached_property
from itertools import islice
from pathlib import Path
from typing import Any

import pyarrow as pa
import pyarrow.csv
import pyarrow.parquet

from barn_eval.results.row_table import (
    BATCH_ROWS,
    RowTable,
    column,
    has_motion,
    parse_rows,
    record_fields,
    systems,
)
from barn_eval.results.run_file import RunFile
from barn_eval.results.tracks import parse_trial_line
from barn_eval.trials.encounters import Encounters
from barn_eval.trials.result import (
    Rows,
    TrialResult,
    WallClock,
    row_from_plain,
    to_json_line,
)
from barn_eval.trials.system import ObservedTrial
from barn_worlds.base.config import as_dict
from barn_worlds.base.errors import ConfigError, StoreError, convert_os_errors
from barn_worlds.base.files import (
    as_mapping,
    open_regular,
    parse_json,
    read_lines,
    write_durably,
    write_parts_durably,
)

ROWS_FILE = "results.jsonl"
TRACKS_FILE = "tracks.jsonl"
COMMANDS_FILE = "commands.jsonl"

# Tables, each as Parquet and CSV.
RESULTS = "results"
TIMING = "timing"
TABLE_FILES = tuple(
    f"{name}.{ending}" for name in (RESULTS, TIMING) for ending in ("parquet", "csv")
)

# The checksum is the last key of a line.
_SEAL = re.compile(r',\s*"crc32":\s*"([0-9a-f]{8})"\}$')
_LONGEST_SEAL = 64
# The trial's name is the first key of a line.
_NAME = re.compile(r'\{"trial_id":"([^"\\]+)",')


class RowFile:
    """The rows of one folder, in the order in which trials ended. It has one writer."""

    def __init__(self, folder: Path):
        """Use results.jsonl in a run's folder, which need not exist yet."""
        self.path = folder / ROWS_FILE

    def append(self, result: TrialResult) -> None:
        """Append a row to results.jsonl and sync it; StoreError keeps earlier rows.

        Raises:
            StoreError: If this fails; the earlier rows are kept.
        """
        append_line(self.path, to_json_line(result))

    def replace(self, results: Rows) -> None:
        """Rewrite results.jsonl atomically with only these rows; errors as in `append`."""
        lines = (f"{seal_line(to_json_line(row))}\n".encode() for row in results)
        write_parts_durably(self.path, lines)

    def read(self) -> RowTable:
        """Return all rows in file order, none without a file; ConfigError if damaged.

        A last line that a kill cut off is left out.

        Raises:
            ConfigError: If a line is damaged, or a trial has two rows.
        """
        parser = RowParser(self.path.parent)
        trial_ids: set[str] = set()
        tables = []
        lines = read_lines(self.path)
        while batch := list(islice(lines, BATCH_ROWS)):
            places = [where for where, _ in batch]
            texts = [unseal_line(line, where) for where, line in batch]
            rows = parse_rows(texts)
            if rows is None:
                rows = RowTable.of(map(parser.parse, texts, places))
            for where, trial_id in zip(places, rows.column("trial_id"), strict=True):
                if trial_id in trial_ids:
                    raise ConfigError(f"{where}: trial {trial_id} is listed twice")
                trial_ids.add(trial_id)
            tables.append(rows)
        return RowTable.join(tables)


class RowParser:
    """Parses rows of one folder, which an earlier version may have written."""

    def __init__(self, folder: Path):
        """Use a run's folder, whose run.json has values that old rows lack."""
        self._folder = folder

    @cached_property
    def _failure_time_s(self) -> float:
        """The longest time [s] that a failure counts, by the protocol in run.json."""
        protocol = RunFile.read(self._folder).run_config().protocol
        return protocol.longest_failure_time_s

    @cached_property
    def _origin_note(self) -> str:
        """The commits that wrote the folder, empty if run.json cannot be read."""
        try:
            return RunFile.read(self._folder).origin_note()
        except ConfigError:
            return ""

    def parse(self, line: str, where: str) -> TrialResult:
        """Return the row in a line, of any readable schema; ConfigError if it has none.

        Args:
            line: The line without its checksum.
            where: File and line, for messages.

        Raises:
            ConfigError: If the line is not a row that this version can read.
        """
        content = parse_json(line, where)
        scores = as_mapping(content).get("scores")
        # The first rows of schema 2 lack this time.
        if (
            isinstance(scores, dict)
            and content.get("schema_version") == 2
            and "failure_time_s" not in scores
        ):
            scores["failure_time_s"] = self._failure_time_s
        try:
            return row_from_plain(content, where)
        except ConfigError as error:
            raise ConfigError(f"{error}{self._origin_note}") from None


class TrialLines(Mapping[str, str]):
    """The last line of each trial in a file of tracks or commands, not parsed.

    Only places in the file are kept in memory. A line is read when it is accessed.
    """

    def __init__(self, path: Path):
        """Find all lines, check their checksums; ConfigError if one is damaged.

        A torn last line is left out. Whoever reads a line must still parse it.

        Args:
            path: tracks.jsonl or commands.jsonl, which need not exist.

        Raises:
            ConfigError: If a line is damaged or names no trial.
        """
        self._path = path
        self._spans: dict[str, tuple[int, int]] = {}
        self._line_count = 0
        file = None
        with suppress(OSError):
            # The file stays open, so that places stay valid if it is replaced.
            file = open_regular(path)
            weakref.finalize(self, file.close)
            self._descriptor = file.fileno()
        what = "track" if path.name == TRACKS_FILE else "commands"
        start = 0
        for where, line in read_lines(path, file):
            # A trial may have several lines if a kill left it without a row.
            content = unseal_line(line, where)
            # Parsing whole lines would take ten times as long.
            name = _NAME.match(content)
            trial_id = name[1] if name else parse_trial_line(content, where, what)[0]
            size = len(line.encode()) + 1
            self._spans[trial_id] = (start, size)
            start += size
            self._line_count += 1

    def __getitem__(self, trial_id: str) -> str:
        """Return the line of a trial, with its checksum checked and removed."""
        line = self._read(trial_id)[:-1].decode()
        return unseal_line(line, f"{self._path}, {trial_id}")

    def __iter__(self) -> Iterator[str]:
        """Iterate over the names of trials."""
        return iter(self._spans)

    def __len__(self) -> int:
        """Return the number of trials."""
        return len(self._spans)

    def _read(self, trial_id: str) -> bytes:
        """Return the bytes of a trial's line as they are in the file."""
        start, size = self._spans[trial_id]
        # Not by seeking, because forks of this process share the file's position.
        return os.pread(self._descriptor, size, start)

    def arrange(self, trial_ids: Iterable[str]) -> None:
        """Rewrite the file with one line per trial in this order, unless it is so already.

        The last line of a trial counts; trials without one are skipped. The file then no
        longer shows in which order trials ended. Do not use this object afterwards.
        """
        names = [name for name in trial_ids if name in self._spans]
        if self._line_count > len(names) or names != list(self._spans):
            write_parts_durably(self._path, map(self._read, names))

    def drop_others(self, trial_ids: Set[str]) -> None:
        """Rewrite the file without trials that are not in `trial_ids`, if there are any."""
        if not self.keys() <= trial_ids:
            self.arrange([name for name in self if name in trial_ids])


def seal_line(line: str) -> str:
    """Return a line of a JSON object with its CRC-32 added as the last key, "crc32"."""
    # This detects damage. To detect forgery, `barn check` computes rows again.
    return f'{line[:-1]},"crc32":"{zlib.crc32(line.encode()):08x}"}}'


def unseal_line(line: str, where: str) -> str:
    """Return a line without its CRC-32; ConfigError if that is missing or wrong.

    Args:
        line: A line made by `seal_line`.
        where: File and line, for messages.

    Raises:
        ConfigError: If the checksum is missing or wrong.
    """
    # Only the end is searched, because a line may be long.
    seal = _SEAL.search(line, max(0, len(line) - _LONGEST_SEAL))
    if seal is None:
        raise ConfigError(f"{where}: damaged or edited: no crc32 at its end")
    content = line[: seal.start()] + "}"
    crc = f"{zlib.crc32(content.encode()):08x}"
    if crc != seal[1]:
        raise ConfigError(
            f"{where}: damaged or edited: its crc32 is {seal[1]}, but its content has"
            f" {crc}"
        )
    return content


def append_line(path: Path, line: str) -> None:
    """Append a line with checksum after the last whole one, synced; StoreError if not.

    Args:
        path: File of rows, tracks or commands, which has one writer.
        line: One line of JSON without a newline.

    Raises:
        StoreError: If this fails; the file keeps its complete lines.
    """
    with (
        convert_os_errors(StoreError, f"{path}: cannot be written"),
        # Without a buffer, data of a failed write are not written later.
        path.open("a+b", buffering=0) as file,
    ):
        # An incomplete line of a killed writer would spoil the next one.
        size = _drop_torn_line(file)
        try:
            data = memoryview(f"{seal_line(line)}\n".encode())
            while data:
                data = data[file.write(data) :]
            os.fsync(file.fileno())
        except OSError:
            file.truncate(size)
            raise


def _drop_torn_line(file: io.FileIO) -> int:
    """Cut a file off after its last newline and return its new size in bytes."""
    size = file.seek(0, os.SEEK_END)
    file.seek(max(size - 1, 0))
    if size == 0 or file.read(1) == b"\n":
        return size
    file.seek(0)
    size = file.read().rfind(b"\n") + 1
    file.truncate(size)
    return size


# Fields of a row that are not columns of the table of results.
_NO_COLUMNS = ("wall_clock", "motion", "observed", "delays")


def results_table(results: Rows) -> pa.Table:
    """Return an Arrow table of the rows in their order, without wall-clock figures."""
    columns = [*_columns(TrialResult), ("waited_s", pa.float64())]
    # Without moving obstacles, the columns are the same as in earlier versions.
    if has_motion(results).any():
        columns += _columns(Encounters)
        columns += [("hit_at_rest", pa.bool_()), ("not_at_fault", pa.bool_())]
    if systems(results):
        columns += _columns(ObservedTrial)

    contents = map(_row_content, results, column(results, "waited_s"))
    return _make_table(contents, pa.schema(columns))


def _row_content(result: TrialResult, waited_s: float) -> dict[str, Any]:
    """Return a row as a flat dict of columns, which may be more than a table has."""
    row: dict[str, Any] = {"waited_s": waited_s}
    for name, value in result.repeatable().items():
        row |= value if isinstance(value, dict) else {name: value}
    if result.motion is not None:
        row["hit_at_rest"] = result.motion.hit_at_rest
        row["not_at_fault"] = result.motion.not_at_fault
    return row


def _make_table(rows: Iterator[dict[str, Any]], schema: pa.Schema) -> pa.Table:
    """Return an Arrow table of rows; only a batch of rows is in memory at a time."""
    # With a schema, a column has its type even if no row has a value.
    parts = [schema.empty_table()]
    while batch := list(islice(rows, BATCH_ROWS)):
        parts.append(pa.Table.from_pylist(batch, schema))
    return pa.concat_tables(parts).combine_chunks()


def timing_table(results: Rows) -> pa.Table:
    """Return an Arrow table of the trials' names and wall-clock figures."""
    schema = pa.schema([("trial_id", pa.string()), *_columns(WallClock)])
    rows = (
        {"trial_id": result.trial_id} | as_dict(result.wall_clock) for result in results
    )
    return _make_table(rows, schema)


def write_tables(folder: Path, results: Rows) -> None:
    """Replace results and timing tables (.parquet and .csv); StoreError if one fails.

    Args:
        folder: The run's folder.
        results: Rows of the tables, in their order.

    Raises:
        StoreError: If a file cannot be written; its earlier version is kept.
    """
    tables = {RESULTS: results_table(results), TIMING: timing_table(results)}
    for name, table in tables.items():
        buffer = io.BytesIO()
        pyarrow.parquet.write_table(table, buffer, compression="zstd")
        write_durably(folder / f"{name}.parquet", buffer.getvalue())
        write_durably(folder / f"{name}.csv", csv_bytes(table))


def csv_bytes(table: pa.Table) -> bytes:
    """Return a table as the bytes of a CSV file with a header."""
    buffer = io.BytesIO()
    pyarrow.csv.write_csv(table, buffer)
    return buffer.getvalue()


def _columns(record: Any) -> Iterator[tuple[str, pa.DataType]]:
    """Yield (name, Arrow type) of a record's flattened fields, except `_NO_COLUMNS`."""
    for item in record_fields(record):
        if item.name in _NO_COLUMNS:
            continue
        if item.is_record:
            yield from _columns(item.kind)
        else:
            yield item.name, item.arrow_type
