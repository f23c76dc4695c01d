"""Record a trial, from serialized messages, as a rosbag2 directory with one MCAP file.

While it is written, the directory's name ends in `.partial`; it gets its final name when
it is finished. If the process is killed, all but about the last second of the trial is
readable in the partial file.
"""

import json
import shutil
from collections.abc import Iterable, Mapping, Sequence
from contextlib import AbstractContextManager
from functools import cache
from pathlib import Path
from textwrap import indent
from typing import Any, BinaryIO, NamedTuple

import yaml

from barn_eval import __version__
from barn_eval.results.bags.mcap_writer import McapWriter, MessageBlock, WrittenChannel
from barn_worlds.base.errors import BagError, convert_os_errors, suggest
from barn_worlds.base.types import NANOSECONDS_PER_SECOND
from barn_worlds.messages.cdr import Layout, jazzy_types
from barn_worlds.messages.topics import LATCHED, RELIABLE, OutgoingMessage, Qos, Topic

METADATA_VERSION = 9  # of metadata.yaml, as rosbag2 of Jazzy writes it
PARTIAL = ".partial"
_CHUNK_BYTES = 1 << 20
_TYPE_HASH = "topic_type_hash"
_Dumper: Any = getattr(yaml, "CSafeDumper", yaml.SafeDumper)  # libyaml's is faster
# The longest time that 64 bits hold, which means no limit in ROS.
_INFINITE = {"sec": 9223372036, "nsec": 854775807}


class _RecordedTopic(NamedTuple):
    """A topic that was announced, and its channel in the file."""

    type_name: str
    qos: Qos
    channel: WrittenChannel


class Recorder:
    """Writes the bag of one trial.

    Leaving its context without `finish` abandons the bag under its partial name.
    """

    def __init__(self, path: Path):
        """Begin a bag and delete an old partial one; BagError if `path` exists."""
        if path.exists():
            raise BagError(f"{path}: exists already")
        self.path = path
        self.partial_path = path.with_name(path.name + PARTIAL)
        self._types = jazzy_types()
        self._topics: dict[str, _RecordedTopic] = {}
        self._schemas: dict[str, int] = {}
        self._custom_data: dict[str, str] = {}
        self._first_ns: int | None = None
        self._last_ns = 0
        self._due_ns = 0
        self._file_name = f"{path.name}_0.mcap"
        with self._convert_errors():
            if self.partial_path.exists():
                shutil.rmtree(self.partial_path)
            self.partial_path.mkdir(parents=True)
            self._stream: BinaryIO = (self.partial_path / self._file_name).open("wb")
            self._writer = McapWriter(self._stream, f"barn_eval {__version__}")

    def __enter__(self) -> "Recorder":
        """Return the recorder."""
        return self

    def __exit__(self, *_: object) -> None:
        """Keep an unfinished bag under its partial name; BagError if it cannot."""
        self.abandon()

    def add_topic(
        self, name: str, type_name: str, qos: Qos = RELIABLE, known_as: str = ""
    ) -> None:
        """Announce a topic unless known; BagError if its type is unknown or differs.

        Args:
            name: Name of the topic.
            type_name: Type of its messages.
            qos: Quality of service that a player offers.
            known_as: Name by which readers know the topic, if it is another one.

        Raises:
            BagError: If the type is unknown, or the topic has a different one.
        """
        topic = self._topics.get(name)
        if topic is not None:
            if topic.type_name != type_name:
                raise BagError(
                    f"{self.path}: topic {name} is recorded as {topic.type_name}, not"
                    f" as {type_name}"
                )
            return
        if type_name not in self._types.fielddefs:
            hint = suggest(type_name, self._types.fielddefs)
            raise BagError(f"{self.path}: unknown type {type_name!r} of {name}{hint}")

        if type_name not in self._schemas:
            self._schemas[type_name] = self._writer.add_schema(
                type_name, _definition(type_name)
            )
        metadata = {
            "offered_qos_profiles": _profile_text(qos),
            _TYPE_HASH: _type_hash(type_name),
        }
        if known_as:
            metadata["known_as"] = known_as
        channel = self._writer.add_channel(name, self._schemas[type_name], metadata)
        self._topics[name] = _RecordedTopic(type_name, qos, channel)

    def announce(self, topic: Topic) -> None:
        """Announce a topic with the quality of service for players: latched or reliable."""
        qos = LATCHED if topic.qos.durability == LATCHED.durability else RELIABLE
        self.add_topic(topic.path, topic.type_name, qos)

    def write(self, topic: str, data: bytes, stamp_ns: int) -> None:
        """Write a message on an announced topic; KeyError on any other.

        Args:
            topic: Name of a topic that was announced.
            data: The message as CDR with its header.
            stamp_ns: Log and publish time.
        """
        self._writer.add_message(self._topics[topic].channel, data, stamp_ns)
        self._end_write(stamp_ns)

    def record(self, messages: Iterable[OutgoingMessage], stamp_ns: int) -> None:
        """Write messages of the suite with one stamp, announcing their topics first.

        Args:
            messages: Topics with their serialized messages.
            stamp_ns: Log and publish time.
        """
        for topic, data in messages:
            path = topic.path
            if path not in self._topics:
                self.announce(topic)
            self.write(path, data, stamp_ns)

    def prepare_block(self, messages: Iterable[tuple[Topic, Layout]]) -> MessageBlock:
        """Announce topics whose messages are written together; return their block.

        Args:
            messages: Topics and layouts of their messages, in order.
        """
        channels = []
        for topic, layout in messages:
            self.announce(topic)
            channels.append((self._topics[topic.path].channel, layout))
        return self._writer.prepare_block(channels)

    def write_block(
        self, block: MessageBlock, rows: Iterable[Sequence[Any]], stamp_ns: int
    ) -> None:
        """Write the messages of a prepared block.

        Args:
            block: The messages.
            rows: Values of their layouts, in order.
            stamp_ns: Log and publish time.
        """
        self._writer.add_block(block, rows, stamp_ns)
        self._end_write(stamp_ns)

    def _end_write(self, stamp_ns: int) -> None:
        """Update the bag's times; end the chunk if it is large or a second old."""
        if self._first_ns is None:
            self._first_ns = stamp_ns
            self._due_ns = stamp_ns + NANOSECONDS_PER_SECOND
        self._last_ns = max(self._last_ns, stamp_ns)
        # If the process is killed, the chunk in memory is lost.
        if stamp_ns >= self._due_ns or self._writer.chunk_bytes > _CHUNK_BYTES:
            self._due_ns = stamp_ns + NANOSECONDS_PER_SECOND
            with self._convert_errors():
                self._writer.end_chunk()

    def add_metadata(self, name: str, content: Mapping[str, Any]) -> None:
        """Add a named mapping, as texts or JSON, to the file and to metadata.yaml.

        Args:
            name: Name of the mapping.
            content: The mapping; values that are not text become JSON.
        """
        texts = {}
        for key, value in content.items():
            texts[key] = value if isinstance(value, str) else json.dumps(value)
            self._custom_data[f"{name}.{key}"] = texts[key]
        with self._convert_errors():
            self._writer.add_metadata(name, texts)

    def finish(self) -> Path:
        """Complete the bag, give it its final name, and return its path."""
        text = _to_yaml(self._description())
        with self._convert_errors():
            self._writer.add_metadata("rosbag2", {"serialized_metadata": text})
            self._writer.finish()
            self._stream.close()
            text = f"rosbag2_bagfile_information:\n{indent(text, '  ')}"
            (self.partial_path / "metadata.yaml").write_text(text, "utf-8")
            # The name comes last, so a bag with its final name is complete.
            self.partial_path.rename(self.path)
        return self.path

    def abandon(self) -> None:
        """Leave what was written under the partial name, unless the bag is finished."""
        if not self._stream.closed:
            with self._convert_errors():
                self._writer.end_chunk()
                self._stream.close()

    def _convert_errors(self) -> AbstractContextManager[None]:
        """Return a context that raises OSErrors as BagErrors which name the bag."""
        return convert_os_errors(BagError, f"{self.partial_path}: cannot record")

    def _description(self) -> dict[str, Any]:
        """Return the content of metadata.yaml."""
        first_ns = self._first_ns or 0
        start = {"nanoseconds_since_epoch": first_ns}
        duration = {"nanoseconds": self._last_ns - first_ns}
        count = sum(topic.channel.count for topic in self._topics.values())
        file = {
            "path": self._file_name,
            "starting_time": start,
            "duration": duration,
            "message_count": count,
        }
        return {
            "version": METADATA_VERSION,
            "storage_identifier": "mcap",
            "duration": duration,
            "starting_time": start,
            "message_count": count,
            "topics_with_message_count": [
                _topic_entry(topic) for topic in self._topics.values()
            ],
            "compression_format": "",
            "compression_mode": "",
            "relative_file_paths": [self._file_name],
            "files": [file],
            "custom_data": self._custom_data,
            "ros_distro": "jazzy",
        }


