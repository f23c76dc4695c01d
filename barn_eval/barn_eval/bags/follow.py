"""Reading of a bag while it is written: what has come since the last look, message by message."""

from collections.abc import Iterator
from io import BytesIO
from pathlib import Path
from typing import BinaryIO

from mcap.data_stream import ReadDataStream
from mcap.opcode import Opcode
from mcap.records import Channel, Chunk, Message, Schema
from mcap.stream_reader import breakup_chunk

from barn_eval.bags import BAGS
from barn_eval.bags.bagfile import DAMAGE, LARGEST_RECORD, RawMessage, unpacked
from barn_eval.bags.recorder import PARTIAL
from barn_worlds.base.errors import BagError, one_line

_MAGIC_BYTES, _HEAD_BYTES = 8, 9  # of the file; of a record: its kind and length
_READ_BYTES = 1 << 24  # at a time


class GrowingBag:
    """The messages of one MCAP file that may still be written; BagError for what is none."""

    def __init__(self, path: Path) -> None:
        self.path = path
        self._file: BinaryIO = path.open("rb")
        self._left = b""
        self._begun = self.ended = False
        self._schemas: dict[int, str] = {}
        self._topics: dict[int, tuple[str, str]] = {}

    def close(self) -> None:
        """Close the file."""
        self._file.close()

    def read(self) -> Iterator[RawMessage]:
        """Yield the messages of the records that have become whole since the last call."""
        self._left += self._file.read(_READ_BYTES)
        if not self._begun:
            if len(self._left) < _MAGIC_BYTES:
                return
            self._left, self._begun = self._left[_MAGIC_BYTES:], True
        at = 0
        while len(self._left) - at >= _HEAD_BYTES and not self.ended:
            kind, length = self._left[at], int.from_bytes(self._left[at + 1 : at + _HEAD_BYTES], "little")
            if length > LARGEST_RECORD:
                raise BagError(f"{self.path}: is damaged: a record of {length} bytes")
            if len(self._left) - at - _HEAD_BYTES < length:
                break
            content = self._left[at + _HEAD_BYTES : at + _HEAD_BYTES + length]
            at += _HEAD_BYTES + length
            if kind == Opcode.CHUNK:
                yield from self._chunk(content)
            self.ended = kind == Opcode.DATA_END
        self._left = self._left[at:]

    def _chunk(self, content: bytes) -> Iterator[RawMessage]:
        try:
            records = breakup_chunk(unpacked(Chunk.read(ReadDataStream(BytesIO(content)))), validate_crc=True)
        except DAMAGE as error:
            raise BagError(f"{self.path}: is damaged: {one_line(error)}") from None
        for record in records:
            if isinstance(record, Schema):
                self._schemas[record.id] = record.name
            elif isinstance(record, Channel):
                self._topics[record.id] = record.topic, self._schemas.get(record.schema_id, "")
            elif isinstance(record, Message) and record.channel_id in self._topics:
                yield RawMessage(*self._topics[record.channel_id], record.log_time, record.data)


class TrialFollower:
    """The trial of a folder that is being recorded, and after it the next; of several at a time, one."""

    def __init__(self, folder: Path) -> None:
        self._bags = folder / BAGS
        self._current: GrowingBag | None = None
        self._done: set[Path] = set()

    def read(self) -> tuple[bool, list[RawMessage]]:
        """Return whether another trial has begun, and the messages that have come."""
        if self._current is not None:
            heard = list(self._current.read())
            if heard or not (self._current.ended or self._newest() not in (None, self._current.path)):
                return False, heard
            self._leave(self._current)
        path = self._newest()
        if path is None:
            return False, []
        self._current = GrowingBag(path)
        return True, list(self._current.read())

    def close(self) -> None:
        """Close the bag."""
        if self._current is not None:
            self._leave(self._current)

    def _leave(self, bag: GrowingBag) -> None:
        self._done.add(bag.path)
        self._current = None
        bag.close()

    def _newest(self) -> Path | None:
        """Return the file that was written to last, of trials that are being recorded and were not followed yet."""
        found = [path for path in self._bags.glob(f"*{PARTIAL}/*.mcap") if path not in self._done]
        return max(found, key=_written_ns, default=None)


def _written_ns(path: Path) -> int:
    try:
        return path.stat().st_mtime_ns
    except OSError:  # it has just got its own name
        return 0
