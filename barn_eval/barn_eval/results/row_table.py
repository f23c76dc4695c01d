"""Store rows as columns, so that a million rows take less than a gigabyte."""

import math
import typing
from collections.abc import Iterable, Iterator, Mapping, Sequence
from dataclasses import MISSING, dataclass, fields, is_dataclass
from enum import Enum
from functools import cache
from itertools import chain, islice
from typing import Any

import numpy as np
import pyarrow as pa
import pyarrow.json

from barn_eval.trials.result import READABLE_SCHEMAS, Outcome, Rows, TrialResult
from barn_worlds.base.arrays import Bools, Integers
from barn_worlds.base.config import as_dict

# Number of rows that are in memory as objects while a table is read or iterated over.
BATCH_ROWS = 1024

# Fields that rows of these schemas lack have defaults. Rows of schema 2 may need run.json.
_PLAIN_SCHEMAS = set(READABLE_SCHEMAS) - {2}

_ARROW_TYPES: dict[type, pa.DataType] = {
    bool: pa.bool_(),
    int: pa.int64(),
    float: pa.float64(),
    str: pa.string(),
}


@dataclass(frozen=True)
class RecordField:
    """A field of a row, or of a record in it."""

    name: str
    kind: Any
    """Type of its value, if it has one."""

    is_optional: bool
    """Whether None is allowed."""

    default: Any
    """Value if the file has none; MISSING if the file must have one."""

    @property
    def is_record(self) -> bool:
        """Whether the field is a record with fields."""
        return is_dataclass(self.kind)

    @property
    def arrow_type(self) -> pa.DataType:
        """Type of its column; a struct for a record."""
        if self.is_record:
            members = [
                (item.name, item.arrow_type) for item in record_fields(self.kind)
            ]
            return pa.struct(members)
        return _ARROW_TYPES[str if issubclass(self.kind, Enum) else self.kind]


@cache
def record_fields(record: Any) -> list[RecordField]:
    """Return a description of each field of a dataclass, in their order."""
    hints = typing.get_type_hints(record)
    record_items = []
    for item in fields(record):
        hint = hints[item.name]
        # For an optional field, the type of its value.
        kinds = [kind for kind in typing.get_args(hint) if kind is not type(None)]
        kind = kinds[0] if kinds else hint
        record_items.append(RecordField(item.name, kind, bool(kinds), item.default))
    return record_items


_SCHEMA = pa.schema(
    [(item.name, item.arrow_type) for item in record_fields(TrialResult)]
)


class RowTable(Sequence[TrialResult]):
    """Rows stored as columns; a row object is made when it is accessed."""

    __hash__ = None  # type: ignore[assignment]  # as of a list

    def __init__(self, table: pa.Table, positions: Integers | None = None) -> None:
        """Refer to the table's rows at `positions`, all if None; nothing is copied.

        Args:
            table: Columns by dotted name, such as "scores.success".
            positions: Indices (n,) of the rows in the table. By default, all.
        """
        self._table = table
        if positions is None:
            positions = np.arange(table.num_rows)
        self._positions = positions

    @classmethod
    def of(cls, rows: Iterable[TrialResult]) -> "RowTable":
        """Return a table of rows; only a batch of row objects is in memory at a time."""
        iterator = iter(rows)
        tables = []
        while batch := list(map(as_dict, islice(iterator, BATCH_ROWS))):
            tables.append(cls(_flatten(pa.Table.from_pylist(batch, _SCHEMA))))
        return cls.join(tables)

    @classmethod
    def join(cls, tables: Sequence["RowTable"]) -> "RowTable":
        """Return the rows of several tables, one after the other."""
        parts = {id(rows._table): rows._table for rows in tables}
        # Rows of one table are not copied.
        if len(parts) == 1:
            positions = np.concatenate([rows._positions for rows in tables])
            return cls(tables[0]._table, positions)
        copies = [rows._select(rows._positions) for rows in tables]
        copies = copies or [_flatten(_SCHEMA.empty_table())]
        return cls(pa.concat_tables(copies).unify_dictionaries())

    def __len__(self) -> int:
        """Return the number of rows."""
        return len(self._positions)

    def __getitem__(self, index: Any) -> Any:
        """Return the row at an index, or the rows of a slice as a table."""
        positions = self._positions[index]
        if isinstance(index, slice):
            return RowTable(self._table, positions)
        return _make_rows(self._table.slice(positions, 1))[0]

    def __iter__(self) -> Iterator[TrialResult]:
        """Yield the rows as objects, made in batches."""
        for start in range(0, len(self), BATCH_ROWS):
            yield from _make_rows(
                self._select(self._positions[start : start + BATCH_ROWS])
            )

    def __eq__(self, other: object) -> bool:
        """Tell whether another sequence has equal rows."""
        return isinstance(other, Sequence) and list(self) == list(other)

    def _select(self, positions: Integers) -> pa.Table:
        """Return a copy of the table's rows at these indices."""
        buffers = [None, pa.py_buffer(positions.astype(np.int64))]
        return self._table.take(
            pa.Array.from_buffers(pa.int64(), len(positions), buffers)
        )

    def take(self, positions: Integers | Bools) -> "RowTable":
        """Return the rows at these indices, or where a mask is true, in that order."""
        return RowTable(self._table, self._positions[positions])

    def has(self, path: str) -> bool:
        """Tell whether the table has a column with this dotted name."""
        return path in self._table.column_names

    def column(self, path: str) -> Any:
        """Return a column as an array (n,), NaN or None for missing values."""
        return _as_array(self._table[path])[self._positions]


