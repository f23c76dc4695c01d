"""Encoders against messages that are filled field by field and serialized by ROS itself, and against rosbags."""

import array
import itertools
import math
from operator import attrgetter

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

pytest.importorskip("rclpy", reason="ROS 2 is not installed")

from builtin_interfaces.msg import Time
from diagnostic_msgs.msg import DiagnosticArray, DiagnosticStatus, KeyValue
from geometry_msgs import msg as geometry
from nav_msgs import msg as nav
from rclpy.serialization import deserialize_message, serialize_message
from rosgraph_msgs.msg import Clock
from sensor_msgs.msg import JointState, LaserScan
from std_msgs.msg import Bool, ColorRGBA, Float64, Header, String
from visualization_msgs.msg import Marker, MarkerArray

from barn_worlds.base.types import (
    OccupancyMap,
    Odometry,
    Pose2D,
    Scan,
    Velocity2D,
    quaternion_from_yaw,
)
from barn_worlds.messages import encode
from barn_worlds.messages.cdr import (
    Template,
    deserialize,
    find_slots,
    make_message,
    serialize,
)
from barn_worlds.messages.encode import LINE_STRIP, make_marker

POSE = Pose2D(-2.25, 3.1, 1.57)
MARKERS = "visualization_msgs/msg/MarkerArray"
STAMP = 12_345_678_901
TEXTS = st.text(st.characters(codec="utf-8", exclude_characters="\0"), max_size=12)
TIME = Time(sec=12, nanosec=345_678_901)
ODOMETRY = Odometry(STAMP, POSE, Velocity2D(0.5, -0.25))
RANGES = np.array([0.5, math.inf, -math.inf, math.nan, 29.9, 1.0, 2.0], np.float32)
SCAN = Scan(STAMP, RANGES, -2.35619, 0.7, 0.1, 30.0)
GRID = OccupancyMap(np.arange(-1, 5, dtype=np.int8).reshape(2, 3), 0.15, -4.5, 0.25)
COVARIANCE = [{0: 0.1, 7: 0.2, 35: 0.3}.get(place, 0.0) for place in range(36)]
COLOR = {"r": 0.1, "g": 0.2, "b": 0.3, "a": 1.0}
LINE = make_marker(
    "odom", "lines", LINE_STRIP, index=3, color=tuple(COLOR.values()), stamp_ns=STAMP
)
LINE.scale.x = 0.5


def header(frame: str = "") -> Header:
    return Header(stamp=TIME, frame_id=frame)


def pose(x: float, y: float, yaw: float = 0.0) -> geometry.Pose:
    z, w = quaternion_from_yaw(yaw)
    return geometry.Pose(
        position=geometry.Point(x=x, y=y), orientation=geometry.Quaternion(z=z, w=w)
    )


AT = pose(*POSE.numbers)
MOVES = geometry.Twist(
    linear=geometry.Vector3(x=0.5), angular=geometry.Vector3(z=-0.25)
)
STATUS = DiagnosticStatus(
    level=DiagnosticStatus.WARN,
    name="one",
    message="slow",
    hardware_id="jackal",
    values=[KeyValue(key="a", value="1"), KeyValue(key="b", value="two")],
)
SIZE = nav.MapMetaData(
    map_load_time=TIME, resolution=0.15, width=3, height=2, origin=pose(-4.5, 0.25)
)
# Our bytes, and the same message as an object of ROS, filled field by field.
CASES = {
    "clock": (encode.encode_clock(STAMP), Clock(clock=TIME)),
    "odometry": (
        encode.OdometryEncoder("odom", "base_link").encode(ODOMETRY, STAMP),
        nav.Odometry(
            header=header("odom"),
            child_frame_id="base_link",
            pose=geometry.PoseWithCovariance(pose=AT),
            twist=geometry.TwistWithCovariance(twist=MOVES),
        ),
    ),
    "pose": (
        encode.PoseWithCovarianceEncoder("map", (0.1, 0.2, 0.3)).encode(POSE, STAMP),
        geometry.PoseWithCovarianceStamped(
            header=header("map"),
            pose=geometry.PoseWithCovariance(pose=AT, covariance=COVARIANCE),
        ),
    ),
    "goal": (
        encode.PoseStampedEncoder("map").encode(POSE, STAMP),
        geometry.PoseStamped(header=header("map"), pose=AT),
    ),
    "scan": (
        encode.ScanEncoder(SCAN, "lidar_link", 0.05).encode(SCAN, STAMP),
        LaserScan(
            header=header("lidar_link"),
            angle_min=-2.35619,
            angle_max=-2.35619 + 6 * 0.7,
            angle_increment=0.7,
            scan_time=0.05,
            range_min=0.1,
            range_max=30.0,
            ranges=array.array("f", RANGES.tobytes()),
        ),
    ),
    "contact": (encode.encode_bool(True), Bool(data=True)),
    "no contact": (encode.encode_bool(False), Bool(data=False)),
    "twist": (encode.encode_twist(ODOMETRY.velocity), MOVES),
    "stamped twist": (
        encode.TwistStampedEncoder("base_link").encode(ODOMETRY.velocity, STAMP),
        geometry.TwistStamped(header=header("base_link"), twist=MOVES),
    ),
    "joints": (
        encode.JointEncoder(["left", "right"]).encode(([1.0, 2.0], [3.0, 4.0]), STAMP),
        JointState(
            header=header(),
            name=["left", "right"],
            position=[1.0, 2.0],
            velocity=[3.0, 4.0],
        ),
    ),
    "map": (
        encode.encode_map(GRID, STAMP, "map"),
        nav.OccupancyGrid(
            header=header("map"), info=SIZE, data=array.array("b", GRID.data.tobytes())
        ),
    ),
    "text": (encode.encode_text("süß"), String(data="süß")),
    "number": (encode.encode_number(0.125), Float64(data=0.125)),
    "diagnostics": (
        encode.encode_diagnostics(
            STAMP,
            encode.WARNING,
            "one",
            "slow",
            {"a": "1", "b": "two"},
            hardware_id="jackal",
        ),
        DiagnosticArray(header=header(), status=[STATUS]),
    ),
    "marker": (
        serialize(make_message(MARKERS, markers=[LINE])),
        MarkerArray(
            markers=[
                Marker(
                    header=header("odom"),
                    ns="lines",
                    id=3,
                    type=Marker.LINE_STRIP,
                    color=ColorRGBA(**COLOR),
                    scale=geometry.Vector3(x=0.5),
                )
            ]
        ),
    ),
}
for count, columns, frame in itertools.product(
    (0, 1, 2, 3, 40), (2, 3), ("map", "odom", "base_link")
):
    points = np.random.default_rng(count).uniform(-3.0, 10.0, (count, columns))
    poses = [
        geometry.PoseStamped(header=header(frame), pose=pose(*point))
        for point in points.tolist()
    ]
    path = (
        encode.PathEncoder(frame).encode(points, STAMP),
        nav.Path(header=header(frame), poses=poses),
    )
    CASES[f"path {count} {columns} {frame}"] = path


