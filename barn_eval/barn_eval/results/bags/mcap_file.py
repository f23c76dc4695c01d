"""Reading of MCAP files that others may have written, cut off or damaged."""

import struct
import zlib
from collections.abc import Iterator
from dataclasses import dataclass
from io import SEEK_CUR, BytesIO
from pathlib import Path

from lz4.frame import LZ4FrameDecompressor
from mcap.data_stream import ReadDataStream
from mcap.exceptions import EndOfFile, InvalidMagic, McapError
from mcap.opcode import Opcode
from mcap.records import Channel, Chunk, Metadata, Schema
from zstandard import ZstdDecompressor, ZstdError

from barn_worlds.base.files import open_regular

# What a damaged or malicious file states must not decide how much memory and time are
# taken: largest record in bytes, and largest ratio of a chunk that is not small.
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
        """Open a file.

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
        """Yield undecoded messages of records completed since the last call.

        Raises an error of `DAMAGE` where the file is damaged.
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
                # A recorder may be at work on the rest, so the next call begins here
                # again.
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
        """Yield messages of an unpacked chunk; store its types and topics.

        Raises:
            EndOfFile: Its last record is cut off.
        """
        # A chunk within a chunk is left out: each level could unpack to 256 times as
        # much as the one around it.
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
        # There are thousands a second, for which mcap's own reader is too slow.
        channel, _, stamp_ns, _ = _MESSAGE_HEAD.unpack_from(content)
        topic, type_name = self._channels[channel]
        return RawMessage(topic, type_name, stamp_ns, content[_MESSAGE_HEAD.size :])

    def _take(self, kind: int, content: bytes) -> None:
        """Store type, topic or metadata of a record that is no message.

        Records of other kinds are ignored.
        """
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


def unpack_chunk(chunk: Chunk) -> bytes:
    """Return the decompressed records of a chunk after a check of its size and CRC.

    Raises:
        ValueError: It states too large a size, or has another size or checksum than it
            states.
    """
    size = chunk.uncompressed_size
    largest = max(SMALL_CHUNK, LARGEST_RATIO * len(chunk.data))
    if size > min(LARGEST_RECORD, largest):
        raise ValueError(f"a chunk of {size} bytes in {len(chunk.data)}")

    # One byte more than stated shows a chunk that is too large.
    data = chunk.data
    if chunk.compression == "zstd":
        with ZstdDecompressor().stream_reader(data) as stream:
            data = stream.read(size + 1)
    elif chunk.compression == "lz4":
        data = LZ4FrameDecompressor().decompress(data, max_length=size + 1)
    if len(data) != size:
        raise ValueError(f"a chunk that is not of the {size} bytes that it states")
    if chunk.uncompressed_crc and zlib.crc32(data) != chunk.uncompressed_crc:
        raise ValueError("a chunk that has not its checksum")
    return data