def column(rows: Rows, path: str) -> Any:
    """Return a field of each row as an array (n,), NaN or None for missing values.

    Args:
        rows: Any rows. A table returns its column without making row objects.
        path: Dotted name of a field or property, such as "scores.success". Two are
            computed: "path_ratio", length driven over that of the world's path, and
            "waited_s", simulated time before the clock started, all if it never did.
    """
    if path == "path_ratio":
        return column(rows, "measures.driven_m") / column(rows, "scores.path_length_m")
    if path == "waited_s":
        clock_times_s = column(rows, "scores.traversal_time_s")
        return column(rows, "scores.duration_s") - np.nan_to_num(clock_times_s)
    if isinstance(rows, RowTable) and rows.has(path):
        return rows.column(path)
    values = []
    for row in rows:
        value: Any = row
        # Only trials among moving obstacles have `motion`.
        for name in path.split("."):
            value = getattr(value, name, None)
        if isinstance(value, Enum):
            value = value.value
        values.append(math.nan if value is None else value)
    return np.array(values)


def row_keys(rows: Rows, paths: Iterable[str]) -> Iterator[tuple[Any, ...]]:
    """Return an iterator over each row's values of these dotted fields, as a tuple."""
    return zip(*(column(rows, path).tolist() for path in paths), strict=True)


def take(rows: Rows, positions: Integers | Bools) -> Rows:
    """Return the rows at these indices, or where a mask is true, in that order."""
    if isinstance(rows, RowTable):
        return rows.take(positions)
    return [rows[k] for k in np.arange(len(rows))[positions].tolist()]


def join(parts: Sequence[Rows]) -> Rows:
    """Return the rows of all parts: a table if all are tables, else a tuple."""
    if all(isinstance(part, RowTable) for part in parts):
        return RowTable.join(typing.cast("Sequence[RowTable]", parts))
    return tuple(chain.from_iterable(parts))


def has_motion(rows: Rows) -> Bools:
    """Return a mask (n,): whether each row's trial was among moving obstacles."""
    is_moving: Bools = ~np.isnan(column(rows, "motion.phase_s"))
    return is_moving


def systems(rows: Rows) -> list[str]:
    """Return the sorted names of systems in which trials were observed."""
    names = set(column(rows, "observed.system").tolist())
    return sorted(name for name in names if isinstance(name, str))


def parse_rows(lines: Sequence[str]) -> RowTable | None:
    """Return the rows in lines without checksums, or None if one is unusual or invalid.

    The caller must then parse line by line, because a line may have the oldest schema or
    must be refused.
    """
    text = "\n".join(lines)
    # A line that begins like this is one object, because no nested object has this key.
    # Arrow reads all of Unicode as Python does, except lone surrogates.
    begins = all(line.startswith('{"trial_id":') for line in lines)
    if not begins or "\\ud" in text.lower():
        return None
    data = text.encode()
    try:
        table = pa.json.read_json(
            pa.BufferReader(data),
            pa.json.ReadOptions(use_threads=False, block_size=len(data) + 1),
            pa.json.ParseOptions(_SCHEMA, unexpected_field_behavior="error"),
        )
    except pa.ArrowException:
        return None
    records = table.combine_chunks().to_struct_array().combine_chunks()
    is_whole = len(records) == len(lines) and _has_all(records, TrialResult, text)
    outcomes = set(table["outcome"].unique().to_pylist())
    schemas = set(table["schema_version"].unique().to_pylist())
    is_known = outcomes <= set(Outcome) and schemas <= _PLAIN_SCHEMAS
    if is_whole and is_known:
        return RowTable(_flatten(table))
    return None


