"""Decoders against ROS's own serialiser and rosbags: all that a message carries, whoever sends it, and no crash."""

import math
import struct

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

pytest.importorskip("rclpy", reason="ROS 2 is not installed")

import ros_messages as convert
from diagnostic_msgs.msg import DiagnosticArray, DiagnosticStatus, KeyValue
from geometry_msgs.msg import Point, Pose, Quaternion, Vector3
from rclpy.serialization import serialize_message
from rosgraph_msgs.msg import Clock
from std_msgs.msg import Bool, Float64, String
from visualization_msgs.msg import Marker, MarkerArray

from barn_worlds.base.errors import MessageError
from barn_worlds.base.types import OccupancyMap, Odometry, Pose2D, Scan, Velocity2D
from barn_worlds.messages import decode, encode

metres = st.floats(-1e3, 1e3)
yaws = st.floats(-math.pi, math.pi)
stamps = st.integers(0, 2**31 * 10**9 - 1)
frames = st.text(st.characters(codec="utf-8", exclude_characters="\0"), max_size=20)
poses = st.builds(Pose2D, metres, metres, yaws)
velocities = st.builds(Velocity2D, metres, metres)
cells = st.tuples(st.integers(0, 9), st.integers(0, 9)).map(lambda size: np.arange(size[0] * size[1]).reshape(size))
ranges = st.lists(st.floats(width=32), max_size=30).map(lambda values: np.array(values, np.float32))

POSE = Pose2D(-2.25, 3.1, 1.57)
SCAN = Scan(5, np.array([1.5, np.inf, -np.inf, np.nan], np.float32), -1.0, 0.5, 0.125, 30.0)
GRID = OccupancyMap(np.arange(6, dtype=np.int8).reshape(2, 3), 0.25, -4.5, 0.0)
# One message of every type that is decoded, by the name of its type.
SAMPLES = {
    "rosgraph_msgs/msg/Clock": (decode.clock, encode.encode_clock(7)),
    "std_msgs/msg/Bool": (decode.boolean, encode.encode_bool(True)),
    "std_msgs/msg/Float64": (decode.number, encode.encode_number(0.5)),
    "std_msgs/msg/String": (decode.text, encode.encode_text("running")),
    "geometry_msgs/msg/Twist": (decode.twist, encode.encode_twist(Velocity2D(0.4, -1.1))),
    "geometry_msgs/msg/TwistStamped": (
        decode.twist_stamped,
        encode.TwistStampedEncoder("base_link").encode(Velocity2D(0.4, -1.1), 7),
    ),
    "geometry_msgs/msg/PoseStamped": (decode.pose, encode.PoseStampedEncoder("map").encode(POSE, 7)),
    "geometry_msgs/msg/PoseWithCovarianceStamped": (
        decode.pose_with_covariance,
        encode.PoseWithCovarianceEncoder("map").encode(POSE, 7),
    ),
    "nav_msgs/msg/Odometry": (
        decode.odometry,
        encode.OdometryEncoder("odom", "base_link").encode(Odometry(7, POSE, Velocity2D(0.4, -1.1)), 7),
    ),
    "sensor_msgs/msg/LaserScan": (decode.scan, encode.ScanEncoder(SCAN, "lidar_link", 0.05).encode(SCAN, 5)),
    "nav_msgs/msg/OccupancyGrid": (decode.occupancy_map, encode.encode_map(GRID, 7, "map")),
    "nav_msgs/msg/Path": (decode.path, encode.PathEncoder("odom").encode(np.array([[0.0, 1.0], [2.0, 3.0]]), 7)),
    "tf2_msgs/msg/TFMessage": (decode.transforms, encode.TransformEncoder([("map", "odom")]).encode([POSE], 7)),
    "diagnostic_msgs/msg/DiagnosticArray": (
        decode.diagnostics,
        encode.encode_diagnostics(7, encode.FINE, "planner", "running", {"status": "running"}),
    ),
}


def content(value):
    """Return what is compared: arrays as bytes, since NaN equals nothing."""
    if isinstance(value, np.ndarray):
        return value.dtype, value.shape, value.tobytes()
    if isinstance(value, (Scan, OccupancyMap)):
        return [content(getattr(value, name)) for name in value.__slots__]
    return value


@given(stamps, frames)
def test_headers(stamp_ns, frame):
    data = serialize_message(convert.to_header(stamp_ns, frame))
    assert decode.header(data) == (stamp_ns, frame)
    assert decode.clock(serialize_message(Clock(clock=convert.to_time(stamp_ns)))) == stamp_ns


