"""Decoders against messages that rosbags makes: all that a message carries, whoever sends it, and no crash.

That bytes of rosbags are those of ROS is for test_messages_encode.
"""

import math
import struct

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from refusals import refused

from barn_worlds.base.errors import MessageError
from barn_worlds.base.types import (
    OccupancyMap,
    Odometry,
    Pose2D,
    Scan,
    Velocity2D,
    yaw_from_quaternion,
)
from barn_worlds.messages import decode, encode
from barn_worlds.messages.cdr import deserialize, make_message, serialize
from barn_worlds.messages.encode import make_header

meters = st.floats(-1e3, 1e3)
stamps = st.integers(0, 2**31 * 10**9 - 1)
frames = st.text(st.characters(codec="utf-8", exclude_characters="\0"), max_size=20)
poses = st.builds(Pose2D, meters, meters, st.floats(-math.pi, math.pi))
velocities = st.builds(Velocity2D, meters, meters)

POSE = Pose2D(-2.25, 3.1, 1.57)
SCAN = Scan(
    5, np.array([1.5, np.inf, -np.inf, np.nan], np.float32), -1.0, 0.5, 0.125, 30.0
)
GRID = OccupancyMap(np.arange(6, dtype=np.int8).reshape(2, 3), 0.25, -4.5, 0.0)
# One message of every type that is decoded, by the name of its type.
SAMPLES = {
    "rosgraph_msgs/msg/Clock": (decode.clock, encode.encode_clock(7)),
    "std_msgs/msg/Bool": (decode.boolean, encode.encode_bool(True)),
    "std_msgs/msg/Float64": (decode.number, encode.encode_number(0.5)),
    "std_msgs/msg/String": (decode.text, encode.encode_text("running")),
    "geometry_msgs/msg/Twist": (
        decode.twist,
        encode.encode_twist(Velocity2D(0.4, -1.1)),
    ),
    "geometry_msgs/msg/TwistStamped": (
        decode.twist_stamped,
        encode.TwistStampedEncoder("base_link").encode(Velocity2D(0.4, -1.1), 7),
    ),
    "geometry_msgs/msg/PoseStamped": (
        decode.pose,
        encode.PoseStampedEncoder("map").encode(POSE, 7),
    ),
    "geometry_msgs/msg/PoseWithCovarianceStamped": (
        decode.pose_with_covariance,
        encode.PoseWithCovarianceEncoder("map").encode(POSE, 7),
    ),
    "nav_msgs/msg/Odometry": (
        decode.odometry,
        encode.OdometryEncoder("odom", "base_link").encode(
            Odometry(7, POSE, Velocity2D(0.4, -1.1)), 7
        ),
    ),
    "sensor_msgs/msg/LaserScan": (
        decode.scan,
        encode.ScanEncoder(SCAN, "lidar_link", 0.05).encode(SCAN, 5),
    ),
    "nav_msgs/msg/OccupancyGrid": (
        decode.occupancy_map,
        encode.encode_map(GRID, 7, "map"),
    ),
    "nav_msgs/msg/Path": (
        decode.path,
        encode.PathEncoder("odom").encode(np.array([[0.0, 1.0], [2.0, 3.0]]), 7),
    ),
    "tf2_msgs/msg/TFMessage": (
        decode.transforms,
        encode.TransformEncoder([("map", "odom")]).encode([POSE], 7),
    ),
    "diagnostic_msgs/msg/DiagnosticArray": (
        decode.diagnostics,
        encode.encode_diagnostics(
            7, encode.FINE, "planner", "running", {"status": "running"}
        ),
    ),
}


def content(value):
    """Return what is compared: arrays as bytes, since NaN equals nothing."""
    if isinstance(value, np.ndarray):
        return value.dtype, value.shape, value.tobytes()
    if isinstance(value, (Scan, OccupancyMap)):
        return [content(getattr(value, name)) for name in value.__slots__]
    return value


def tilted(yaw):
    """Return a pose at the origin, turned."""
    pose = make_message("geometry_msgs/msg/Pose")
    pose.orientation.z, pose.orientation.w = math.sin(0.5 * yaw), math.cos(0.5 * yaw)
    return pose


@given(stamps, frames, frames, poses, velocities)
def test_odometry_of_whatever_frames(stamp_ns, frame, child, pose, velocity):
    data = encode.OdometryEncoder(frame, child).encode(
        Odometry(stamp_ns, pose, velocity), stamp_ns
    )
    message = deserialize(data, "nav_msgs/msg/Odometry")
    message.pose.covariance = message.twist.covariance = np.arange(36.0)
    message.twist.twist.linear.y = 5.0
    for sent in (data, serialize(message)):
        assert decode.odometry(sent) == Odometry(
            stamp_ns, pose.through_quaternion(), velocity
        )
        assert decode.header(sent) == (stamp_ns, frame)
    assert decode.clock(encode.encode_clock(stamp_ns)) == stamp_ns


