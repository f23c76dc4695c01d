"""Columns of numbers out of an MCAP file without decoding its messages one by one.

A bag of a trial has ten thousand messages, of which a report wants a few numbers of some hundred. The file's index
says where they are; messages of equal length have equal layout, so their fields are taken out all at once.
"""

from __future__ import annotations

import struct
from collections.abc import Mapping, Sequence
from io import BytesIO
from pathlib import Path

import numpy as np
import numpy.typing as npt
from mcap.data_stream import ReadDataStream
from mcap.exceptions import McapError
from mcap.reader import SeekingReader
from mcap.records import Chunk, ChunkIndex
from mcap.stream_reader import get_chunk_data_stream
from zstandard import ZstdError

from barn_eval.bags.bagfile import LARGEST_RECORD
from barn_eval.bags.messages import deserialise, layout
from barn_worlds.types import NANOSECONDS

Bytes = npt.NDArray[np.uint8]
Floats = npt.NDArray[np.float64]
_RECORD_HEAD = 9  # opcode and length in front of every record
_MESSAGE_HEAD = _RECORD_HEAD + 22  # and channel, sequence and two times in front of a message's data
_INDEX_HEAD = _RECORD_HEAD + 6
_LITTLE_ENDIAN = b"\x00\x01"
_DAMAGE = (McapError, ZstdError, struct.error, ValueError, KeyError, IndexError, RuntimeError, OverflowError, OSError)


class NoColumnsError(Exception):
    """The file has no index, or messages of one topic are not alike; it has to be read message by message."""


def read_columns(path: Path, wanted: Mapping[str, Sequence[str]]) -> dict[str, Floats]:
    """Return for each topic the time of the log (s) and the fields asked for, (n, 1 + fields), by time.

    wanted: dotted names of fields by topic. A topic that is not there has no rows. Raises NoColumnsError.
    """
    try:
        if path.stat().st_size > LARGEST_RECORD:
            raise NoColumnsError(f"{path}: too large to be read at once")
        return _read(path.read_bytes(), wanted)
    except _DAMAGE as error:
        raise NoColumnsError(f"{path}: {error}") from None


def _read(whole: bytes, wanted: Mapping[str, Sequence[str]]) -> dict[str, Floats]:
    summary = SeekingReader(BytesIO(whole), record_size_limit=LARGEST_RECORD).get_summary()
    if summary is None or not summary.chunk_indexes:
        raise NoColumnsError("no index")
    channels = {channel.id: channel for channel in summary.channels.values() if channel.topic in wanted}
    if len({channel.topic for channel in channels.values()}) < len(channels):
        raise NoColumnsError("a topic has several channels")
    if sum(index.uncompressed_size for index in summary.chunk_indexes) > LARGEST_RECORD:
        raise NoColumnsError("too large to be unpacked at once")
    chunks: list[bytes] = []
    entries: dict[int, list[npt.NDArray[np.uint64]]] = {identity: [] for identity in channels}
    begin = 0
    for index in sorted(summary.chunk_indexes, key=lambda one: one.chunk_start_offset):
        here = [identity for identity in channels if identity in index.message_index_offsets]
        if here:
            chunks.append(_chunk(whole, index))
            for identity in here:
                entries[identity].append(_entries(whole, index.message_index_offsets[identity], begin))
            begin += len(chunks[-1])
    data = np.frombuffer(b"".join(chunks), np.uint8)
    columns = {topic: np.empty((0, 1 + len(fields))) for topic, fields in wanted.items()}
    for identity, channel in channels.items():
        if entries[identity]:
            found = np.concatenate(entries[identity])
            type_name = summary.schemas[channel.schema_id].name
            columns[channel.topic] = _columns(data, found, type_name, wanted[channel.topic])
    return columns


def _chunk(whole: bytes, index: ChunkIndex) -> bytes:
    """Return the bytes of a chunk, unpacked."""
    at = index.chunk_start_offset + _RECORD_HEAD
    chunk = Chunk.read(ReadDataStream(BytesIO(whole[at : index.chunk_start_offset + index.chunk_length])))
    if chunk.uncompressed_size > LARGEST_RECORD:
        raise NoColumnsError("a chunk is too large")
    inner, size = get_chunk_data_stream(chunk, validate_crc=True)
    return inner.read(size)


def _entries(whole: bytes, at: int, begin: int) -> npt.NDArray[np.uint64]:
    """Return time and offset of the messages that an index lists, (n, 2), the chunk beginning at `begin`."""
    (size,) = struct.unpack_from("<I", whole, at + _RECORD_HEAD + 2)
    pairs: npt.NDArray[np.uint64] = np.frombuffer(whole, "<u8", size // 8, at + _INDEX_HEAD).reshape(-1, 2).copy()
    pairs[:, 1] += np.uint64(begin)
    return pairs


def _columns(data: Bytes, entries: npt.NDArray[np.uint64], type_name: str, fields: Sequence[str]) -> Floats:
    """Return time and fields of the messages at these places, by time."""
    at, size = _messages(data, entries[:, 1].astype(np.int64))
    slots = layout(deserialise(data[at[0] : at[0] + size].tobytes(), type_name))
    times = entries[:, 0].astype(np.float64) / NANOSECONDS
    columns = np.column_stack([times, *(_field(data, at, *slots[name]) for name in fields)])
    ordered: Floats = columns[np.argsort(times, kind="stable")]
    return ordered


def _messages(data: Bytes, records: npt.NDArray[np.int64]) -> tuple[npt.NDArray[np.int64], int]:
    """Return where in the chunks the data of these message records begin, and their one length in bytes."""
    heads = data[records[:, None] + np.arange(1, _RECORD_HEAD)]
    lengths = np.ascontiguousarray(heads).view("<u8")[:, 0]
    size = int(lengths[0]) - (_MESSAGE_HEAD - _RECORD_HEAD)
    at = records + _MESSAGE_HEAD
    if (lengths != lengths[0]).any() or not 4 <= size <= len(data) - int(at.max()):
        raise NoColumnsError("messages differ in length")
    if (data[at[:, None] + np.arange(2)] != np.frombuffer(_LITTLE_ENDIAN, np.uint8)).any():
        raise NoColumnsError("messages are not little-endian CDR")
    return at, size


def _field(data: Bytes, at: npt.NDArray[np.int64], offset: int, form: str) -> Floats:
    """Return a number out of each message."""
    raw = data[at[:, None] + (offset + np.arange(struct.calcsize("<" + form)))]
    column: Floats = raw.view(np.dtype("<" + form.replace("?", "B")))[:, 0].astype(np.float64)
    return column