@given(stamps, frames, frames, poses, velocities)
def test_odometry_of_whatever_frames(stamp_ns, frame, child, pose, velocity):
    sent = Odometry(stamp_ns, pose, velocity)
    message = convert.to_odometry(sent, frame, child)
    message.pose.covariance[:] = message.twist.covariance[:] = np.arange(36.0)
    message.twist.twist.linear.y = 5.0
    data = serialize_message(message)
    assert decode.odometry(data) == convert.from_odometry(message)
    assert decode.odometry(data) == Odometry(stamp_ns, pose.through_quaternion(), velocity)
    assert decode.header(data).frame == frame


@given(stamps, frames, poses)
def test_poses(stamp_ns, frame, pose):
    for decoder, message in (
        (decode.pose, convert.to_pose_stamped(pose, stamp_ns, frame)),
        (decode.pose_with_covariance, convert.to_pose_with_covariance(pose, stamp_ns, frame, (1.0, 2.0, 3.0))),
    ):
        data = serialize_message(message)
        assert decoder(data) == pose.through_quaternion()
        assert math.isclose(math.cos(decoder(data).yaw - pose.yaw), 1.0, abs_tol=1e-12)
        assert decode.header(data) == (stamp_ns, frame)


@given(st.tuples(*[st.floats(-1.0, 1.0)] * 4))
def test_a_robot_that_is_tilted_has_a_heading_as_well(turn):
    x, y, z, w = turn
    message = convert.to_pose_stamped(POSE, 0, "map")
    message.pose = Pose(position=Point(x=1.0, y=2.0, z=3.0), orientation=Quaternion(x=x, y=y, z=z, w=w))
    assert decode.pose(serialize_message(message)) == convert.from_pose(message.pose)


@given(frames, velocities)
def test_either_kind_of_command_is_read(frame, velocity):
    plain, stamped = convert.to_twist(velocity), convert.to_twist_stamped(velocity, 7, frame)
    plain.linear.y = stamped.twist.angular.x = 9.0
    assert decode.twist(serialize_message(plain)) == velocity
    assert decode.twist_stamped(serialize_message(stamped)) == velocity
    assert decode.command(serialize_message(plain), "geometry_msgs/msg/Twist") == velocity
    assert decode.command(serialize_message(stamped), "geometry_msgs/msg/TwistStamped") == velocity


def test_a_command_that_cannot_be_read_is_no_number():
    assert not decode.command(b"", "geometry_msgs/msg/Twist").is_finite()
    assert not decode.command(b"\0\1\0\0" + bytes(9), "geometry_msgs/msg/TwistStamped").is_finite()


@given(stamps, frames, ranges, st.lists(st.floats(0.0, 9.0, width=32), max_size=3))
def test_scans_keep_every_bit(stamp_ns, frame, values, intensities):
    message = convert.to_scan(Scan(stamp_ns, values, -1.0, 0.5, 0.125, 30.0), frame, 0.05)
    message.intensities = intensities
    data = serialize_message(message)
    found = decode.scan(data)
    assert content(found) == content(convert.from_scan(message))
    assert found.ranges.flags.writeable and found.ranges.flags.aligned and found.ranges.dtype.isnative
    assert decode.header(data).frame == frame
    assert message.angle_max == pytest.approx(-1.0 + 0.5 * (len(values) - 1))


@given(frames, cells, metres, metres)
def test_maps(frame, values, x, y):
    sent = OccupancyMap(values.astype(np.int8), 0.25, x, y)
    message = convert.to_occupancy_grid(sent, 7, frame)
    found = decode.occupancy_map(serialize_message(message))
    assert content(found) == content(convert.from_occupancy_grid(message)) == content(sent)
    assert found.data.flags.writeable


def test_a_map_of_a_wrong_size_or_rotated_is_refused():
    message = convert.to_occupancy_grid(GRID, 0, "map")
    message.info.width = 4
    with pytest.raises(MessageError, match=r"^map data has 6 cells, its size says 2 x 4$"):
        decode.occupancy_map(serialize_message(message))
    message = convert.to_occupancy_grid(GRID, 0, "map")
    message.info.origin = convert.to_pose(Pose2D(0.0, 0.0, 0.5))
    with pytest.raises(MessageError, match=r"^map origin must not be rotated, got a yaw of 0.5 rad$"):
        decode.occupancy_map(serialize_message(message))


@given(st.booleans(), st.floats(), frames)
def test_single_values(touched, value, text):
    assert decode.boolean(serialize_message(Bool(data=touched))) is touched
    assert content(np.array(decode.number(serialize_message(Float64(data=value))))) == content(np.array(value))
    assert decode.text(serialize_message(String(data=text))) == text