def _profile(qos: Qos) -> dict[str, Any]:
    """Return a quality of service as an entry of metadata.yaml."""
    return {
        "history": "keep_last",
        "depth": qos.depth,
        "reliability": qos.reliability,
        "durability": qos.durability,
        "deadline": _INFINITE,
        "lifespan": _INFINITE,
        "liveliness": "automatic",
        "liveliness_lease_duration": _INFINITE,
        "avoid_ros_namespace_conventions": False,
    }


def _topic_entry(topic: _RecordedTopic) -> dict[str, Any]:
    """Return a topic with its message count as an entry of metadata.yaml."""
    metadata = {
        "name": topic.channel.record.topic,
        "type": topic.type_name,
        "serialization_format": "cdr",
        "offered_qos_profiles": [_profile(topic.qos)],
        "type_description_hash": topic.channel.record.metadata[_TYPE_HASH],
    }
    return {"topic_metadata": metadata, "message_count": topic.channel.count}


@cache
def _profile_text(qos: Qos) -> str:
    """Return a quality of service as YAML text for a channel."""
    return _to_yaml([_profile(qos)])


@cache
def _definition(type_name: str) -> str:
    """Return a message type's definition in the format of .msg files."""
    return str(jazzy_types().generate_msgdef(type_name, ros_version=2)[0])


@cache
def _type_hash(type_name: str) -> str:
    """Return the RIHS01 hash of a message type."""
    return str(jazzy_types().hash_rihs01(type_name))


def _to_yaml(content: object) -> str:
    """Return plain data as YAML text without anchors and aliases."""
    # PyYAML writes an object that occurs twice as an anchor and an alias. After JSON, no
    # object does.
    plain = json.loads(json.dumps(content))
    text = yaml.dump(
        plain, Dumper=_Dumper, sort_keys=False, allow_unicode=True, width=10_000
    )
    return str(text)
