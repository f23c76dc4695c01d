"""Bags: what is in them, that other readers take them, what a kill leaves, and MCAP
files of others that lie.
"""

import os
import signal
import zlib
from contextlib import suppress
from io import BytesIO
from multiprocessing import get_context

import lz4.frame
import pytest
import yaml
import zstandard
from child_work import record_and_die
from mcap.data_stream import ReadDataStream, RecordBuilder
from mcap.exceptions import EndOfFile
from mcap.opcode import Opcode
from mcap.reader import make_reader
from mcap.records import Chunk, Message, MessageIndex
from mcap.stream_reader import StreamReader
from mcap.writer import CompressionType, Writer
from refusals import refused
from rosbags.rosbag2 import Reader

from barn_eval.results.bags.bagfile import BagFile
from barn_eval.results.bags.recorder import PARTIAL, Recorder
from barn_worlds.base.errors import BagError
from barn_worlds.base.types import NANOSECONDS_PER_SECOND, Velocity2D
from barn_worlds.messages.cdr import deserialize
from barn_worlds.messages.encode import (
    BOOL_LAYOUT,
    CLOCK_LAYOUT,
    encode_bool,
    encode_clock,
    encode_twist,
)
from barn_worlds.messages.topics import CLOCK, CMD_VEL, COLLISION, LATCHED

PERIOD_NS = 50_000_000


def record(path, cycles=50):
    with Recorder(path) as recorder:
        recorder.add_topic("/clock", CLOCK.type_name)
        recorder.add_topic("/cmd_vel", CMD_VEL.type_name, LATCHED)
        for cycle in range(cycles):
            recorder.write("/clock", encode_clock(cycle * PERIOD_NS), cycle * PERIOD_NS)
            recorder.write(
                "/cmd_vel",
                encode_twist(Velocity2D(0.1 * cycle, -1.0)),
                cycle * PERIOD_NS,
            )
        recorder.add_metadata(
            "barn.result", {"outcome": "success", "scores": {"time_s": 1.5}}
        )
        return recorder.finish()


def test_rosbags_reads_it(tmp_path):
    with Reader(record(tmp_path / "bag")) as reader:
        assert reader.message_count == 100
        assert (reader.start_time, reader.duration) == (0, 49 * PERIOD_NS + 1)
        commands = [
            connection
            for connection in reader.connections
            if connection.topic == "/cmd_vel"
        ]
        twists = [
            deserialize(data, CMD_VEL.type_name)
            for _, _, data in reader.messages(commands)
        ]
        assert [twist.linear.x for twist in twists] == [
            0.1 * cycle for cycle in range(50)
        ]
        profiles = {
            connection.topic: connection.ext.offered_qos_profiles[0]
            for connection in reader.connections
        }
    durabilities = {
        topic: profile.durability.name for topic, profile in profiles.items()
    }
    assert durabilities == {"/cmd_vel": "TRANSIENT_LOCAL", "/clock": "VOLATILE"}


def test_mcap_reads_it_with_schemas_metadata_and_index(tmp_path):
    path = record(tmp_path / "bag")
    with (path / "bag_0.mcap").open("rb") as file:
        reader = make_reader(file, validate_crcs=True)
        assert reader.get_header().profile == "ros2"
        summary = reader.get_summary()
        assert summary.statistics.message_count == 100
        assert {schema.encoding for schema in summary.schemas.values()} == {"ros2msg"}
        channels = {channel.topic: channel for channel in summary.channels.values()}
        assert channels["/clock"].message_encoding == "cdr"
        assert channels["/clock"].metadata["topic_type_hash"].startswith("RIHS01_")
        profile = yaml.safe_load(channels["/cmd_vel"].metadata["offered_qos_profiles"])[
            0
        ]
        assert (profile["reliability"], profile["durability"]) == (
            "reliable",
            "transient_local",
        )
        metadata = {record.name: record.metadata for record in reader.iter_metadata()}
        assert metadata["barn.result"] == {
            "outcome": "success",
            "scores": '{"time_s": 1.5}',
        }
        stamps = [
            message.log_time
            for _, _, message in reader.iter_messages(topics=["/clock"])
        ]
        assert stamps == [cycle * PERIOD_NS for cycle in range(50)]