def test_paths():
    for points in (np.zeros((0, 2)), np.array([[0.0, 1.0], [2.0, 3.0]])):
        found = decode.path(serialize_message(convert.to_path(points, 9, "map")))
        np.testing.assert_array_equal(found, points)
    turned = convert.to_path(np.array([[0.0, 0.0, 1.0]]), 9, "map")
    assert convert.from_pose(turned.poses[0].pose).yaw == pytest.approx(1.0)
    assert decode.path(serialize_message(turned)).tolist() == [[0.0, 0.0]]


def test_markers_are_discs_and_lines_where_they_are_to_be_drawn():
    def one(kind, action=Marker.ADD, x=0.0, points=()):
        made = Marker(type=kind, action=action, scale=Vector3(x=0.5), points=[Point(x=x, y=y) for x, y in points])
        made.header.frame_id = "odom"
        made.pose = convert.to_pose(Pose2D(x, 0.0, math.pi / 2.0))
        return made

    message = MarkerArray(
        markers=[
            one(Marker.CYLINDER, Marker.DELETEALL),
            one(Marker.CYLINDER, x=1.0),
            one(Marker.SPHERE, x=2.0),
            one(Marker.LINE_STRIP, points=[(1.0, 0.0), (2.0, 0.0), (3.0, 0.0)]),
            one(Marker.LINE_LIST, points=[(1.0, 0.0), (2.0, 0.0), (3.0, 0.0)]),  # half a line at its end
            one(Marker.CUBE),
        ]
    )
    found = decode.markers(serialize_message(message))
    assert found.frame == "odom"
    assert found.discs.tolist() == [[1.0, 0.0, 0.25], [2.0, 0.0, 0.25]]
    assert [len(line) for line in found.lines] == [3, 2]
    np.testing.assert_allclose(found.lines[0], [[0.0, 1.0], [0.0, 2.0], [0.0, 3.0]], atol=1e-12)


def test_transforms_and_diagnostics():
    encoder = encode.TransformEncoder([("map", "odom"), ("odom", "base_link")])
    found = decode.transforms(encoder.encode([POSE, Pose2D(1.0, 2.0, 0.0)], 7))
    assert found == [("map", "odom", POSE.through_quaternion()), ("odom", "base_link", Pose2D(1.0, 2.0, 0.0))]
    status = DiagnosticStatus(values=[KeyValue(key="status", value="blocked"), KeyValue(key="cost", value="1.5")])
    data = serialize_message(DiagnosticArray(status=[DiagnosticStatus(), status]))
    assert decode.diagnostics(data) == [{}, {"status": "blocked", "cost": "1.5"}]


def refusal(decoder, data, expected=None):
    """Return why bytes are refused, an empty text if they are read; the content is then what is expected, if given."""
    try:
        found = content(decoder(data))
    except MessageError as error:
        assert str(error)
        return str(error)
    assert expected is None or found == expected
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
@settings(max_examples=150, deadline=None)
@given(damage=st.data())
def test_malformed_bytes_are_refused_or_read_but_nothing_else_is_raised(type_name, damage):
    decoder, data = SAMPLES[type_name]
    broken = bytearray(data[: damage.draw(st.integers(0, len(data)))])
    for _ in range(damage.draw(st.integers(0, 8)) if broken else 0):
        broken[damage.draw(st.integers(0, len(broken) - 1))] = damage.draw(st.sampled_from([0, 1, 127, 128, 255]))
    for read in (decoder, decode.header):
        assert len(refusal(read, bytes(broken)).splitlines()) <= 1


def test_a_length_of_four_gigabytes_takes_no_memory():
    data = bytearray(encode.encode_text("running"))
    struct.pack_into("<I", data, 4, 2**32 - 1)
    with pytest.raises(MessageError, match="std_msgs/msg/String"):
        decode.text(bytes(data))
    data = serialize_message(convert.to_header(7, "odom"))
    with pytest.raises(MessageError, match="not a message of type std_msgs/msg/Header"):
        decode.header(data[:12] + b"\xff" * 4 + data[16:])


def test_other_encodings_are_named():
    _, data = SAMPLES["geometry_msgs/msg/Twist"]
    for first in (b"\0\7", b"\0\0"):  # parameter lists, big-endian
        with pytest.raises(MessageError, match=rf"^not a message of type .*/Twist in plain CDR, .* 0x{first.hex()}$"):
            decode.twist(first + data[2:])


def test_a_frame_that_is_no_text_is_read_as_ros_reads_it():
    data = serialize_message(convert.to_header(7, "abcd")).replace(b"abcd", b"a\xffcd")
    assert decode.header(data).frame == "a\ufffdcd"
