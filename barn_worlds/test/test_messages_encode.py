"""Encoders against messages that are filled field by field and serialised by ROS itself, and against rosbags."""

import math

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

pytest.importorskip("rclpy", reason="ROS 2 is not installed")

import ros_messages as convert
from diagnostic_msgs.msg import DiagnosticArray, DiagnosticStatus, KeyValue
from geometry_msgs.msg import Vector3
from rclpy.serialization import deserialize_message, serialize_message
from rosgraph_msgs.msg import Clock
from sensor_msgs.msg import JointState
from std_msgs.msg import Bool, ColorRGBA, Float64, String
from visualization_msgs.msg import Marker, MarkerArray

from barn_worlds.base.types import OccupancyMap, Odometry, Pose2D, Scan, Velocity2D
from barn_worlds.messages import encode
from barn_worlds.messages.cdr import Template, deserialise, layout, make, serialise
from barn_worlds.messages.encode import LINE_STRIP, marker

POSE = Pose2D(-2.25, 3.1, 1.57)
MARKERS = "visualization_msgs/msg/MarkerArray"
STAMP = 12_345_678_901
ODOMETRY = Odometry(STAMP, POSE, Velocity2D(0.5, -0.25))
RANGES = np.array([0.5, math.inf, -math.inf, math.nan, 29.9, 1.0, 2.0], np.float32)
SCAN = Scan(STAMP, RANGES, -2.35619, 0.7, 0.1, 30.0)
GRID = OccupancyMap(np.arange(-1, 5, dtype=np.int8).reshape(2, 3), 0.15, -4.5, 0.25)


def points(count: int, columns: int) -> np.ndarray:
    return np.random.default_rng(count).uniform(-3.0, 10.0, (count, columns))


def ours() -> dict[str, tuple[str, bytes]]:
    """Return every kind of message by a label, as (type, bytes)."""
    velocity = ODOMETRY.velocity
    encoders = {
        "odometry": (encode.OdometryEncoder("odom", "base_link"), (ODOMETRY, STAMP)),
        "pose": (encode.PoseWithCovarianceEncoder("map", (0.1, 0.2, 0.3)), (POSE, STAMP)),
        "goal": (encode.PoseStampedEncoder("map"), (POSE, STAMP)),
        "scan": (encode.ScanEncoder(SCAN, "lidar_link", 0.05), (SCAN, STAMP)),
        "stamped twist": (encode.TwistStampedEncoder("base_link"), (velocity, STAMP)),
        "joints": (encode.JointEncoder(["left", "right"]), (([1.0, 2.0], [3.0, 4.0]), STAMP)),
    }
    made = {label: (encoder.type_name, encoder.encode(*given)) for label, (encoder, given) in encoders.items()}
    made["clock"] = ("rosgraph_msgs/msg/Clock", encode.encode_clock(STAMP))
    made["contact"] = ("std_msgs/msg/Bool", encode.encode_bool(True))
    made["no contact"] = ("std_msgs/msg/Bool", encode.encode_bool(False))
    made["twist"] = ("geometry_msgs/msg/Twist", encode.encode_twist(velocity))
    made["map"] = ("nav_msgs/msg/OccupancyGrid", encode.encode_map(GRID, STAMP, "map"))
    made["text"] = ("std_msgs/msg/String", encode.encode_text("süß"))
    made["number"] = ("std_msgs/msg/Float64", encode.encode_number(0.125))
    status = encode.encode_diagnostics(
        STAMP, encode.WARNING, "one", "slow", {"a": "1", "b": "two"}, hardware_id="jackal"
    )
    made["diagnostics"] = ("diagnostic_msgs/msg/DiagnosticArray", status)
    line = marker("odom", "lines", LINE_STRIP, index=3, colour=(0.1, 0.2, 0.3, 1.0), stamp_ns=STAMP)
    line.scale.x = 0.5
    made["marker"] = ("visualization_msgs/msg/MarkerArray", serialise(make(MARKERS, markers=[line])))
    for count in (0, 1, 2, 3, 40):
        for columns in (2, 3):
            for frame in ("map", "odom", "base_link"):
                data = encode.PathEncoder(frame).encode(points(count, columns), STAMP)
                made[f"path {count} {columns} {frame}"] = (encode.PathEncoder.type_name, data)
    return made


def theirs(label: str):
    """Return the same message as an object of ROS."""
    if label.startswith("path"):
        _, count, columns, frame = label.split()
        return convert.to_path(points(int(count), int(columns)), STAMP, frame)
    return {
        "clock": lambda: Clock(clock=convert.to_time(STAMP)),
        "odometry": lambda: convert.to_odometry(ODOMETRY, "odom", "base_link"),
        "pose": lambda: convert.to_pose_with_covariance(POSE, STAMP, "map", (0.1, 0.2, 0.3)),
        "goal": lambda: convert.to_pose_stamped(POSE, STAMP, "map"),
        "scan": lambda: convert.to_scan(SCAN, "lidar_link", 0.05),
        "contact": lambda: Bool(data=True),
        "no contact": lambda: Bool(data=False),
        "twist": lambda: convert.to_twist(ODOMETRY.velocity),
        "stamped twist": lambda: convert.to_twist_stamped(ODOMETRY.velocity, STAMP, "base_link"),
        "joints": lambda: JointState(
            header=convert.to_header(STAMP, ""), name=["left", "right"], position=[1.0, 2.0], velocity=[3.0, 4.0]
        ),
        "map": lambda: convert.to_occupancy_grid(GRID, STAMP, "map"),
        "text": lambda: String(data="süß"),
        "number": lambda: Float64(data=0.125),
        "diagnostics": status,
        "marker": line,
    }[label]()


