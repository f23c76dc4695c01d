"""Read bags of rosbag2 (MCAP, SQLite; folders and files) and ROS 1.

Others may have written the bags, which may be cut off or damaged.
"""

import re
import sqlite3
import struct
import zlib
from bz2 import BZ2Decompressor
from collections.abc import Callable, Collection, Iterator
from contextlib import closing, contextmanager, suppress
from dataclasses import dataclass, replace
from functools import cached_property
from io import SEEK_CUR, BytesIO
from pathlib import Path
from tempfile import TemporaryDirectory
from typing import Any

from lz4.frame import LZ4FrameDecompressor
from mcap.data_stream import ReadDataStream
from mcap.exceptions import EndOfFile, InvalidMagic, McapError
from mcap.opcode import Opcode
from mcap.records import Channel, Chunk, Metadata, Schema
from rosbags.rosbag1 import Reader, ReaderError
from rosbags.rosbag1.reader import decompressors
from rosbags.serde import SerdeError
from zstandard import ZstdDecompressor, ZstdError

from barn_eval.results.bags import BAGS
from barn_eval.results.bags.recorder import PARTIAL
from barn_worlds.base.errors import BagError, convert_os_errors, format_error
from barn_worlds.base.files import open_regular, read_bytes
from barn_worlds.base.types import seconds
from barn_worlds.messages.cdr import jazzy_types

# Limits on the memory and time that a damaged or malicious file may take: largest record
# in bytes, and largest compression ratio of a chunk that is not small.
LARGEST_RECORD = 1 << 28
SMALL_CHUNK = 1 << 22
LARGEST_RATIO = 256

_MAGIC = b"\x89MCAP0\r\n"
_RECORD_HEAD = struct.Struct("<BQ")  # kind and length
_MESSAGE_HEAD = struct.Struct("<HIQQ")  # channel, number, time of log and publication

# Errors that the content of a file can cause in its readers.
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

# Bytes of all messages of a bag, and bytes of memory per message besides its data.
LARGEST_BAG = 1 << 29
MESSAGE_BYTES = 256
_LARGEST_METADATA = 1 << 24

_LATEST_NS = (1 << 63) - 1  # no ROS clock reads more
_BLOCK = 1 << 20

# Endings of files and of files compressed as a whole, in the order of preference.
_ENDINGS = (".mcap", ".mcap.zstd", ".db3", ".db3.zstd", ".bag")
# Newer versions list the files twice, as `- NAME` and as `- path: NAME`.
_PART_NAMES = re.compile(r"^ *- (?:path: )?(\S+\.(?:mcap|db3)(?:\.zstd)?) *$", re.M)
_ZSTD = b"\x28\xb5\x2f\xfd"  # how a compressed message begins
_TOPICS = "SELECT id, name, type, serialization_format FROM topics"
_MESSAGES = "SELECT topic_id, timestamp, data FROM messages ORDER BY timestamp, id"
# Names that types had in ROS 1, of the same content.
_ROS1_TYPES = {"tf/msg/tfMessage": "tf2_msgs/msg/TFMessage"}


@dataclass(frozen=True, slots=True)
class RawMessage:
    """A message as recorded."""

    topic: str
    type_name: str
    stamp_ns: int  # time of the log
    data: bytes  # CDR with its header