def test_a_block_is_its_messages_one_by_one(tmp_path):
    stamps = [0, 400_000_000, 1_100_000_000]
    layouts = [(CLOCK, CLOCK_LAYOUT), (COLLISION, BOOL_LAYOUT)]
    with Recorder(tmp_path / "block") as recorder:
        block = recorder.prepare_block(layouts)
        for stamp in stamps:
            recorder.write_block(block, [divmod(stamp, 10**9), (stamp > 0,)], stamp)
        block_path = recorder.finish()
    with Recorder(tmp_path / "single") as recorder:
        for topic, _ in layouts:
            recorder.announce(topic)
        for stamp in stamps:
            recorder.write("/clock", encode_clock(stamp), stamp)
            recorder.write("/collision", encode_bool(stamp > 0), stamp)
        single_path = recorder.finish()
    block_file = block_path / "block_0.mcap"
    messages = partial_messages(block_file)
    assert messages == partial_messages(single_path / "single_0.mcap")
    assert [message.sequence for message in messages] == [1, 1, 2, 2, 3, 3]


def test_indexes_lead_to_the_messages(tmp_path):
    path = record(tmp_path / "bag") / "bag_0.mcap"
    with path.open("rb") as file:
        records = list(StreamReader(file, emit_chunks=True).records)
        file.seek(0)
        indexes = make_reader(file).get_summary().chunk_indexes
    content = b""
    entries = 0
    for item in records:
        if isinstance(item, Chunk):
            content = zstandard.decompress(item.data)
        if isinstance(item, MessageIndex):
            for stamp, offset in item.records:
                size = int.from_bytes(content[offset + 1 : offset + 9], "little")
                stream = ReadDataStream(BytesIO(content[offset + 9 :]))
                message = Message.read(stream, size)
                assert (message.channel_id, message.log_time) == (
                    item.channel_id,
                    stamp,
                )
                entries += 1
    assert entries == 100
    data = path.read_bytes()
    for index in indexes:
        assert data[index.chunk_start_offset] == Opcode.CHUNK
        for place in index.message_index_offsets.values():
            assert data[place] == Opcode.MESSAGE_INDEX


def test_metadata_file_has_what_rosbag2_wants(tmp_path):
    metadata = yaml.safe_load((record(tmp_path / "bag") / "metadata.yaml").read_text())[
        "rosbag2_bagfile_information"
    ]
    assert (
        metadata["version"],
        metadata["storage_identifier"],
        metadata["ros_distro"],
    ) == (9, "mcap", "jazzy")
    assert metadata["relative_file_paths"] == ["bag_0.mcap"]
    assert metadata["duration"] == {"nanoseconds": 49 * PERIOD_NS}
    assert metadata["files"][0]["message_count"] == metadata["message_count"] == 100
    assert metadata["custom_data"]["barn.result.outcome"] == "success"
    topics = {
        topic["topic_metadata"]["name"]: topic
        for topic in metadata["topics_with_message_count"]
    }
    assert topics["/clock"]["message_count"] == 50
    assert topics["/clock"]["topic_metadata"]["type"] == "rosgraph_msgs/msg/Clock"


def test_a_bag_has_its_name_only_when_it_is_whole(tmp_path):
    path = tmp_path / "bag"
    with pytest.raises(RuntimeError, match="planner"), Recorder(path) as recorder:
        recorder.add_topic("/clock", CLOCK.type_name)
        recorder.write("/clock", encode_clock(5), 5)
        raise RuntimeError("planner")
    assert not path.exists()
    assert len(partial_messages(tmp_path / f"bag{PARTIAL}" / "bag_0.mcap")) == 1


def test_what_a_kill_leaves_is_replaced(tmp_path):
    left = tmp_path / f"bag{PARTIAL}"
    left.mkdir()
    (left / "bag_0.mcap").write_bytes(b"half")
    record(tmp_path / "bag")
    assert sorted(path.name for path in tmp_path.iterdir()) == ["bag"]


def test_an_existing_bag_is_not_touched(tmp_path):
    path = record(tmp_path / "bag")
    before = (path / "bag_0.mcap").read_bytes()
    with refused("exists already", BagError):
        Recorder(path)
    assert (path / "bag_0.mcap").read_bytes() == before


def test_a_topic_has_one_known_type(tmp_path):
    with Recorder(tmp_path / "bag") as recorder:
        recorder.add_topic("/clock", CLOCK.type_name)
        with refused("recorded as rosgraph_msgs/msg/Clock", BagError):
            recorder.add_topic("/clock", CMD_VEL.type_name)
        with refused(
            "unknown type 'geometry_msgs/msg/Twits' of /cmd_vel; did you mean 'geometry_msgs/msg/Twist'",
            BagError,
        ):
            recorder.add_topic("/cmd_vel", "geometry_msgs/msg/Twits")


def test_a_folder_that_cannot_be_written_is_named(tmp_path):
    (tmp_path / "file").write_text("")
    with refused("cannot record: Not a directory", BagError):
        Recorder(tmp_path / "file" / "bag")