def _has_all(records: pa.StructArray, kind: Any, text: str) -> bool:
    """Tell whether records have all required fields, and all numbers are finite.

    Args:
        records: Array of structs, none of them null.
        kind: Their dataclass.
        text: The JSON that they are read from.
    """
    for item in record_fields(kind):
        values = records.field(item.name)
        if item.kind is float:
            numbers = np.from_dlpack(values.drop_null())
            # NaN and infinity are not below it, either.
            if not (np.abs(numbers) < 2.0**63).all():
                return False
        if values.null_count and not _may_be_null(item, values.null_count, text):
            return False
        if item.is_record and not _has_all(values.drop_null(), item.kind, text):
            return False
    return True


def _as_array(values: pa.ChunkedArray) -> Any:
    """Return a column as an array (n,); missing numbers are NaN, missing texts None."""
    # `to_numpy` would import pandas, which takes half a second and 50 MB.
    if pa.types.is_dictionary(values.type):
        array = values.combine_chunks()
        texts = np.array([*array.dictionary.to_pylist(), None], np.object_)
        codes = _as_array(pa.chunked_array([array.indices]))
        return texts[np.nan_to_num(codes, nan=-1.0).astype(np.int64)]
    if pa.types.is_string(values.type):
        return np.array(values.to_pylist(), np.object_)
    if pa.types.is_boolean(values.type):
        return _as_array(values.cast(pa.int8())) == 1
    if not values.null_count:
        return np.from_dlpack(values.combine_chunks())
    numbers = np.full(len(values), math.nan)
    numbers[_as_array(values.is_valid())] = _as_array(values.drop_null())
    return numbers


def _may_be_null(item: RecordField, nulls: int, text: str) -> bool:
    """Tell whether a field may have `nulls` nulls, which are written or missing in text."""
    if item.is_optional:
        is_written = text.count(f'"{item.name}":null') == nulls
        return is_written or item.default is not MISSING
    # A missing field gets its default, but a written null is refused.
    return item.default is not MISSING and f'"{item.name}"' not in text


def _flatten(table: pa.Table) -> pa.Table:
    """Return a table with dotted columns instead of structs, and texts as dictionaries.

    Most texts are the same in many rows.
    """
    while any(map(pa.types.is_struct, table.schema.types)):
        table = table.flatten()
    columns = []
    for name, values in zip(table.column_names, table.columns, strict=True):
        is_repeated = pa.types.is_string(values.type) and name != "trial_id"
        columns.append(values.dictionary_encode() if is_repeated else values)
    return pa.Table.from_arrays(columns, table.column_names)


def _make_rows(table: pa.Table) -> list[TrialResult]:
    """Return the rows of a table with dotted columns as objects."""
    return _make_records(TrialResult, table.to_pydict(), "")


def _make_records(
    kind: Any, columns: Mapping[str, list[Any]], prefix: str
) -> list[Any]:
    """Return a record per row, None for rows in which its first field has no value.

    Args:
        kind: Dataclass of the records.
        columns: Values by dotted name.
        prefix: Beginning of the dotted names of its fields.
    """
    arguments = []
    for item in record_fields(kind):
        path = prefix + item.name
        if item.is_record:
            values = _make_records(item.kind, columns, f"{path}.")
        else:
            values = columns[path]
        if issubclass(item.kind, Enum):
            values = list(map(item.kind, values))
        elif not item.is_optional and item.default is not MISSING:
            values = [item.default if value is None else value for value in values]
        arguments.append(values)
    # The first field is required, so only a missing record lacks it.
    return [
        None if values[0] is None else kind(*values)
        for values in zip(*arguments, strict=True)
    ]