class McapFile:
    """One MCAP file, read without its index.

    A file that is cut off or still being written has no index.

    Attributes:
        path: The file.
        began: Whether a record could be read.
        ended: Whether the last record was read.
    """

    def __init__(self, path: Path, metadata: dict[str, dict[str, str]]):
        """Open a regular file; `metadata` is filled with mappings as they are read.

        Args:
            path: The file.
            metadata: Receives the file's named mappings as they are read.
        """
        self.path = path
        self.began = False
        self.ended = False
        self._metadata = metadata
        self._file = open_regular(path)
        self._types: dict[int, str] = {}
        self._channels: dict[int, tuple[str, str]] = {}

    def close(self) -> None:
        """Close the file; no more messages can be read."""
        self._file.close()

    def messages(self) -> Iterator[RawMessage]:
        """Yield messages of records completed since the last call; raise if damaged.

        Raises an error of `DAMAGE` if the file is damaged.
        """
        if self._file.tell() == 0:
            magic = self._read(len(_MAGIC))
            if magic is None:
                return
            if magic != _MAGIC:
                raise InvalidMagic(magic)

        while not self.ended:
            head = self._read(_RECORD_HEAD.size)
            if head is None:
                return
            kind, size = _RECORD_HEAD.unpack(head)
            if size > LARGEST_RECORD:
                raise ValueError(f"a record of {size} bytes")
            content = self._read(size)
            if content is None:
                # A recorder may still write the rest, so the next call begins here again.
                self._file.seek(-_RECORD_HEAD.size, SEEK_CUR)
                return

            if kind == Opcode.CHUNK:
                chunk = Chunk.read(ReadDataStream(BytesIO(content)))
                yield from self._chunk_messages(unpack_chunk(chunk))
            elif kind == Opcode.MESSAGE:
                yield self._message(content)
            else:
                self._take(kind, content)
            self.began = True
            self.ended = kind == Opcode.FOOTER

    def _read(self, size: int) -> bytes | None:
        """Return the next `size` bytes; None, without moving on, if there are fewer."""
        data = self._file.read(size)
        if len(data) == size:
            return data
        self._file.seek(-len(data), SEEK_CUR)
        return None

    def _chunk_messages(self, data: bytes) -> Iterator[RawMessage]:
        """Yield an unpacked chunk's messages; store its types; EndOfFile if cut off.

        Raises:
            EndOfFile: If its last record is cut off.
        """
        # A chunk within a chunk is ignored, because each level could unpack to 256 times
        # the size of the one around it.
        end = 0
        while end < len(data):
            kind, size = _RECORD_HEAD.unpack_from(data, end)
            start = end + _RECORD_HEAD.size
            end = start + size
            if end > len(data):
                raise EndOfFile
            if kind == Opcode.MESSAGE:
                yield self._message(data[start:end])
            else:
                self._take(kind, data[start:end])

    def _message(self, content: bytes) -> RawMessage:
        """Return the message of a record; KeyError if its channel is unknown."""
        # There are thousands per second, for which mcap's own reader is too slow.
        channel, _, stamp_ns, _ = _MESSAGE_HEAD.unpack_from(content)
        topic, type_name = self._channels[channel]
        return RawMessage(topic, type_name, stamp_ns, content[_MESSAGE_HEAD.size :])

    def _take(self, kind: int, content: bytes) -> None:
        """Store the type, topic or metadata in a record; ignore any other record."""
        stream = ReadDataStream(BytesIO(content))
        if kind == Opcode.SCHEMA:
            schema = Schema.read(stream)
            self._types[schema.id] = schema.name
        elif kind == Opcode.CHANNEL:
            channel = Channel.read(stream)
            type_name = ""
            if channel.message_encoding == "cdr":
                type_name = self._types.get(channel.schema_id, "")
            # Over ROS a topic may have been remapped; readers go by the suite's name.
            topic = channel.metadata.get("known_as", channel.topic)
            self._channels[channel.id] = (topic, type_name)
        elif kind == Opcode.METADATA:
            metadata = Metadata.read(stream)
            self._metadata[metadata.name] = dict(metadata.metadata)


def largest_unpacked(data: bytes) -> int:
    """Return how many bytes a chunk may unpack to: 256 times its own, 4 to 256 MiB."""
    return min(LARGEST_RECORD, max(SMALL_CHUNK, LARGEST_RATIO * len(data)))