@given(stamps, frames, poses, st.tuples(*[st.floats(-1.0, 1.0)] * 4))
def test_poses_of_robots_that_stand_or_are_tilted(stamp_ns, frame, pose, turn):
    for decoder, encoder in (
        (decode.pose, encode.PoseStampedEncoder(frame)),
        (
            decode.pose_with_covariance,
            encode.PoseWithCovarianceEncoder(frame, (1.0, 2.0, 3.0)),
        ),
    ):
        data = encoder.encode(pose, stamp_ns)
        assert decoder(data) == pose.through_quaternion()
        assert math.isclose(math.cos(decoder(data).yaw - pose.yaw), 1.0, abs_tol=1e-12)
        assert decode.header(data) == (stamp_ns, frame)
    message = make_message("geometry_msgs/msg/PoseStamped")
    at = message.pose.orientation
    at.x, at.y, at.z, at.w = turn
    assert decode.pose(serialize(message)).yaw == yaw_from_quaternion(*turn)


@given(frames, velocities)
def test_either_kind_of_command_is_read(frame, velocity):
    for type_name, data in (
        ("geometry_msgs/msg/Twist", encode.encode_twist(velocity)),
        (
            "geometry_msgs/msg/TwistStamped",
            encode.TwistStampedEncoder(frame).encode(velocity, 7),
        ),
    ):
        message = deserialize(data, type_name)
        twist = getattr(message, "twist", message)
        twist.linear.y = twist.angular.x = 9.0
        assert decode.command(data, type_name) == velocity
        assert decode.command(serialize(message), type_name) == velocity
        assert not decode.command(data[:9], type_name).is_finite()


@given(
    stamps,
    frames,
    st.lists(st.floats(width=32), max_size=30),
    st.lists(st.floats(0.0, 9.0, width=32), max_size=3),
)
def test_scans_keep_every_bit(stamp_ns, frame, values, intensities):
    sent = Scan(stamp_ns, np.array(values, np.float32), -1.0, 0.5, 0.125, 30.0)
    data = encode.ScanEncoder(sent, frame, 0.05).encode(sent, stamp_ns)
    message = deserialize(data, "sensor_msgs/msg/LaserScan")
    message.intensities = np.array(intensities, np.float32)
    data = serialize(message)
    scan = decode.scan(data)
    assert content(scan) == content(sent)
    assert scan.ranges.flags.writeable and scan.ranges.flags.aligned
    assert scan.ranges.dtype.isnative
    assert decode.header(data).frame == frame
    assert message.angle_max == pytest.approx(-1.0 + 0.5 * (len(values) - 1))


@given(st.tuples(st.integers(0, 9), st.integers(0, 9)), meters, meters)
def test_maps(size, x, y):
    cells = np.arange(size[0] * size[1], dtype=np.int8).reshape(size)
    sent = OccupancyMap(cells, 0.25, x, y)
    grid_map = decode.occupancy_map(encode.encode_map(sent, 7, "map"))
    assert content(grid_map) == content(sent)
    assert grid_map.data.flags.writeable


@pytest.mark.parametrize(
    "field, value, message",
    [
        ("width", 4, "data must have 2 x 4 cells, got 6"),
        ("origin", tilted(0.5), "origin must not be rotated, got a yaw of 0.5 rad"),
    ],
)
def test_a_map_of_a_wrong_size_or_rotated_is_refused(field, value, message):
    type_name = "nav_msgs/msg/OccupancyGrid"
    grid = deserialize(SAMPLES[type_name][1], type_name)
    setattr(grid.info, field, value)
    with refused(f"^map {message}$", MessageError):
        decode.occupancy_map(serialize(grid))


@given(st.booleans(), st.floats(), frames)
def test_single_values(touched, value, text):
    assert decode.boolean(encode.encode_bool(touched)) is touched
    number = decode.number(encode.encode_number(value))
    assert content(np.array(number)) == content(np.array(value))
    assert decode.text(encode.encode_text(text)) == text


@pytest.mark.parametrize(
    "points", [np.zeros((0, 2)), np.array([[0.0, 1.0, 1.0], [2.0, 3.0, 0.5]])]
)
def test_paths(points):
    data = encode.PathEncoder("map").encode(points, 9)
    np.testing.assert_array_equal(decode.path(data), points[:, :2])


