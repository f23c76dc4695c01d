"""Recording of a trial as a rosbag2 directory with one MCAP file, from bytes that are already serialised.

While it is written the directory has a name ending in `.partial`; it gets its own when it is finished. Whatever kills
the writer, the partial file is readable up to the last whole second of the trial.
"""

import json
import shutil
from collections.abc import Mapping
from contextlib import AbstractContextManager
from dataclasses import dataclass
from pathlib import Path
from typing import Any, BinaryIO

import yaml
from mcap.writer import CompressionType, Writer
from rosbags.typesys.store import Typestore

from barn_eval import __version__
from barn_worlds.base.errors import BagError, convert_os_errors, suggest
from barn_worlds.base.types import NANOSECONDS_PER_SECOND
from barn_worlds.messages.cdr import jazzy_types
from barn_worlds.messages.topics import RELIABLE, Qos

METADATA_VERSION = 9  # of metadata.yaml, what rosbag2 of Jazzy writes
PARTIAL = ".partial"
_CHUNK_BYTES = 1 << 20
_Dumper: Any = getattr(yaml, "CSafeDumper", yaml.SafeDumper)  # libyaml's is faster
_INFINITE = {"sec": 9223372036, "nsec": 854775807}


@dataclass
class _Topic:
    name: str
    type_name: str
    qos: Qos
    type_hash: str
    channel: int
    count: int = 0