def unpack_chunk(chunk: Chunk) -> bytes:
    """Return a chunk's decompressed records; ValueError if its size or CRC is wrong.

    Raises:
        ValueError: If the chunk states too large a size, or its size or checksum differs
            from what it states.
    """
    size = chunk.uncompressed_size
    if size > largest_unpacked(chunk.data):
        raise ValueError(f"a chunk of {size} bytes in {len(chunk.data)}")

    # One byte more than stated shows a chunk that is too large.
    data = chunk.data
    if chunk.compression == "zstd":
        with ZstdDecompressor().stream_reader(data) as stream:
            data = stream.read(size + 1)
    elif chunk.compression == "lz4":
        data = LZ4FrameDecompressor().decompress(data, max_length=size + 1)
    if len(data) != size:
        raise ValueError(f"a chunk that does not unpack to its declared {size} bytes")
    if chunk.uncompressed_crc and zlib.crc32(data) != chunk.uncompressed_crc:
        raise ValueError("a chunk with a wrong checksum")
    return data


class BagFile:
    """A bag on disk, which others may have written, cut off or damaged.

    Attributes:
        path: The bag.
        metadata: Named mappings from the part read so far.
        problem: Why reading ended before the end of the bag; empty if it did not.
    """

    def __init__(self, path: Path):
        """Find the files of a bag (folder or file); BagError if there are none."""
        self.path = path
        self.metadata: dict[str, dict[str, str]] = {}
        self.problem = ""
        self._files = self._find(path)
        self._first_ns: int | None = None
        self._last_ns = 0

    @property
    def is_empty(self) -> bool:
        """Whether no message has been read so far, such as before `messages`."""
        return self._first_ns is None

    @cached_property
    def types(self) -> dict[str, str]:
        """Type of each topic, "" if not CDR; reads the whole bag, or up to damage."""
        return {message.topic: message.type_name for message in self._messages()}

    def messages(self, topics: Collection[str] = ()) -> Iterator[RawMessage]:
        """Yield messages of `topics`, or all, to damage or 512 MiB; BagError if unreadable.

        After damage, `problem` says what ended the reading. Each call begins at the
        start of the bag.

        Args:
            topics: The topics to read. Default: all.

        Raises:
            BagError: If the bag's format cannot be read.
        """
        size = 0
        for message in self._messages():
            if topics and message.topic not in topics:
                continue
            unpacked = _unpack(message)
            # Topics that are not asked for, such as images, take no memory.
            size += len(unpacked.data) + MESSAGE_BYTES
            if size > LARGEST_BAG:
                reason = f"it has more than {LARGEST_BAG} bytes of messages"
                return self._note("read no further", reason)
            yield unpacked

    def _messages(self) -> Iterator[RawMessage]:
        """Yield all messages as in the file, up to damage; note times and `problem`."""
        self.problem = ""
        for message in self._read():
            if not 0 <= message.stamp_ns <= _LATEST_NS:
                reason = f"a message with the time {message.stamp_ns} ns"
                return self._note("damaged", reason)
            if self._first_ns is None:
                self._first_ns = message.stamp_ns
            self._last_ns = message.stamp_ns
            yield message

    def _find(self, path: Path) -> list[Path]:
        """Return a bag's files, all of one format, by part; BagError if there are none.

        Raises:
            BagError: If there is no bag.
        """
        if not path.exists():
            partial = path.with_name(path.name + PARTIAL)
            hint = ""
            if partial.exists():
                hint = f"; there is an unfinished one, {partial}"
            raise BagError(f"{path}: no such bag{hint}")
        if path.name == "metadata.yaml":
            path = path.parent
        if path.is_file():
            return [path]
        for ending in _ENDINGS:
            files = sorted(path.glob(f"*{ending}"), key=_part_key)
            if files:
                break
        else:
            raise BagError(f"{path}: holds no bag (no {', '.join(_ENDINGS)} file)")

        metadata = path / "metadata.yaml"
        if metadata.is_file():
            text = read_bytes(metadata, _LARGEST_METADATA).decode("utf-8", "replace")
            parts = set(_PART_NAMES.findall(text))
            if len(parts) > len(files):
                raise BagError(
                    f"{path}: has {len(files)} of the {len(parts)} files that"
                    f" {metadata.name} lists; add the others, or name one file"
                )
        return files

    def _read(self) -> Iterator[RawMessage]:
        """Yield messages of all files up to a problem; BagError if nothing was read."""
        for path in self._files:
            try:
                with _decompressed(path) as plain:
                    if plain.suffix == ".db3":
                        yield from _sqlite_messages(plain)
                    elif plain.suffix == ".bag":
                        yield from _ros1_messages(plain)
                    else:
                        yield from self._mcap_messages(plain, path)
            except (*_DATABASE_DAMAGE, *DAMAGE) as error:
                if self.is_empty:
                    raise BagError(
                        f"{path}: cannot be read as a bag: {format_error(error)}"
                    ) from None
                self._note("damaged", str(error) and format_error(error))
            if self.problem:
                return

    def _mcap_messages(self, path: Path, name: Path) -> Iterator[RawMessage]:
        """Yield messages of an .mcap file; note damage, BagError if it has no record.

        Without a readable record, the file counts as another format.

        Args:
            path: The file, which may be a temporary one.
            name: Name of the file for messages.
        """
        try:
            with (
                convert_os_errors(BagError, path),
                closing(McapFile(path, self.metadata)) as file,
            ):
                yield from file.messages()
                # A file without a footer was cut off between two records.
                if not file.ended:
                    raise EndOfFile
        except DAMAGE as error:
            is_cut_off = isinstance(error, EndOfFile)
            what = "cut off" if is_cut_off else "damaged"
            if not file.began:
                other = f", or {what} at its beginning"
                if isinstance(error, InvalidMagic):
                    other = ""
                raise BagError(f"{name}: not an MCAP file{other}") from None
            reason = ""
            if str(error) and not is_cut_off:
                reason = format_error(error)
            self._note(what, reason)

    def _note(self, what: str, reason: str) -> None:
        """Set `problem` to a text on what ended the reading, when (in s), and why."""
        after_s = seconds(self._last_ns - (self._first_ns or 0))
        self.problem = f"the bag is {what} after {after_s:.2f} s"
        if reason:
            self.problem += f" ({reason})"


