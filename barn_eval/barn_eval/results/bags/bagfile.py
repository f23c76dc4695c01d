"""Reading of bags that others may have written, cut off or damaged: rosbag2 folders (MCAP, SQLite) and MCAP files."""

import re
import sqlite3
import struct
import zlib
from collections.abc import Collection, Iterator
from contextlib import closing, suppress
from dataclasses import dataclass, replace
from io import SEEK_CUR, BytesIO
from pathlib import Path
from typing import Any

import apsw  # with which rosbags reads SQLite
from lz4.frame import LZ4FrameDecompressor
from mcap.data_stream import ReadDataStream
from mcap.exceptions import EndOfFile, InvalidMagic, McapError
from mcap.opcode import Opcode
from mcap.records import Channel, Chunk, McapRecord, Message, Metadata, Schema
from rosbags.rosbag2 import Reader, ReaderError
from zstandard import ZstdDecompressor, ZstdError

from barn_eval.results.bags import BAGS
from barn_eval.results.bags.recorder import PARTIAL
from barn_worlds.base.errors import BagError, convert_os_errors, format_error
from barn_worlds.base.files import open_regular
from barn_worlds.base.types import NANOSECONDS_PER_SECOND

# Bytes; what a damaged or malicious file states must not decide how much memory and time are taken.
LARGEST_RECORD, SMALL_CHUNK, LARGEST_RATIO = 1 << 28, 1 << 22, 256
LARGEST_BAG, MESSAGE_BYTES = (
    1 << 29,
    256,
)  # of all messages; what each takes beside its data
_LATEST_NS = (1 << 63) - 1  # no ROS clock reads more
_MAGIC = b"\x89MCAP0\r\n"
_HEAD = struct.Struct("<BQ")  # of a record: its kind and length
_MESSAGE = struct.Struct(
    "<HIQQ"
)  # of a message: channel, number, time of the log and of publication
_KINDS: dict[int, Any] = {
    Opcode.SCHEMA: Schema,
    Opcode.CHANNEL: Channel,
    Opcode.METADATA: Metadata,
}
DAMAGE = (
    McapError,
    ZstdError,
    struct.error,
    ValueError,
    KeyError,
    IndexError,
    RuntimeError,
    OverflowError,
    TypeError,
)


@dataclass(frozen=True, slots=True)
class RawMessage:
    """A message as recorded: CDR with its header, and the time of the log."""

    topic: str
    type_name: str
    stamp_ns: int
    data: bytes