def test_markers_are_discs_and_lines_where_they_are_to_be_drawn():
    def marker(kind, action=encode.ADD, x=0.0, points=()):
        message = encode.make_marker("odom", "some", kind, action=action)
        message.scale.x = 0.5
        message.pose = tilted(0.5 * math.pi)
        message.pose.position.x = x
        message.points = [make_message("geometry_msgs/msg/Point", x=x) for x in points]
        return message

    markers = [
        marker(encode.CYLINDER, encode.DELETE_ALL),
        marker(encode.CYLINDER, x=1.0),
        marker(encode.SPHERE, x=2.0),
        marker(encode.LINE_STRIP, points=[1.0, 2.0, 3.0]),
        marker(encode.LINE_LIST, points=[1.0, 2.0, 3.0]),  # half a line at its end
        marker(encode.CUBE),
    ]
    message = make_message("visualization_msgs/msg/MarkerArray", markers=markers)
    shapes = decode.markers(serialize(message))
    assert shapes.frame == "odom"
    assert shapes.discs.tolist() == [[1.0, 0.0, 0.25], [2.0, 0.0, 0.25]]
    strip, line = shapes.lines
    assert len(line) == 2
    np.testing.assert_allclose(strip, [[0.0, 1.0], [0.0, 2.0], [0.0, 3.0]], atol=1e-12)


def test_transforms_and_diagnostics():
    encoder = encode.TransformEncoder([("map", "odom"), ("odom", "base_link")])
    sent = encoder.encode([POSE, Pose2D(1.0, 2.0, 0.0)], 12_000_000_345)
    assert [transform[:3] for transform in decode.transforms(sent)] == [
        ("map", "odom", POSE.through_quaternion()),
        ("odom", "base_link", Pose2D(1.0, 2.0, 0.0)),
    ]
    for transform in deserialize(sent, encoder.type_name).transforms:
        stamp = transform.header.stamp
        assert (stamp.sec, stamp.nanosec) == (12, 345)
    values = {"status": "blocked", "cost": "1.5"}
    data = encode.encode_diagnostics(7, encode.FINE, "planner", "", values)
    assert decode.diagnostics(data) == [values]


def refusal(decoder, data, expected=None):
    """Return the error message for bytes, or "" if they are read; compare their content with `expected`, if given."""
    try:
        decoded = content(decoder(data))
    except MessageError as error:
        assert str(error)
        return str(error)
    assert expected is None or decoded == expected
    return ""


@pytest.mark.parametrize("type_name", list(SAMPLES))
def test_every_length_that_is_too_short_is_refused(type_name):
    """A message that ends anywhere within what is read of it; what follows that is not looked at."""
    decoder, data = SAMPLES[type_name]
    whole = content(decoder(data))
    refusals = [refusal(decoder, data[:length], whole) for length in range(len(data))]
    assert all(refusals[:9])
    assert {len(text.splitlines()) for text in refusals} <= {0, 1}


@pytest.mark.parametrize("type_name", list(SAMPLES))
@settings(max_examples=60, deadline=None)
@given(damage=st.data())
def test_malformed_bytes_raise_only_refusals(type_name, damage):
    decoder, data = SAMPLES[type_name]
    length = damage.draw(st.integers(0, len(data)))
    broken = bytearray(data[:length])
    for _ in range(damage.draw(st.integers(0, 8)) if broken else 0):
        place = damage.draw(st.integers(0, length - 1))
        broken[place] = damage.draw(st.sampled_from([0, 1, 127, 128, 255]))
    for read in (decoder, decode.header):
        assert len(refusal(read, bytes(broken)).splitlines()) <= 1


def test_a_length_of_four_gigabytes_takes_no_memory():
    data = bytearray(encode.encode_text("running"))
    struct.pack_into("<I", data, 4, 2**32 - 1)
    with refused("std_msgs/msg/String", MessageError):
        decode.text(bytes(data))
    data = serialize(make_header("odom", 7))
    with refused("not a message of type std_msgs/msg/Header", MessageError):
        decode.header(data[:12] + b"\xff" * 4 + data[16:])


def test_other_encodings_are_named():
    _, data = SAMPLES["geometry_msgs/msg/Twist"]
    for first in (b"\0\7", b"\0\0"):  # parameter lists, big-endian
        message = rf"^not a message of type .*/Twist in plain CDR, .* 0x{first.hex()}$"
        with refused(message, MessageError):
            decode.twist(first + data[2:])


def test_a_frame_that_is_no_text_is_read_as_ros_reads_it():
    data = serialize(make_header("abcd", 7)).replace(b"abcd", b"a\xffcd")
    assert decode.header(data).frame == "a\ufffdcd"