class TrialFollower:
    """Follows a trial in a folder while it is being recorded, and then the next one.

    Of several trials at a time, it follows one.
    """

    def __init__(self, folder: Path):
        """Follow unfinished bags in a run's folder; none is opened before `read`."""
        self._bags = folder / BAGS
        self._current: McapFile | None = None
        self._followed: set[Path] = set()

    def read(self) -> tuple[bool, list[RawMessage]]:
        """Return (whether a new bag began, new messages) at once; BagError if damaged.

        Raises:
            BagError: If the bag is damaged.
        """
        current = self._current
        if current is not None:
            messages = _read_new(current)
            # A recorder that was killed never ends its file.
            another_is_newer = self._newest() not in (None, current.path)
            if messages or not (current.ended or another_is_newer):
                return False, messages
            self.close()
        path = self._newest()
        if path is None:
            return False, []
        self._current = McapFile(path, {})
        return True, _read_new(self._current)

    def close(self) -> None:
        """Close the current bag, if any; it is not followed again."""
        if self._current is not None:
            self._followed.add(self._current.path)
            self._current.close()
            self._current = None

    def _newest(self) -> Path | None:
        """Return the unfinished .mcap file modified last, or None if there is none.

        The file that is being followed counts; earlier ones do not.
        """
        written_ns: dict[Path, int] = {}
        for path in set(self._bags.glob(f"*{PARTIAL}/*.mcap")) - self._followed:
            with suppress(OSError):  # it has just got its own name
                written_ns[path] = path.stat().st_mtime_ns
        return max(written_ns, key=written_ns.__getitem__, default=None)


@contextmanager
def _decompressed(path: Path) -> Iterator[Path]:
    """Yield a file, or a temporary unpacked copy of .zstd; ValueError if too large.

    Raises:
        ValueError: If it unpacks to too many bytes.
    """
    if path.suffix != ".zstd":
        yield path
        return
    with TemporaryDirectory() as folder:
        plain = Path(folder) / path.stem
        with (
            open_regular(path) as packed,
            ZstdDecompressor().stream_reader(packed, read_across_frames=True) as stream,
            plain.open("wb") as file,
        ):
            while block := stream.read(_BLOCK):
                file.write(block)
                if file.tell() > LARGEST_BAG:
                    raise ValueError(f"it unpacks to more than {LARGEST_BAG} bytes")
        yield plain