def test_a_full_disk_is_told_in_one_line(tmp_path):
    """Every write to /dev/full fails as on a full disk."""
    recorder = Recorder(tmp_path / "bag")
    recorder.add_topic("/clock", CLOCK.type_name)
    full = os.open("/dev/full", os.O_WRONLY)
    os.dup2(full, recorder._stream.fileno())
    os.close(full)
    with refused("cannot record: No space left on device", BagError):
        for cycle in range(100):
            recorder.write("/clock", encode_clock(cycle), cycle * PERIOD_NS)
    assert not (tmp_path / "bag").exists()


def partial_messages(path):
    """Return what can be read of a file that ends anywhere."""
    messages = []
    with path.open("rb") as file, suppress(EndOfFile):
        messages += (
            record
            for record in StreamReader(file, skip_magic=False).records
            if isinstance(record, Message)
        )
    return messages


def test_a_killed_recording_is_readable_up_to_the_last_second(tmp_path):
    child = get_context("spawn").Process(
        target=record_and_die, args=(tmp_path / "bag",)
    )
    child.start()
    child.join()
    assert child.exitcode == -signal.SIGKILL
    messages = partial_messages(tmp_path / f"bag{PARTIAL}" / "bag_0.mcap")
    # 205 cycles of 0.05 s are 10.2 s; a chunk is written with each whole second.
    assert len(messages) == 201
    assert messages[-1].log_time == 10 * NANOSECONDS_PER_SECOND
    assert deserialize(messages[-1].data, CLOCK.type_name).clock.sec == 10


PACKED = {"zstd": zstandard.compress, "lz4": lz4.frame.compress, "": bytes}


def with_chunk(path, compression, content, stated):
    """Write a file of one chunk that states a size for its content."""
    file = BytesIO()
    writer = Writer(file)
    writer.start()
    builder = RecordBuilder()
    packed = PACKED[compression](content)
    Chunk(compression, packed, 1, 1, zlib.crc32(content), stated).write(builder)
    path.write_bytes(file.getvalue() + builder.end())
    return path


@pytest.mark.parametrize("compression", PACKED)
@pytest.mark.parametrize(
    "size, stated",
    [(50_000_000, 100), (100, 50_000_000), (100, 1 << 40), (5_000, 4_999)],
)
def test_a_chunk_that_is_not_what_it_states_ends_the_reading(
    tmp_path, compression, size, stated
):
    file = BagFile(with_chunk(tmp_path / "bomb.mcap", compression, bytes(size), stated))
    assert list(file.messages()) == []
    assert file.problem.startswith("the bag is damaged after 0.00 s (a chunk ")
    assert len(file.problem) < 120


def test_a_chunk_of_almost_nothing_is_not_unpacked(tmp_path, monkeypatch):
    size = 20_000_000
    file = BagFile(with_chunk(tmp_path / "bomb.mcap", "zstd", bytes(size), size))
    monkeypatch.delattr("barn_eval.results.bags.bagfile.ZstdDecompressor")
    assert list(file.messages()) == []
    assert f"a chunk of {size} bytes in " in file.problem


def words_of(path, compression):
    """Write 200 messages and return what is read of the file."""
    with path.open("wb") as stream:
        writer = Writer(stream, compression=compression)
        writer.start()
        schema = writer.register_schema(
            "std_msgs/msg/String", "ros2msg", b"string data"
        )
        channel = writer.register_channel("/words", "cdr", schema)
        for time in range(200):
            writer.add_message(channel, time, b"\0\1\0\0" + bytes(1000), time)
        writer.finish()
    return BagFile(path)


def test_a_chunk_that_does_not_fit_its_checksum_ends_the_reading(tmp_path):
    words_of(tmp_path / "good.mcap", CompressionType.NONE)
    content = (tmp_path / "good.mcap").read_bytes()
    (tmp_path / "bad.mcap").write_bytes(
        content.replace(bytes(1000), b"\1" + bytes(999), 1)
    )
    file = BagFile(tmp_path / "bad.mcap")
    assert list(file.messages()) == []
    assert file.problem.startswith("the bag is damaged after 0.00 s")


@pytest.mark.parametrize("compression", CompressionType)
def test_whatever_a_chunk_is_packed_with_its_messages_are_read(tmp_path, compression):
    file = words_of(tmp_path / "good.mcap", compression)
    assert [
        (message.topic, message.stamp_ns, len(message.data))
        for message in file.messages()
    ] == [("/words", time, 1004) for time in range(200)]
    assert file.problem == ""
