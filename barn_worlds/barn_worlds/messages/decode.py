"""The suite's types from serialised messages of any sender; MessageError for malformed bytes.

Only little-endian CDR, the form that all machines of today send, is read. Types that need not be read fast are left to
the rosbags library.
"""

import math
import struct
from collections.abc import Callable
from functools import wraps
from typing import NamedTuple, TypeVar

import numpy as np

from barn_worlds.base.arrays import Floats
from barn_worlds.base.errors import MessageError
from barn_worlds.base.types import (
    NANOSECONDS_PER_SECOND,
    OccupancyMap,
    Odometry,
    Pose2D,
    Scan,
    Velocity2D,
    yaw_from_quaternion,
)
from barn_worlds.messages.cdr import Message, deserialise
from barn_worlds.messages.encode import ADD, CYLINDER, LINE_LIST, LINE_STRIP, SPHERE

T = TypeVar("T")
Points = Floats

_LITTLE = b"\x00\x01"  # the first two of the four bytes in front of every message
_HEADER = struct.Struct("<iII")  # seconds, nanoseconds, length of the frame
_LENGTH = struct.Struct("<I")
_TWIST = struct.Struct("<d32xd")  # linear x to angular z
_POSE_AND_TWIST = struct.Struct("<2d8x4d288xd32xd288x")  # each with its covariance
_SCAN = struct.Struct(
    "<7fI"
)  # angles: min, max, increment; times: increment, scan; range: min, max; count
# What a read beyond the end, or an impossible length, raises.
_MALFORMED = (struct.error, ValueError, IndexError, OverflowError)


class Header(NamedTuple):
    """Stamp and frame of a message."""

    stamp_ns: int
    frame: str


class Transform(NamedTuple):
    """The planar part of a child frame's pose in its parent."""

    parent: str
    child: str
    pose: Pose2D


class Markers(NamedTuple):
    """The discs (k, 3) x, y, radius in metres and the lines, each (n, 2), of a marker array; `frame` of the first."""

    frame: str
    discs: Points
    lines: list[Points]


def _reads(type_name: str) -> Callable[[Callable[[bytes], T]], Callable[[bytes], T]]:
    """Let a function that reads messages of a type raise MessageError for what is none."""

    def wrap(read: Callable[[bytes], T]) -> Callable[[bytes], T]:
        @wraps(read)
        def checked(data: bytes) -> T:
            _check_encoding(data, type_name)
            try:
                return read(data)
            except _MALFORMED as error:
                raise MessageError(
                    f"not a message of type {type_name} ({error})"
                ) from None

        return checked

    return wrap


@_reads("std_msgs/msg/Header")
def header(data: bytes) -> Header:
    """Return the header of a message of any type that begins with one."""
    return Header(_after_header(data)[0], _text(data, 12))


@_reads("rosgraph_msgs/msg/Clock")
def clock(data: bytes) -> int:
    """Return the time of rosgraph_msgs/Clock in nanoseconds."""
    sec, nanosec = struct.unpack_from("<iI", data, 4)
    return int(sec * NANOSECONDS_PER_SECOND + nanosec)


def boolean(data: bytes) -> bool:
    """Return the value of std_msgs/Bool."""
    return bool(whole(data, "std_msgs/msg/Bool").data)


def number(data: bytes) -> float:
    """Return the value of std_msgs/Float64."""
    return float(whole(data, "std_msgs/msg/Float64").data)


@_reads("std_msgs/msg/String")
def text(data: bytes) -> str:
    """Return the text of std_msgs/String."""
    return _text(data, 4)


@_reads("geometry_msgs/msg/Twist")
def twist(data: bytes) -> Velocity2D:
    """Return the velocity of geometry_msgs/Twist."""
    return Velocity2D(*_TWIST.unpack_from(data, 4))


@_reads("geometry_msgs/msg/TwistStamped")
def twist_stamped(data: bytes) -> Velocity2D:
    """Return the velocity of geometry_msgs/TwistStamped."""
    _, at = _after_header(data)
    return Velocity2D(*_TWIST.unpack_from(data, _aligned(at)))


def command(data: bytes, type_name: str) -> Velocity2D:
    """Return the velocity of a command of either type; NaN, which is invalid, if it cannot be read."""
    try:
        return (
            twist_stamped(data)
            if type_name == "geometry_msgs/msg/TwistStamped"
            else twist(data)
        )
    except MessageError:
        return Velocity2D(math.nan, math.nan)


def pose(data: bytes) -> Pose2D:
    """Return the pose of geometry_msgs/PoseStamped."""
    return _pose_of(whole(data, "geometry_msgs/msg/PoseStamped").pose)


@_reads("geometry_msgs/msg/PoseArray")
def poses(data: bytes) -> Points:
    """Return the poses of geometry_msgs/PoseArray: position and quaternion (n, 7)."""
    _, at = _after_header(data)
    at += -at % 4
    (count,) = _LENGTH.unpack_from(data, at)
    return (
        np.frombuffer(data, np.float64, 7 * count, _aligned(at + 4)).reshape(-1, 7)
        if count
        else np.empty((0, 7))
    )


def pose_with_covariance(data: bytes) -> Pose2D:
    """Return the pose of geometry_msgs/PoseWithCovarianceStamped."""
    return _pose_of(
        whole(data, "geometry_msgs/msg/PoseWithCovarianceStamped").pose.pose
    )