class Recorder:
    """Write the bag of one trial; leaving its context without `finish` abandons it under its partial name."""

    def __init__(self, path: Path, types: Typestore | None = None) -> None:
        if path.exists():
            raise BagError(f"{path}: exists already")
        self.path = path
        self.partial_path = path.with_name(path.name + PARTIAL)
        self._types = types or jazzy_types()
        self._topics: dict[str, _Topic] = {}
        self._schemas: dict[str, int] = {}
        self._custom: dict[str, str] = {}
        self._first_ns: int | None = None
        self._last_ns = self._flushed_ns = 0
        self._file_name = f"{path.name}_0.mcap"
        with self._failures():
            if self.partial_path.exists():
                shutil.rmtree(self.partial_path)
            self.partial_path.mkdir(parents=True)
            self._stream: BinaryIO = (self.partial_path / self._file_name).open("wb")
            self._writer: Any = Writer(
                self._stream, chunk_size=_CHUNK_BYTES, compression=CompressionType.ZSTD
            )
            self._writer.start(profile="ros2", library=f"barn_eval {__version__}")

    def __enter__(self) -> "Recorder":
        """Return the recorder."""
        return self

    def __exit__(self, *_: object) -> None:
        """Abandon the bag if it has not been finished."""
        self.abandon()

    def knows(self, type_name: str) -> bool:
        """Tell whether messages of a type such as "nav_msgs/msg/Odometry" can be recorded."""
        return type_name in self._types.fielddefs

    def add_topic(
        self, name: str, type_name: str, qos: Qos = RELIABLE, known_as: str = ""
    ) -> None:
        """Announce a topic, and what it is read as if that is not its name; BagError for an unknown or another type."""
        if (known := self._topics.get(name)) is not None:
            if known.type_name != type_name:
                raise BagError(
                    f"{self.path}: topic {name} is recorded as {known.type_name}, not as {type_name}"
                )
            return
        if not self.knows(type_name):
            near = suggest(type_name, self._types.fielddefs)
            raise BagError(f"{self.path}: unknown type {type_name!r} of {name}{near}")
        if type_name not in self._schemas:
            definition, _ = self._types.generate_msgdef(type_name, ros_version=2)
            self._schemas[type_name] = self._writer.register_schema(
                type_name, "ros2msg", definition.encode()
            )
        type_hash = self._types.hash_rihs01(type_name)
        described = {
            "offered_qos_profiles": _yaml([_profile(qos)]),
            "topic_type_hash": type_hash,
        }
        described |= {"known_as": known_as} if known_as else {}
        channel = self._writer.register_channel(
            name, "cdr", self._schemas[type_name], described
        )
        self._topics[name] = _Topic(name, type_name, qos, type_hash, channel)

    def write(self, topic: str, data: bytes, stamp_ns: int) -> None:
        """Write one serialised message (CDR with its header) of a topic announced before."""
        entry = self._topics[topic]
        entry.count += 1
        if self._first_ns is None:
            self._first_ns = self._flushed_ns = stamp_ns
        self._last_ns = max(self._last_ns, stamp_ns)
        try:
            self._writer.add_message(
                entry.channel, stamp_ns, data, stamp_ns, entry.count
            )
            if stamp_ns - self._flushed_ns >= NANOSECONDS_PER_SECOND:
                self._flushed_ns = stamp_ns
                self._writer.flush()
        except OSError:  # `with` would cost some percent of what a message does
            with self._failures():
                raise

    def add_metadata(self, name: str, content: Mapping[str, Any]) -> None:
        """Add a named mapping to the file and to metadata.yaml; values that are not text become JSON."""
        texts = {
            key: value if isinstance(value, str) else json.dumps(value)
            for key, value in content.items()
        }
        with self._failures():
            self._writer.flush()
            self._writer.add_metadata(name, texts)
            self._stream.flush()
        self._custom |= {f"{name}.{key}": value for key, value in texts.items()}

    def finish(self) -> Path:
        """Complete the bag, give it its name and return that."""
        about = self._description()
        with self._failures():
            self._writer.flush()
            self._writer.add_metadata("rosbag2", {"serialized_metadata": _yaml(about)})
            self._writer.finish()
            self._stream.close()
            (self.partial_path / "metadata.yaml").write_text(
                _yaml({"rosbag2_bagfile_information": about}), "utf-8"
            )
            self.partial_path.rename(self.path)
        return self.path

    def abandon(self) -> None:
        """Leave what has been written under the partial name; nothing if the bag is finished."""
        if not self._stream.closed:
            with self._failures():
                self._writer.flush()
                self._stream.close()

    def _failures(self) -> AbstractContextManager[None]:
        return convert_os_errors(BagError, f"{self.partial_path}: cannot record")

    def _description(self) -> dict[str, Any]:
        first_ns = self._first_ns or 0
        start, lasted = (
            {"nanoseconds_since_epoch": first_ns},
            {"nanoseconds": self._last_ns - first_ns},
        )
        count = sum(topic.count for topic in self._topics.values())
        return {
            "version": METADATA_VERSION,
            "storage_identifier": "mcap",
            "duration": lasted,
            "starting_time": start,
            "message_count": count,
            "topics_with_message_count": [
                _topic_entry(topic) for topic in self._topics.values()
            ],
            "compression_format": "",
            "compression_mode": "",
            "relative_file_paths": [self._file_name],
            "files": [
                {
                    "path": self._file_name,
                    "starting_time": start,
                    "duration": lasted,
                    "message_count": count,
                }
            ],
            "custom_data": dict(self._custom),
            "ros_distro": "jazzy",
        }


def _profile(qos: Qos) -> dict[str, Any]:
    """Return a quality of service as metadata.yaml has it."""
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


def _topic_entry(topic: _Topic) -> dict[str, Any]:
    about: dict[str, Any] = {
        "name": topic.name,
        "type": topic.type_name,
        "serialization_format": "cdr",
    }
    about |= {
        "offered_qos_profiles": [_profile(topic.qos)],
        "type_description_hash": topic.type_hash,
    }
    return {"topic_metadata": about, "message_count": topic.count}


def _yaml(content: object) -> str:
    plain = json.loads(
        json.dumps(content)
    )  # nothing in it twice, for which there would be anchors
    return str(
        yaml.dump(
            plain, Dumper=_Dumper, sort_keys=False, allow_unicode=True, width=10_000
        )
    )