def status() -> DiagnosticArray:
    values = [KeyValue(key="a", value="1"), KeyValue(key="b", value="two")]
    one = DiagnosticStatus(level=DiagnosticStatus.WARN, name="one", message="slow", hardware_id="jackal", values=values)
    return DiagnosticArray(header=convert.to_header(STAMP, ""), status=[one])


def line() -> MarkerArray:
    colour = ColorRGBA(r=0.1, g=0.2, b=0.3, a=1.0)
    one = Marker(ns="lines", id=3, type=Marker.LINE_STRIP, action=Marker.ADD, color=colour, scale=Vector3(x=0.5))
    one.header = convert.to_header(STAMP, "odom")
    return MarkerArray(markers=[one])


@pytest.mark.parametrize("label", list(ours()))
def test_bytes_are_those_that_ros_sends(label):
    """Equal but for the bytes between fields and behind the last one, which are left as they were in memory."""
    type_name, data = ours()[label]
    message = theirs(label)
    for sent in (serialize_message(message), serialize_message(deserialize_message(data, type(message)))):
        assert len(sent) >= len(data)
        assert serialise(deserialise(sent[: len(data)], type_name)) == data


def transforms_of(data: bytes):
    return deserialise(data, encode.TransformEncoder.type_name).transforms


def test_transforms():
    encoder = encode.TransformEncoder([("map", "odom"), ("odom", "base_link")])
    transforms = transforms_of(encoder.encode([POSE, Pose2D(1.0, 2.0, 0.0)], STAMP))
    frames = [(one.header.frame_id, one.child_frame_id) for one in transforms]
    assert frames == [("map", "odom"), ("odom", "base_link")]
    first, second = (one.transform for one in transforms)
    assert (first.translation.x, first.translation.y) == (POSE.x, POSE.y)
    assert (first.rotation.z, first.rotation.w) == (math.sin(0.785), math.cos(0.785))
    assert (second.translation.x, second.rotation.w) == (1.0, 1.0)
    assert transforms[1].header.stamp.sec == 12


def test_fixed_transforms():
    (one,) = transforms_of(encode.encode_fixed_transforms("base_link", {"laser": (0.1, 0.2, 0.3)}))
    assert (one.header.frame_id, one.child_frame_id, one.header.stamp.sec) == ("base_link", "laser", 0)
    where = one.transform.translation
    assert (where.x, where.y, where.z, one.transform.rotation.w) == (0.1, 0.2, 0.3, 1.0)
    (turned,) = transforms_of(encode.encode_fixed_transforms("base_link", {"laser": (0.0, 0.0, 0.0)}, {"laser": 0.8}))
    assert (turned.transform.rotation.z, turned.transform.rotation.w) == (math.sin(0.4), math.cos(0.4))


def test_an_encoder_forgets_the_message_before():
    encoder = encode.OdometryEncoder("odom", "base_link")
    fresh = encoder.encode(ODOMETRY, STAMP)
    encoder.encode(Odometry(1, Pose2D(9.0, 9.0, 3.0), Velocity2D(9.0, 9.0)), 1)
    assert encoder.encode(ODOMETRY, STAMP) == fresh


def test_the_stamp_given_takes_the_place_of_the_reading_s_own():
    odometry, scan = encode.OdometryEncoder("odom", "base_link"), encode.ScanEncoder(SCAN, "lidar_link", 0.05)
    for encoder, reading in ((odometry, ODOMETRY), (scan, SCAN)):
        later = deserialise(encoder.encode(reading, 77_000_000_005), encoder.type_name)
        assert (later.header.stamp.sec, later.header.stamp.nanosec) == (77, 5)
        later.header.stamp.sec, later.header.stamp.nanosec = divmod(STAMP, 10**9)
        assert serialise(later) == encoder.encode(reading, STAMP)


@settings(max_examples=50, deadline=None)
@given(frame=st.text(max_size=12).filter(lambda text: "\0" not in text), child=st.text(max_size=12))
def test_layout_finds_every_field_whatever_the_texts(frame, child):
    child = child.replace("\0", "")
    header = make("std_msgs/msg/Header", frame_id=frame)
    message = make("nav_msgs/msg/Odometry", header=header, child_frame_id=child)
    names = [name for name in layout(message) if "covariance" not in name]
    template = Template(message, names)
    values = [7 if name.startswith("header") else 0.5 + index for index, name in enumerate(names)]
    decoded = deserialise(template.fill(*values), template.type_name)
    for name, value in zip(names, values, strict=True):
        item = decoded
        for part in name.split("."):
            item = getattr(item, part)
        assert item == value


def test_make_rejects_an_unknown_field():
    with pytest.raises(KeyError, match="has no field 'linaer'"):
        make("geometry_msgs/msg/Twist", linaer=1.0)
