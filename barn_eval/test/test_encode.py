"""Encoders against the conversions of the nodes with ROS's own serialiser, and against rosbags."""

from __future__ import annotations

import math

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from rclpy.serialization import deserialize_message, serialize_message
from rosgraph_msgs.msg import Clock
from sensor_msgs.msg import JointState
from std_msgs.msg import Bool

from barn_eval.bags import encode
from barn_eval.bags.messages import Template, deserialise, layout, make, serialise
from barn_worlds.ros import conversions as convert
from barn_worlds.types import OccupancyMap, Odometry, Pose2D, Scan, Velocity2D

POSE = Pose2D(-2.25, 3.1, 1.57)
STAMP = 12_345_678_901
ODOMETRY = Odometry(STAMP, POSE, Velocity2D(0.5, -0.25))
RANGES = np.array([0.5, math.inf, -math.inf, math.nan, 29.9, 1.0, 2.0], np.float32)
SCAN = Scan(STAMP, RANGES, -2.35619, 0.7, 0.1, 30.0)
GRID = OccupancyMap(np.arange(-1, 5, dtype=np.int8).reshape(2, 3), 0.15, -4.5, 0.25)


def points(count: int, columns: int) -> np.ndarray:
    return np.random.default_rng(count).uniform(-3.0, 10.0, (count, columns))


def ours() -> dict[str, tuple[str, bytes]]:
    """Return every kind of message by a label, as (type, bytes)."""
    made = {
        "clock": (encode.ClockEncoder.type_name, encode.ClockEncoder().encode(STAMP)),
        "odometry": (
            encode.OdometryEncoder.type_name,
            encode.OdometryEncoder("odom", "base_link").encode(ODOMETRY),
        ),
        "pose": (encode.PoseEncoder.type_name, encode.PoseEncoder("map", (0.1, 0.2, 0.3)).encode(POSE, STAMP)),
        "goal": (encode.GoalEncoder.type_name, encode.GoalEncoder("map").encode(POSE, STAMP)),
        "scan": (encode.ScanEncoder.type_name, encode.ScanEncoder(SCAN, "lidar_link", 0.05).encode(SCAN)),
        "contact": (encode.BoolEncoder.type_name, encode.BoolEncoder().encode(True)),
        "no contact": (encode.BoolEncoder.type_name, encode.BoolEncoder().encode(False)),
        "twist": (encode.TwistEncoder.type_name, encode.TwistEncoder().encode(ODOMETRY.velocity)),
        "joints": (
            encode.JointEncoder.type_name,
            encode.JointEncoder(["left", "right"]).encode([1.0, 2.0], [3.0, 4.0], STAMP),
        ),
        "map": ("nav_msgs/msg/OccupancyGrid", encode.encode_map(GRID, STAMP, "map")),
    }
    for count in (0, 1, 2, 3, 40):
        for columns in (2, 3):
            for frame in ("map", "odom", "base_link"):
                data = encode.PathEncoder(frame).encode(points(count, columns), STAMP)
                made[f"path {count} {columns} {frame}"] = (encode.PathEncoder.type_name, data)
    return made


def theirs(label: str):
    """Return the message that a node would publish."""
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
        "joints": lambda: JointState(
            header=convert.to_header(STAMP, ""), name=["left", "right"], position=[1.0, 2.0], velocity=[3.0, 4.0]
        ),
        "map": lambda: convert.to_occupancy_grid(GRID, STAMP, "map"),
    }[label]()


@pytest.mark.parametrize("label", list(ours()))
def test_bytes_are_those_that_ros_sends(label):
    """Equal but for the bytes between fields and behind the last one, which are left as they were in memory."""
    type_name, data = ours()[label]
    message = theirs(label)
    for sent in (serialize_message(message), serialize_message(deserialize_message(data, type(message)))):
        assert len(sent) >= len(data)
        assert serialise(deserialise(sent[: len(data)], type_name)) == data


@pytest.mark.parametrize("label", list(ours()))
def test_bytes_are_those_of_rosbags(label):
    type_name, data = ours()[label]
    assert serialise(deserialise(data, type_name)) == data


def test_transforms():
    encoder = encode.TransformEncoder([("map", "odom"), ("odom", "base_link")])
    message = deserialise(encoder.encode([POSE, Pose2D(1.0, 2.0, 0.0)], STAMP), encoder.type_name)
    assert [(one.header.frame_id, one.child_frame_id) for one in message.transforms] == [
        ("map", "odom"),
        ("odom", "base_link"),
    ]
    first, second = (one.transform for one in message.transforms)
    assert (first.translation.x, first.translation.y) == (POSE.x, POSE.y)
    assert (first.rotation.z, first.rotation.w) == (math.sin(0.785), math.cos(0.785))
    assert (second.translation.x, second.rotation.w) == (1.0, 1.0)
    assert message.transforms[1].header.stamp.sec == 12


def test_an_encoder_forgets_the_message_before():
    encoder = encode.OdometryEncoder("odom", "base_link")
    fresh = encoder.encode(ODOMETRY)
    encoder.encode(Odometry(1, Pose2D(9.0, 9.0, 3.0), Velocity2D(9.0, 9.0)))
    assert encoder.encode(ODOMETRY) == fresh


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
