"""Bags as other recorders write them, made of one of the suite's."""

from dataclasses import replace
from pathlib import Path

from rosbags.rosbag1 import Writer as Rosbag1Writer
from rosbags.rosbag2 import CompressionFormat, CompressionMode, StoragePlugin, Writer
from rosbags.typesys import Stores, get_typestore
from rosbags.typesys.msg import get_types_from_msg

from barn_eval.results.bags.bagfile import BagFile
from barn_worlds.messages.cdr import deserialize, jazzy_types, serialize

EPOCH_NS = 1_700_000_000_000_000_000
FORMATS = {
    "sqlite": {"storage_plugin": StoragePlugin.SQLITE3},
    "mcap": {"storage_plugin": StoragePlugin.MCAP},
}
COMPRESSIONS = {"file": CompressionMode.FILE, "message": CompressionMode.MESSAGE}


def messages_of(bag, change=lambda message: message):
    """The messages of a bag, changed; None leaves one out."""
    return [m for m in map(change, BagFile(Path(bag)).messages()) if m is not None]


def write_bag(path, messages, format="mcap", compression=""):
    """Write messages with rosbags, of ROS 1 for the format ros1; return the path."""
    path.parent.mkdir(parents=True, exist_ok=True)
    if format == "ros1":
        return _write_ros1(path, messages)
    writer = Writer(path, version=9, **FORMATS[format])
    if compression:
        writer.set_compression(COMPRESSIONS[compression], CompressionFormat.ZSTD)
    _write_messages(writer, messages, jazzy_types())
    return path


def _write_ros1(path, messages):
    types = get_typestore(Stores.ROS1_NOETIC)
    types.register(
        get_types_from_msg(
            "geometry_msgs/TransformStamped[] transforms", "tf2_msgs/msg/TFMessage"
        )
    )
    converted = []
    for message in messages:
        data = jazzy_types().cdr_to_ros1(message.data, message.type_name)
        stamp_ns = message.stamp_ns + 10**9
        converted.append(replace(message, stamp_ns=stamp_ns, data=bytes(data)))
    _write_messages(Rosbag1Writer(path), converted, types)
    return path


def _write_messages(writer, messages, types):
    connections = {}
    with writer:
        for message in messages:
            if message.topic not in connections:
                connections[message.topic] = writer.add_connection(
                    message.topic, message.type_name, typestore=types
                )
            writer.write(connections[message.topic], message.stamp_ns, message.data)


def in_namespace(message):
    if message.topic in ("/tf", "/tf_static"):
        return message
    return replace(message, topic=f"/robot1{message.topic}")


def at_half_real_time(message):
    """Simulated stamps in a log of the wall clock, at half real time."""
    return replace(message, stamp_ns=EPOCH_NS + 2 * message.stamp_ns)


def edited(message, edit):
    """A message after a function has changed it as an object."""
    content = deserialize(message.data, message.type_name)
    edit(content)
    return replace(message, data=serialize(content))
