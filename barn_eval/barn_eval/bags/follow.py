"""Reading of a bag while it is written: what has come since the last look, message by message."""

from collections.abc import Iterator
from io import BytesIO
from pathlib import Path
from typing import BinaryIO, NamedTuple

from mcap.data_stream import ReadDataStream
from mcap.opcode import Opcode
from mcap.records import Channel, Chunk, Message, Schema
from mcap.stream_reader import breakup_chunk

from barn_eval.bags import BAGS
from barn_eval.bags.recorder import PARTIAL
from barn_worlds.errors import BagError

_MAGIC_BYTES, _HEAD_BYTES = 8, 9  # of the file; of a record: its kind and length
_MOST_BYTES = 1 << 28  # of a record
_READ_BYTES = 1 << 24  # at a time


class Heard(NamedTuple):
    """A message as it was recorded: its topic, type and CDR bytes, and its simulated time."""

    topic: str
    type_name: str
    data: bytes
    stamp_ns: int


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

    def read(self) -> Iterator[Heard]:
        """Yield the messages of the records that have become whole since the last call."""
        self._left += self._file.read(_READ_BYTES)
        if not self._begun:
            if len(self._left) < _MAGIC_BYTES:
                return
            self._left, self._begun = self._left[_MAGIC_BYTES:], True
        at = 0
        while len(self._left) - at >= _HEAD_BYTES and not self.ended:
            kind, length = self._left[at], int.from_bytes(self._left[at + 1 : at + _HEAD_BYTES], "little")
            if length > _MOST_BYTES:
                raise BagError(f"{self.path}: is damaged: a record of {length} bytes")
            if len(self._left) - at - _HEAD_BYTES < length:
                break
            content = self._left[at + _HEAD_BYTES : at + _HEAD_BYTES + length]
            at += _HEAD_BYTES + length
            if kind == Opcode.CHUNK:
                yield from self._chunk(content)
            self.ended = kind == Opcode.DATA_END
        self._left = self._left[at:]

    def _chunk(self, content: bytes) -> Iterator[Heard]:
        try:
            records = breakup_chunk(Chunk.read(ReadDataStream(BytesIO(content))))
        except Exception as error:  # whatever a damaged chunk makes of the decompressor
            raise BagError(f"{self.path}: is damaged: {error}") from None
        for record in records:
            if isinstance(record, Schema):
                self._schemas[record.id] = record.name
            elif isinstance(record, Channel):
                self._topics[record.id] = record.topic, self._schemas.get(record.schema_id, "")
            elif isinstance(record, Message) and record.channel_id in self._topics:
                yield Heard(*self._topics[record.channel_id], record.data, record.log_time)


class TrialFollower:
    """The trial of a folder that is being recorded, and after it the next; of several at a time, one."""

    def __init__(self, folder: Path) -> None:
        self._bags = folder / BAGS
        self._current: GrowingBag | None = None
        self._done: set[Path] = set()

    def read(self) -> tuple[bool, list[Heard]]:
        """Return whether another trial has begun, and the messages that have come."""
        if self._current is not None:
            heard = list(self._current.read())
            if heard or not (self._current.ended or self._newer(self._current.path)):
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
        found = [(_written_ns(path), path) for path in self._bags.glob(f"*{PARTIAL}/*.mcap") if path not in self._done]
        return max(found, default=(0, None))[1]

    def _newer(self, path: Path) -> bool:
        other = self._newest_but(path)
        return other is not None and _written_ns(other) > _written_ns(path)

    def _newest_but(self, path: Path) -> Path | None:
        self._done.add(path)
        try:
            return self._newest()
        finally:
            self._done.discard(path)


def _written_ns(path: Path) -> int:
    try:
        return path.stat().st_mtime_ns
    except OSError:  # it has just got its own name
        return 0