@pytest.mark.parametrize("label", CASES)
def test_bytes_are_those_that_ros_sends(label):
    """Equal but for the bytes between fields and behind the last one, which are left as they were in memory."""
    data, message = CASES[label]
    type_name = f"{type(message).__module__.split('.')[0]}/msg/{type(message).__name__}"
    for sent in (
        serialize_message(message),
        serialize_message(deserialize_message(data, type(message))),
    ):
        assert len(sent) >= len(data)
        assert serialize(deserialize(sent[: len(data)], type_name)) == data


def transforms_of(data: bytes):
    return deserialize(data, encode.TransformEncoder.type_name).transforms


def test_fixed_transforms():
    data = encode.encode_fixed_transforms("base_link", {"laser": (0.1, 0.2, 0.3)}, {})
    (transform,) = transforms_of(data)
    header = transform.header
    frames = (header.frame_id, transform.child_frame_id)
    assert (*frames, header.stamp.sec) == ("base_link", "laser", 0)
    place = transform.transform.translation
    assert (place.x, place.y, place.z) == (0.1, 0.2, 0.3)
    assert transform.transform.rotation.w == 1.0
    data = encode.encode_fixed_transforms(
        "base_link", {"laser": (0.0, 0.0, 0.0)}, {"laser": 0.8}
    )
    (transform,) = transforms_of(data)
    turn = transform.transform.rotation
    assert (turn.z, turn.w) == (math.sin(0.4), math.cos(0.4))


def test_an_encoder_forgets_the_message_before():
    encoder = encode.OdometryEncoder("odom", "base_link")
    fresh = encoder.encode(ODOMETRY, STAMP)
    encoder.encode(Odometry(1, Pose2D(9.0, 9.0, 3.0), Velocity2D(9.0, 9.0)), 1)
    assert encoder.encode(ODOMETRY, STAMP) == fresh


def test_the_stamp_given_takes_the_place_of_the_reading_s_own():
    odometry = encode.OdometryEncoder("odom", "base_link")
    scan = encode.ScanEncoder(SCAN, "lidar_link", 0.05)
    for encoder, reading in ((odometry, ODOMETRY), (scan, SCAN)):
        later = deserialize(encoder.encode(reading, 77_000_000_005), encoder.type_name)
        assert (later.header.stamp.sec, later.header.stamp.nanosec) == (77, 5)
        later.header.stamp.sec, later.header.stamp.nanosec = divmod(STAMP, 10**9)
        assert serialize(later) == encoder.encode(reading, STAMP)


@settings(max_examples=50, deadline=None)
@given(frame=TEXTS, child=TEXTS)
def test_layout_finds_every_field_whatever_the_texts(frame, child):
    header = make_message("std_msgs/msg/Header", frame_id=frame)
    message = make_message("nav_msgs/msg/Odometry", header=header, child_frame_id=child)
    names = [name for name in find_slots(message) if "covariance" not in name]
    template = Template(message, names)
    values = [
        7 if name.startswith("header") else 0.5 + index
        for index, name in enumerate(names)
    ]
    decoded = deserialize(template.fill(*values), template.type_name)
    assert [attrgetter(name)(decoded) for name in names] == values


def test_make_rejects_an_unknown_field():
    with pytest.raises(TypeError, match="unexpected keyword argument 'linaer'"):
        make_message("geometry_msgs/msg/Twist", linaer=1.0)
