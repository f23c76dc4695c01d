"""Write MCAP files: messages are packed here, other records by the mcap library.

That library's own writer takes as long for a trial's messages as the simulator takes to
drive the trial. Format: https://mcap.dev/spec, version 0.
"""

import struct
import zlib
from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass, field
from typing import Any, BinaryIO, NamedTuple

from mcap.data_stream import RecordBuilder
from mcap.opcode import Opcode
from mcap.records import (
    Channel,
    ChunkIndex,
    DataEnd,
    Footer,
    Header,
    McapRecord,
    Metadata,
    MetadataIndex,
    Schema,
    Statistics,
    SummaryOffset,
)
from mcap.writer import MCAP0_MAGIC
from zstandard import ZstdCompressor

from barn_worlds.messages.cdr import Layout, Slot

# Opcode, length, channel, sequence, log time and publish time in front of a message.
_MESSAGE = struct.Struct("<BQHIQQ")
_VARYING = (Slot(11, "I"), Slot(15, "Q"), Slot(23, "Q"))  # the last three of them
# Opcode, length, first and last time, size and checksum of the records, compression and
# size of what it leaves.
_CHUNK = struct.Struct("<BQQQQII4sQ")
_INDEX = struct.Struct("<BQHI")  # opcode, length, channel, length of the entries
_LENGTH_BYTES = 9  # opcode and length, which a record's length does not count
_FOOTER = struct.Struct("<BQQQ")  # what the checksum of the summary takes of it
# A higher level gains little, because scans are noisy.
_COMPRESSION_LEVEL = 1


@dataclass
class WrittenChannel:
    """A channel of a file that is being written."""

    record: Channel
    count: int = 0  # messages so far
    # Log time and offset of each message of the chunk, one after the other.
    index: list[int] = field(default_factory=list)


class MessageBlock(NamedTuple):
    """Messages of several channels that are always written together."""

    layout: Layout
    channels: Sequence[WrittenChannel]
    offsets: Sequence[int]  # of the messages' records in the block


