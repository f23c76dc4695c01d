"""MCAP files of others: what their chunks unpack to is bounded by what they state, and that by what there is."""

import zlib
from io import BytesIO

import lz4.frame
import pytest
import zstandard
from mcap.data_stream import RecordBuilder
from mcap.records import Chunk
from mcap.writer import CompressionType, Writer

from barn_eval.bags.bagfile import BagFile

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
@pytest.mark.parametrize(("size", "stated"), [(50_000_000, 100), (100, 50_000_000), (100, 1 << 40), (5_000, 4_999)])
def test_a_chunk_that_is_not_what_it_states_ends_the_reading(tmp_path, compression, size, stated):
    file = BagFile(with_chunk(tmp_path / "bomb.mcap", compression, bytes(size), stated))
    assert list(file.messages()) == []
    assert file.problem.startswith("the bag is damaged after 0.00 s (a chunk ")
    assert len(file.problem) < 120


def test_a_chunk_of_almost_nothing_is_not_unpacked(tmp_path, monkeypatch):
    size = 20_000_000
    file = BagFile(with_chunk(tmp_path / "bomb.mcap", "zstd", bytes(size), size))
    monkeypatch.delattr("barn_eval.bags.bagfile.ZstdDecompressor")
    assert list(file.messages()) == []
    assert f"a chunk of {size} bytes in " in file.problem


@pytest.mark.parametrize("compression", CompressionType)
def test_whatever_a_chunk_is_packed_with_its_messages_are_read(tmp_path, compression):
    path = tmp_path / "good.mcap"
    with path.open("wb") as stream:
        writer = Writer(stream, compression=compression)
        writer.start()
        schema = writer.register_schema("std_msgs/msg/String", "ros2msg", b"string data")
        channel = writer.register_channel("/words", "cdr", schema)
        for time in range(200):
            writer.add_message(channel, time, b"\0\1\0\0" + bytes(1000), time)
        writer.finish()
    file = BagFile(path)
    assert [(one.topic, one.stamp_ns, len(one.data)) for one in file.messages()] == [
        ("/words", time, 1004) for time in range(200)
    ]
    assert file.problem == ""