class BagFile:
    """A bag on disk. `problem` says, once `messages` has come to its end, why that was not the end of the bag."""

    def __init__(self, path: Path) -> None:
        """Find the files of a bag; BagError if there is none."""
        self.path = path
        self.metadata: dict[str, dict[str, str]] = {}
        self.problem = ""
        self._sqlite = False
        self._files = self._find(path)
        self._first_ns, self._last_ns = 0, -1

    def messages(self, topics: Collection[str] = ()) -> Iterator[RawMessage]:
        """Yield the messages of these topics, or of all, in the order of the file, as far as they can be read."""
        read = 0
        for message in self._all():
            read += len(message.data) + MESSAGE_BYTES
            if read > LARGEST_BAG:
                return self._note(
                    "read no further",
                    ValueError(f"it has more than {LARGEST_BAG} bytes of messages"),
                )
            if not 0 <= message.stamp_ns <= _LATEST_NS:
                return self._note(
                    "damaged",
                    ValueError(f"a message of the time {message.stamp_ns} ns"),
                )
            self._first_ns = message.stamp_ns if self._last_ns < 0 else self._first_ns
            self._last_ns = message.stamp_ns
            if not topics or message.topic in topics:
                yield message

    def _find(self, path: Path) -> list[Path]:
        if not path.exists():
            partial = path.with_name(path.name + PARTIAL)
            hint = (
                f"; an unfinished one is there: {partial}" if partial.exists() else ""
            )
            raise BagError(f"{path}: no such bag{hint}")
        if path.is_file() and path.suffix == ".db3":
            raise BagError(
                f"{path}: give the folder of the bag, which has its metadata.yaml"
            )
        files = [path] if path.is_file() else sorted(path.glob("*.mcap"), key=_part)
        self._sqlite = not files and any(path.glob("*.db3"))
        if not files and not self._sqlite:
            raise BagError(f"{path}: holds no bag (no .mcap or .db3 file)")
        return files or [path]

    def _all(self) -> Iterator[RawMessage]:
        for path in self._files:
            yield from (
                self._sqlite_messages() if self._sqlite else self._mcap_messages(path)
            )
            if self.problem:
                return

    def _sqlite_messages(self) -> Iterator[RawMessage]:
        try:
            for file in self.path.glob("*.db3"):
                _require_plain(file)
            with Reader(self.path) as reader:
                for connection, stamp_ns, data in reader.messages():
                    yield RawMessage(
                        connection.topic, connection.msgtype, stamp_ns, bytes(data)
                    )
        except (ReaderError, sqlite3.Error, apsw.Error, OSError, *DAMAGE) as error:
            if self._last_ns < 0:
                raise BagError(
                    f"{self.path}: not a bag that can be read: {format_error(error)}"
                ) from None
            self._note("damaged", error)

    def _mcap_messages(self, path: Path) -> Iterator[RawMessage]:
        try:
            with (
                convert_os_errors(BagError, path),
                closing(McapFile(path, self.metadata)) as file,
            ):
                yield from file.messages()
                if not file.ended:
                    raise EndOfFile
        except DAMAGE as error:
            what = "cut off" if isinstance(error, EndOfFile) else "damaged"
            if not file.began:
                other = (
                    ""
                    if isinstance(error, InvalidMagic)
                    else f", or {what} at its beginning"
                )
                raise BagError(f"{path}: not an MCAP file{other}") from None
            self._note(what, error)

    def _note(self, what: str, error: Exception) -> None:
        known = isinstance(error, EndOfFile) or not str(error)
        after = (
            0.0
            if self._last_ns < 0
            else (self._last_ns - self._first_ns) / NANOSECONDS_PER_SECOND
        )
        reason = "" if known else f" ({format_error(error)})"
        self.problem = f"the bag is {what} after {after:.2f} s{reason}"


class McapFile:
    """One MCAP file, read without its index, which a file that is cut off or still being written does not have."""

    def __init__(self, path: Path, metadata: dict[str, dict[str, str]]) -> None:
        self.path = path
        self.began = self.ended = False
        self._metadata = metadata
        self._file = open_regular(path)
        self._types: dict[int, str] = {}
        self._channels: dict[int, tuple[str, str]] = {}

    def close(self) -> None:
        """Close the file."""
        self._file.close()

    def messages(self) -> Iterator[RawMessage]:
        """Yield the messages of the records that have become whole since the last call; an error of `DAMAGE` else."""
        if self._file.tell() == 0 and (magic := self._next(len(_MAGIC))) != _MAGIC:
            if magic is None:
                return
            raise InvalidMagic(magic)
        while not self.ended and (head := self._next(_HEAD.size)) is not None:
            kind, size = _HEAD.unpack(head)
            if size > LARGEST_RECORD:
                raise ValueError(f"a record of {size} bytes")
            if (content := self._next(size)) is None:
                self._file.seek(-_HEAD.size, SEEK_CUR)
                return
            yield from self._record(kind, ReadDataStream(BytesIO(content)), size)
            self.began, self.ended = True, kind == Opcode.FOOTER

    def _next(self, size: int) -> bytes | None:
        """Return so many bytes, None where they are not all there."""
        data = self._file.read(size)
        if len(data) == size:
            return data
        self._file.seek(-len(data), SEEK_CUR)
        return None

    def _record(
        self, kind: int, content: ReadDataStream, size: int
    ) -> Iterator[RawMessage]:
        if kind == Opcode.CHUNK:
            yield from self._chunk(unpacked(Chunk.read(content)))
        elif kind == Opcode.MESSAGE:
            yield from self._take(Message.read(content, size))
        elif kind in _KINDS:
            yield from self._take(_KINDS[kind].read(content))

    def _chunk(self, chunk: Chunk) -> Iterator[RawMessage]:
        """Yield the messages of an unpacked chunk: thousands a second, for which mcap's own reader is too slow."""
        data, at = chunk.data, 0
        if chunk.uncompressed_crc and zlib.crc32(data) != chunk.uncompressed_crc:
            raise ValueError("a chunk that has not its checksum")
        while at < len(data):
            kind, size = _HEAD.unpack_from(data, at)
            at, start = at + _HEAD.size + size, at + _HEAD.size
            if at > len(data):
                raise EndOfFile
            if kind == Opcode.MESSAGE:
                channel, _, stamp_ns, _ = _MESSAGE.unpack_from(data, start)
                yield RawMessage(
                    *self._channels[channel], stamp_ns, data[start + _MESSAGE.size : at]
                )
            elif kind in _KINDS:
                yield from self._take(
                    _KINDS[kind].read(ReadDataStream(BytesIO(data[start:at])))
                )

    def _take(self, record: McapRecord) -> Iterator[RawMessage]:
        if isinstance(record, Message):
            yield RawMessage(
                *self._channels[record.channel_id], record.log_time, record.data
            )
        elif isinstance(record, Schema):
            self._types[record.id] = record.name
        elif isinstance(record, Channel):
            type_name = (
                self._types.get(record.schema_id, "")
                if record.message_encoding == "cdr"
                else ""
            )
            self._channels[record.id] = (
                record.metadata.get("known_as", record.topic),
                type_name,
            )
        elif isinstance(record, Metadata):
            self._metadata[record.name] = dict(record.metadata)