class McapWriter:
    """Writes a file in chunks, which stay in memory until `end_chunk`.

    Attributes:
        chunk_bytes: Uncompressed size of the chunk in memory.
    """

    def __init__(self, stream: BinaryIO, library: str) -> None:
        """Write the beginning of a file with profile ros2 and the library's name."""
        self._stream = stream
        self._compressor = ZstdCompressor(level=_COMPRESSION_LEVEL)
        self._schemas: list[Schema] = []
        self._channels: list[WrittenChannel] = []
        self._chunks: list[ChunkIndex] = []
        self._metadata: list[MetadataIndex] = []
        # Parts of the chunk in memory, which are joined once.
        self._chunk: list[bytes] = []
        self.chunk_bytes = 0
        stream.write(MCAP0_MAGIC + _to_bytes([Header("ros2", library)]))

    def add_schema(self, name: str, definition: str) -> int:
        """Add a message type's definition to the chunk; return the schema's number.

        Args:
            name: Name of the type.
            definition: Text as in .msg files, with the types that it is made of.
        """
        schema = Schema(len(self._schemas) + 1, definition.encode(), "ros2msg", name)
        self._schemas.append(schema)
        self._add(_to_bytes([schema]))
        return schema.id

    def add_channel(
        self, topic: str, schema: int, metadata: dict[str, str]
    ) -> WrittenChannel:
        """Add a channel for a topic with CDR messages to the chunk; return it.

        Args:
            topic: Name of the topic.
            schema: Number of the schema of its type.
            metadata: Metadata that ROS readers expect.
        """
        record = Channel(len(self._channels) + 1, topic, "cdr", metadata, schema)
        channel = WrittenChannel(record)
        self._channels.append(channel)
        self._add(_to_bytes([record]))
        return channel

    def add_message(self, channel: WrittenChannel, data: bytes, stamp_ns: int) -> None:
        """Add a message to the chunk in memory, and count and index it.

        Args:
            channel: Channel of this file.
            data: The message as CDR with its header.
            stamp_ns: Log and publish time.
        """
        channel.count += 1
        channel.index += (stamp_ns, self.chunk_bytes)
        self._add(_message_head(channel, len(data), stamp_ns))
        self._add(data)

    def prepare_block(
        self, messages: Iterable[tuple[WrittenChannel, Layout]]
    ) -> MessageBlock:
        """Return a block of messages for `add_block`; nothing is written.

        Args:
            messages: Channels of this file and layouts of their messages, in order.
        """
        data = b""
        slots: list[Slot] = []
        channels = []
        offsets = []
        for channel, layout in messages:
            channels.append(channel)
            offsets.append(len(data))
            slots += [slot.shifted(len(data)) for slot in _VARYING]
            data += _message_head(channel, len(layout.data), 0)
            slots += [slot.shifted(len(data)) for slot in layout.slots]
            data += layout.data
        return MessageBlock(Layout(data, slots), channels, offsets)

    def add_block(
        self, block: MessageBlock, rows: Iterable[Sequence[Any]], stamp_ns: int
    ) -> None:
        """Add a block's messages, a row of values each, to the chunk in memory.

        Args:
            block: Block of this file.
            rows: Values of the messages' layouts, in order.
            stamp_ns: Log and publish time of all.
        """
        start = self.chunk_bytes
        values: list[Any] = []
        messages = zip(block.channels, block.offsets, rows, strict=True)
        for channel, offset, row in messages:
            channel.count += 1
            channel.index += (stamp_ns, start + offset)
            values += (channel.count, stamp_ns, stamp_ns)
            values += row
        self._add(block.layout.fill(*values))

    def _add(self, data: bytes) -> None:
        """Append bytes of records to the chunk in memory."""
        self._chunk.append(data)
        self.chunk_bytes += len(data)

    def end_chunk(self) -> None:
        """Write the chunk and its indexes if it has a message, and flush the stream."""
        filled = [channel for channel in self._channels if channel.index]
        if not filled:
            return

        # Times are sorted in the bags of the suite, but need not be.
        stamps = [stamp for channel in filled for stamp in channel.index[::2]]
        first_ns = min(stamps)
        last_ns = max(stamps)
        records = b"".join(self._chunk)
        size = len(records)
        compressed = self._compressor.compress(records)
        checksum = zlib.crc32(records)
        length = _CHUNK.size - _LENGTH_BYTES + len(compressed)
        head = _CHUNK.pack(
            Opcode.CHUNK, length, first_ns, last_ns, size, checksum, 4, b"zstd",
            len(compressed),
        )  # fmt: skip

        chunk_start = self._stream.tell()
        chunk_bytes = len(head) + len(compressed)
        index_start = chunk_start + chunk_bytes
        indexes = bytearray()
        places = {}
        for channel in filled:
            places[channel.record.id] = index_start + len(indexes)
            entries = struct.pack(f"<{len(channel.index)}Q", *channel.index)
            length = _INDEX.size - _LENGTH_BYTES + len(entries)
            indexes += _INDEX.pack(
                Opcode.MESSAGE_INDEX, length, channel.record.id, len(entries)
            )
            indexes += entries
            channel.index.clear()

        self._chunks.append(
            ChunkIndex(
                chunk_length=chunk_bytes,
                chunk_start_offset=chunk_start,
                compression="zstd",
                compressed_size=len(compressed),
                message_end_time=last_ns,
                message_index_length=len(indexes),
                message_index_offsets=places,
                message_start_time=first_ns,
                uncompressed_size=size,
            )
        )
        self._chunk.clear()
        self.chunk_bytes = 0
        self._stream.write(head + compressed + indexes)
        self._stream.flush()

    def add_metadata(self, name: str, texts: Mapping[str, str]) -> None:
        """End the chunk, write a named mapping, and flush the stream.

        Args:
            name: Name of the mapping.
            texts: The mapping.
        """
        self.end_chunk()
        record = _to_bytes([Metadata(name, dict(texts))])
        self._metadata.append(MetadataIndex(self._stream.tell(), len(record), name))
        self._stream.write(record)
        self._stream.flush()

    def finish(self) -> None:
        """Write the chunk and the summary; the stream stays open."""
        self.end_chunk()
        self._stream.write(_to_bytes([DataEnd(0)]))

        start = self._stream.tell()
        summary = b""
        offsets = []
        groups: list[Sequence[McapRecord]] = [
            self._schemas,
            [channel.record for channel in self._channels],
            [self._statistics()],
            self._chunks,
            self._metadata,
        ]
        for group in map(_to_bytes, groups):
            if group:
                place = start + len(summary)
                # Each record begins with its opcode.
                offsets.append(SummaryOffset(group[0], place, len(group)))
                summary += group
        offset_start = start + len(summary)
        summary += _to_bytes(offsets)

        footer = _FOOTER.pack(Opcode.FOOTER, 20, start, offset_start)
        checksum = zlib.crc32(footer, zlib.crc32(summary))
        summary += _to_bytes([Footer(start, offset_start, checksum)])
        self._stream.write(summary + MCAP0_MAGIC)

    def _statistics(self) -> Statistics:
        """Return the record of counts and of the first and last time (0 if empty)."""
        counts = {channel.record.id: channel.count for channel in self._channels}
        first_ns = min((chunk.message_start_time for chunk in self._chunks), default=0)
        last_ns = max((chunk.message_end_time for chunk in self._chunks), default=0)
        return Statistics(
            attachment_count=0,
            channel_count=len(self._channels),
            channel_message_counts=counts,
            chunk_count=len(self._chunks),
            message_count=sum(counts.values()),
            metadata_count=len(self._metadata),
            message_start_time=first_ns,
            message_end_time=last_ns,
            schema_count=len(self._schemas),
        )


def _message_head(channel: WrittenChannel, size: int, stamp_ns: int) -> bytes:
    """Return what precedes the `size` bytes of a channel's last message."""
    length = _MESSAGE.size - _LENGTH_BYTES + size
    return _MESSAGE.pack(
        Opcode.MESSAGE, length, channel.record.id, channel.count, stamp_ns, stamp_ns
    )


def _to_bytes(records: Iterable[McapRecord]) -> bytes:
    """Return records packed by the mcap library, one after the other."""
    builder: Any = RecordBuilder()
    for record in records:
        record.write(builder)
    return bytes(builder.end())