@_reads("nav_msgs/msg/Odometry")
def odometry(data: bytes) -> Odometry:
    """Return the planar part of nav_msgs/Odometry."""
    stamp_ns, at = _after_header(data)
    x, y, *turn, linear, angular = _POSE_AND_TWIST.unpack_from(
        data, _aligned(_after_text(data, at))
    )
    return Odometry(
        stamp_ns, Pose2D(x, y, yaw_from_quaternion(*turn)), Velocity2D(linear, angular)
    )


@_reads("sensor_msgs/msg/LaserScan")
def scan(data: bytes) -> Scan:
    """Return the scan of sensor_msgs/LaserScan."""
    stamp_ns, at = _after_header(data)
    at += -at % 4
    low, _, step, _, _, nearest, farthest, count = _SCAN.unpack_from(data, at)
    ranges = np.frombuffer(data, np.float32, count, at + _SCAN.size).copy()
    return Scan(stamp_ns, ranges, low, step, nearest, farthest)


def occupancy_map(data: bytes) -> OccupancyMap:
    """Return the map of nav_msgs/OccupancyGrid; MessageError where its size and data disagree or it is rotated."""
    message = whole(data, "nav_msgs/msg/OccupancyGrid")
    about, origin = message.info, _pose_of(message.info.origin)
    if len(message.data) != about.height * about.width:
        raise MessageError(
            f"map data has {len(message.data)} cells, its size says {about.height} x {about.width}"
        )
    if abs(origin.yaw) > 1e-6:
        raise MessageError(
            f"map origin must not be rotated, got a yaw of {origin.yaw:g} rad"
        )
    cells = message.data.reshape(about.height, about.width).copy()
    return OccupancyMap(cells, about.resolution, origin.x, origin.y)


def path(data: bytes) -> Points:
    """Return the points (n, 2) of nav_msgs/Path in metres."""
    poses = whole(data, "nav_msgs/msg/Path").poses
    return np.array(
        [(one.pose.position.x, one.pose.position.y) for one in poses], np.float64
    ).reshape(-1, 2)


def markers(data: bytes) -> Markers:
    """Return discs and lines of visualization_msgs/MarkerArray, all in the frame of the first."""
    discs, lines, frame = [], [], ""
    for marker in whole(data, "visualization_msgs/msg/MarkerArray").markers:
        frame = frame or marker.header.frame_id
        if marker.action != ADD:
            continue
        where = _pose_of(marker.pose)
        if marker.type in (CYLINDER, SPHERE):
            discs.append((where.x, where.y, 0.5 * marker.scale.x))
        elif marker.type in (LINE_STRIP, LINE_LIST) and marker.points:
            points = where.transform(
                np.array([(point.x, point.y) for point in marker.points], np.float64)
            )
            lines += (
                [points]
                if marker.type == LINE_STRIP
                else list(points[: len(points) // 2 * 2].reshape(-1, 2, 2))
            )
    return Markers(frame, np.array(discs, np.float64).reshape(-1, 3), lines)


def transforms(data: bytes) -> list[Transform]:
    """Return what tf2_msgs/TFMessage holds."""
    return [
        Transform(
            one.header.frame_id,
            one.child_frame_id,
            _planar(one.transform.translation, one.transform.rotation),
        )
        for one in whole(data, "tf2_msgs/msg/TFMessage").transforms
    ]


def diagnostics(data: bytes) -> list[dict[str, str]]:
    """Return the values of each status of diagnostic_msgs/DiagnosticArray, by key."""
    statuses = whole(data, "diagnostic_msgs/msg/DiagnosticArray").status
    return [{value.key: value.value for value in status.values} for status in statuses]


def _check_encoding(data: bytes, type_name: str) -> None:
    if data[:2] != _LITTLE:
        raise MessageError(
            f"not a message of type {type_name} in plain CDR, it begins with 0x{data[:2].hex()}"
        )


def whole(data: bytes, type_name: str) -> Message:
    """Return all of a message of any type; MessageError for malformed bytes."""
    _check_encoding(data, type_name)
    try:
        return deserialise(data, type_name)
    except (
        Exception
    ) as error:  # the library raises errors of any kind for malformed bytes
        raise MessageError(f"not a message of type {type_name} ({error})") from None


def _after_header(data: bytes) -> tuple[int, int]:
    """Return the stamp in nanoseconds and where the header ends."""
    sec, nanosec, length = _HEADER.unpack_from(data, 4)
    return sec * NANOSECONDS_PER_SECOND + nanosec, 16 + length


def _after_text(data: bytes, at: int) -> int:
    at += -at % 4
    return int(at + 4 + _LENGTH.unpack_from(data, at)[0])


def _aligned(at: int) -> int:
    """Return the first offset where a double may start; alignment counts after the first four bytes."""
    return at + (4 - at) % 8


def _text(data: bytes, at: int) -> str:
    """Return the text whose length stands at an offset."""
    end = _after_text(data, at)
    if end > len(data):
        raise ValueError(f"a text up to {end} of {len(data)} bytes")
    return data[at + 4 : end].split(b"\0", 1)[0].decode("utf-8", "replace")


def _pose_of(message: Message) -> Pose2D:
    return _planar(message.position, message.orientation)


def _planar(position: Message, turn: Message) -> Pose2D:
    return Pose2D(
        position.x, position.y, yaw_from_quaternion(turn.x, turn.y, turn.z, turn.w)
    )