class TrialFollower:
    """The trial of a folder that is being recorded, and after it the next; of several at a time, one."""

    def __init__(self, folder: Path) -> None:
        self._bags = folder / BAGS
        self._current: McapFile | None = None
        self._done: set[Path] = set()

    def read(self) -> tuple[bool, list[RawMessage]]:
        """Return whether another trial has begun, and the messages that have come."""
        if (current := self._current) is not None:
            heard = self._heard(current)
            if heard or not (
                current.ended or self._newest() not in (None, current.path)
            ):
                return False, heard
            self.close()
        path = self._newest()
        if path is None:
            return False, []
        self._current = McapFile(path, {})
        return True, self._heard(self._current)

    def close(self) -> None:
        """Close the bag."""
        if self._current is not None:
            self._done.add(self._current.path)
            self._current.close()
            self._current = None

    def _heard(self, file: McapFile) -> list[RawMessage]:
        try:
            return list(file.messages())
        except DAMAGE as error:
            raise BagError(f"{file.path}: is damaged: {format_error(error)}") from None

    def _newest(self) -> Path | None:
        """Return the file that was written to last, of trials that are being recorded and were not followed yet."""
        written_ns: dict[Path, int] = {}
        for path in set(self._bags.glob(f"*{PARTIAL}/*.mcap")) - self._done:
            with suppress(OSError):  # it has just got its own name
                written_ns[path] = path.stat().st_mtime_ns
        return max(written_ns, key=written_ns.__getitem__, default=None)


def unpacked(chunk: Chunk) -> Chunk:
    """Return a chunk unpacked; ValueError if it states too large a size, or has another one than it states."""
    size = chunk.uncompressed_size
    if size > min(LARGEST_RECORD, max(SMALL_CHUNK, LARGEST_RATIO * len(chunk.data))):
        raise ValueError(f"a chunk of {size} bytes in {len(chunk.data)}")
    data = chunk.data
    if chunk.compression == "zstd":
        with ZstdDecompressor().stream_reader(chunk.data) as stream:
            data = stream.read(size + 1)
    elif chunk.compression == "lz4":
        data = LZ4FrameDecompressor().decompress(chunk.data, max_length=size + 1)
    if len(data) != size:
        raise ValueError(f"a chunk that is not of the {size} bytes that it states")
    return replace(chunk, compression="", data=data)


def _require_plain(path: Path) -> None:
    """Raise ValueError for a database whose tables are made by code in it, which could run for ever."""
    with (
        open_regular(path),
        closing(
            sqlite3.connect(f"{path.absolute().as_uri()}?mode=ro", uri=True)
        ) as database,
    ):
        for name, kind, code in database.execute(
            "SELECT name, type, sql FROM sqlite_master"
        ):
            if kind not in ("table", "index") or re.search(
                r"\b(GENERATED|VIRTUAL|AS)\b", code or "", re.IGNORECASE
            ):
                raise ValueError(f"{kind} {name!r:.40} is not a plain table")


def _part(path: Path) -> tuple[int, str]:
    """Return the key that sorts the parts of a split bag."""
    number: Any = re.search(r"_(\d+)$", path.stem)
    return (int(number[1]) if number else 0, path.name)