def _unpack(message: RawMessage) -> RawMessage:
    """Return a message, decompressed if its data are compressed individually."""
    # CDR never begins like this, so no metadata is needed to know.
    if message.data[:4] != _ZSTD:
        return message
    with ZstdDecompressor().stream_reader(message.data) as stream:
        data = stream.read(LARGEST_RECORD)
    return replace(message, data=data)


def _sqlite_messages(path: Path) -> Iterator[RawMessage]:
    """Yield messages of a .db3 file, with type "" if not CDR; raise if damaged.

    Views, triggers, computed columns and virtual tables are refused: they have code that
    could run forever.
    """
    uri = f"{path.absolute().as_uri()}?mode=ro"
    # A pipe or a device is refused before SQLite opens it.
    with open_regular(path), closing(sqlite3.connect(uri, uri=True)) as database:
        tables = database.execute("SELECT name, type, sql FROM sqlite_master")
        for name, kind, code in tables:
            code_words = r"\b(GENERATED|VIRTUAL|AS)\b"
            has_code = re.search(code_words, code or "", re.IGNORECASE)
            if kind not in ("table", "index") or has_code:
                raise ValueError(f"{kind} {name!r:.40} is not a plain table")
        # A join in SQLite could make any number of messages out of a small file, by many
        # topics with one number.
        topics = {number: topic for number, *topic in database.execute(_TOPICS)}
        for number, stamp_ns, data in database.execute(_MESSAGES):
            topic, type_name, encoding = topics[number]
            if not isinstance(data, bytes) or not isinstance(stamp_ns, int):
                raise ValueError(
                    f"a message of {topic!r:.40} with a wrong type of data"
                )
            known_type = str(type_name) if encoding == "cdr" else ""
            yield RawMessage(str(topic), known_type, stamp_ns, data)


def _bound(kind: Any) -> Callable[[bytes], bytes]:
    """Return a function that unpacks a chunk of ROS 1, up to `largest_unpacked` bytes."""
    return lambda data: bytes(kind().decompress(data, largest_unpacked(data)))


# The library itself sets no limit.
decompressors.update(bz2=_bound(BZ2Decompressor), lz4=_bound(LZ4FrameDecompressor))


def _ros1_messages(path: Path) -> Iterator[RawMessage]:
    """Yield messages of a ROS 1 bag, as CDR if ROS 2 has their type."""
    types = jazzy_types()
    # A pipe or a device is refused before the library opens it.
    open_regular(path).close()
    with Reader(path) as reader:
        for connection, stamp_ns, data in reader.messages():
            type_name = _ROS1_TYPES.get(connection.msgtype, connection.msgtype)
            content = bytes(data)
            if type_name in types.fielddefs:
                content = bytes(types.ros1_to_cdr(data, type_name))
            yield RawMessage(connection.topic, type_name, stamp_ns, content)


def _read_new(file: McapFile) -> list[RawMessage]:
    """Return messages written since the last call; BagError if the file is damaged."""
    try:
        return list(file.messages())
    except DAMAGE as error:
        raise BagError(f"{file.path}: is damaged: {format_error(error)}") from None


# Errors besides `DAMAGE` that readers of SQLite and ROS 1 raise for a damaged file.
_DATABASE_DAMAGE = (ReaderError, SerdeError, sqlite3.Error, OSError, AssertionError)


def _part_key(path: Path) -> tuple[int, str]:
    """Return a part's sort key in a split bag: number after the last _, then name."""
    # As texts, part 10 would come before part 2.
    number = 0
    match = re.search(r"_(\d+)$", path.name.partition(".")[0])
    if match:
        number = int(match[1])
    return number, path.name
