"""Decodes serialized messages of any sender into the suite's types.

Functions raise MessageError for malformed bytes. Only little-endian CDR is supported,
which all current machines send. Frequent messages are read in place; the rosbags
library decodes everything else.
"""

import math
import struct
from collections.abc import Callable
from functools import wraps
from typing import NamedTuple, TypeVar

import numpy as np

from barn_worlds.base.arrays import Floats, Points
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
from barn_worlds.messages.cdr import ENCAPSULATION_BYTES, Message, deserialize
from barn_worlds.messages.encode import ADD, CYLINDER, LINE_LIST, LINE_STRIP, SPHERE

T = TypeVar("T")

_LITTLE_ENDIAN = b"\x00\x01"  # first two bytes of the encapsulation
_HEADER = struct.Struct("<iII")  # seconds, nanoseconds, length of the frame
_LENGTH = struct.Struct("<I")
_TWIST = struct.Struct("<d32xd")  # linear x, angular z
# Position and quaternion, linear x, angular z, with the covariances behind both.
_POSE_AND_TWIST = struct.Struct("<2d8x4d288xd32xd288x")
# Angles (min, max, increment), times (increment, scan), ranges (min, max), count.
_SCAN = struct.Struct("<7fI")
# Raised by reads beyond the end and by impossible lengths.
_READ_ERRORS = (struct.error, ValueError, IndexError, OverflowError)


class Header(NamedTuple):
    """Stamp and frame of a message."""

    stamp_ns: int
    frame: str


class Transform(NamedTuple):
    """The planar part of the pose of a child frame in its parent."""

    parent: str
    child: str
    pose: Pose2D
    stamp_ns: int


class Markers(NamedTuple):
    """Discs and lines of a marker array, in meters."""

    frame: str
    """Frame of the first marker."""

    discs: Floats
    """x, y and radius (k, 3)."""

    lines: list[Points]
    """Points (n, 2) of each line."""


def _reads(type_name: str) -> Callable[[Callable[[bytes], T]], Callable[[bytes], T]]:
    """Return a decorator that makes a reader raise MessageError for malformed bytes."""

    def wrap(read: Callable[[bytes], T]) -> Callable[[bytes], T]:
        """Return the reader with a check of the encoding and its errors converted."""

        @wraps(read)
        def read_checked(data: bytes) -> T:
            """Return what the reader returns; MessageError for malformed bytes."""
            _check_encoding(data, type_name)
            # Foreign bytes may end anywhere; reading past their end raises.
            try:
                return read(data)
            except _READ_ERRORS as error:
                raise MessageError(
                    f"not a message of type {type_name} ({error})"
                ) from None

        return read_checked

    return wrap


@_reads("std_msgs/msg/Header")
def header(data: bytes) -> Header:
    """Return stamp (ns) and frame of a message's header; MessageError if malformed."""
    stamp_ns, _ = _read_stamp(data)
    return Header(stamp_ns, _read_text(data, ENCAPSULATION_BYTES + 8))


@_reads("rosgraph_msgs/msg/Clock")
def clock(data: bytes) -> int:
    """Return the time in ns of a serialized Clock; MessageError if malformed."""
    sec, nanosec = struct.unpack_from("<iI", data, ENCAPSULATION_BYTES)
    return int(sec * NANOSECONDS_PER_SECOND + nanosec)


def boolean(data: bytes) -> bool:
    """Return the value of a serialized Bool; MessageError if malformed."""
    return bool(decode_message(data, "std_msgs/msg/Bool").data)


def number(data: bytes) -> float:
    """Return the value of a serialized Float64; MessageError if malformed."""
    return float(decode_message(data, "std_msgs/msg/Float64").data)


@_reads("std_msgs/msg/String")
def text(data: bytes) -> str:
    """Return the text of a serialized String; MessageError if malformed."""
    return _read_text(data, ENCAPSULATION_BYTES)


@_reads("geometry_msgs/msg/Twist")
def twist(data: bytes) -> Velocity2D:
    """Return linear x, angular z of a serialized Twist; MessageError if malformed."""
    return Velocity2D(*_TWIST.unpack_from(data, ENCAPSULATION_BYTES))


@_reads("geometry_msgs/msg/TwistStamped")
def twist_stamped(data: bytes) -> Velocity2D:
    """Return linear x, angular z of a TwistStamped; MessageError if malformed."""
    _, end = _read_stamp(data)
    return Velocity2D(*_TWIST.unpack_from(data, _align_double(end)))


def command(data: bytes, type_name: str) -> Velocity2D:
    """Return linear x and angular z of a serialized command, NaN if it is malformed.

    Args:
        data: Serialized geometry_msgs/Twist or geometry_msgs/TwistStamped.
        type_name: Its type, one of these two.
    """
    is_stamped = type_name == "geometry_msgs/msg/TwistStamped"
    try:
        return twist_stamped(data) if is_stamped else twist(data)
    except MessageError:
        # An invalid command stops the robot; it must not stop the trial.
        return Velocity2D(math.nan, math.nan)


def pose(data: bytes) -> Pose2D:
    """Return x, y, yaw of a serialized PoseStamped; MessageError if malformed."""
    return planar_pose(decode_message(data, "geometry_msgs/msg/PoseStamped").pose)


@_reads("geometry_msgs/msg/PoseArray")
def poses(data: bytes) -> Floats:
    """Return x, y, z, quaternion (n, 7) of a PoseArray; MessageError if malformed."""
    _, end = _read_stamp(data)
    offset = _align_length(end)
    (count,) = _LENGTH.unpack_from(data, offset)
    # There is no padding behind the length of an empty sequence.
    if not count:
        return np.empty((0, 7))
    first = _align_double(offset + _LENGTH.size)
    return np.frombuffer(data, np.float64, 7 * count, first).reshape(-1, 7)


def pose_with_covariance(data: bytes) -> Pose2D:
    """Return x, y, yaw of a PoseWithCovarianceStamped; MessageError if malformed."""
    message = decode_message(data, "geometry_msgs/msg/PoseWithCovarianceStamped")
    return planar_pose(message.pose.pose)


@_reads("nav_msgs/msg/Odometry")
def odometry(data: bytes) -> Odometry:
    """Return the odometry, yaw NaN for an all-zero quaternion; MessageError if bad."""
    stamp_ns, end = _read_stamp(data)
    offset = _align_double(_text_end(data, end))
    x, y, *quaternion, linear, angular = _POSE_AND_TWIST.unpack_from(data, offset)
    # Zeros are no orientation: who measures none sends them.
    yaw = yaw_from_quaternion(*quaternion) if any(quaternion) else math.nan
    return Odometry(stamp_ns, Pose2D(x, y, yaw), Velocity2D(linear, angular))


@_reads("sensor_msgs/msg/LaserScan")
def scan(data: bytes) -> Scan:
    """Return the scan, ranges copied, of a LaserScan; MessageError if malformed."""
    stamp_ns, end = _read_stamp(data)
    offset = _align_length(end)
    angle_min, _, increment, _, _, range_min, range_max, count = _SCAN.unpack_from(
        data, offset
    )
    # A copy, so that the scan can be changed and does not keep the whole message.
    ranges = np.frombuffer(data, np.float32, count, offset + _SCAN.size).copy()
    return Scan(stamp_ns, ranges, angle_min, increment, range_min, range_max)


def occupancy_map(data: bytes) -> OccupancyMap:
    """Return an OccupancyGrid's map, cells copied; MessageError if bad or rotated.

    Raises:
        MessageError: Also if the map is rotated or its number of cells is wrong.
    """
    message = decode_message(data, "nav_msgs/msg/OccupancyGrid")
    info = message.info
    origin = planar_pose(info.origin)
    if len(message.data) != info.height * info.width:
        raise MessageError(
            f"map data must have {info.height} x {info.width} cells, "
            f"got {len(message.data)}"
        )
    if abs(origin.yaw) > 1e-6:
        raise MessageError(
            f"map origin must not be rotated, got a yaw of {origin.yaw:g} rad"
        )
    cells = message.data.reshape(info.height, info.width).copy()
    return OccupancyMap(cells, info.resolution, *origin.position)


def path(data: bytes) -> Points:
    """Return x, y (n, 2) in m of a Path's poses; MessageError if malformed."""
    message = decode_message(data, "nav_msgs/msg/Path")
    return planar_points([stamped.pose.position for stamped in message.poses])


def markers(data: bytes) -> Markers:
    """Return discs and lines added by a MarkerArray, no others; MessageError if bad."""
    message = decode_message(data, "visualization_msgs/msg/MarkerArray")
    frame = ""
    discs = []
    lines = []
    for marker in message.markers:
        frame = frame or marker.header.frame_id
        # All other actions take markers away.
        if marker.action != ADD:
            continue
        pose = planar_pose(marker.pose)
        if marker.type in (CYLINDER, SPHERE):
            discs.append((*pose.position, 0.5 * marker.scale.x))
        elif marker.type in (LINE_STRIP, LINE_LIST) and marker.points:
            points = pose.transform(planar_points(marker.points))
            if marker.type == LINE_STRIP:
                lines.append(points)
            else:
                # Each pair of points is a line; a last single one is none.
                pairs = points[: len(points) // 2 * 2].reshape(-1, 2, 2)
                lines += list(pairs)
    return Markers(frame, np.array(discs, np.float64).reshape(-1, 3), lines)


def transforms(data: bytes) -> list[Transform]:
    """Return the planar transforms of a TFMessage; MessageError if malformed."""
    transforms = []
    for stamped in decode_message(data, "tf2_msgs/msg/TFMessage").transforms:
        pose = _planar(stamped.transform.translation, stamped.transform.rotation)
        parent = stamped.header.frame_id
        stamp = stamped.header.stamp
        stamp_ns = stamp.sec * NANOSECONDS_PER_SECOND + stamp.nanosec
        transforms.append(Transform(parent, stamped.child_frame_id, pose, stamp_ns))
    return transforms


def diagnostics(data: bytes) -> list[dict[str, str]]:
    """Return a dict of texts per status of DiagnosticArray; MessageError if bad."""
    statuses = decode_message(data, "diagnostic_msgs/msg/DiagnosticArray").status
    return [{value.key: value.value for value in status.values} for status in statuses]


def decode_message(data: bytes, type_name: str) -> Message:
    """Return bytes of any type as a rosbags message object; MessageError if malformed.

    Args:
        data: Serialized message.
        type_name: Type, such as "geometry_msgs/msg/Twist".

    Raises:
        MessageError: If the bytes are malformed.
    """
    _check_encoding(data, type_name)
    try:
        return deserialize(data, type_name)
    # rosbags raises errors of any kind for malformed bytes.
    except Exception as error:
        raise MessageError(f"not a message of type {type_name} ({error})") from None


def planar_pose(message: Message) -> Pose2D:
    """Return x, y and yaw of a geometry_msgs/Pose object."""
    return _planar(message.position, message.orientation)


def planar_points(points: list[Message]) -> Points:
    """Return x, y (n, 2) of geometry_msgs/Point objects."""
    rows = [(point.x, point.y) for point in points]
    return np.array(rows, np.float64).reshape(-1, 2)


def _check_encoding(data: bytes, type_name: str) -> None:
    """Raise MessageError unless the bytes begin as plain little-endian CDR."""
    if data[:2] != _LITTLE_ENDIAN:
        raise MessageError(
            f"not a message of type {type_name} in plain CDR, "
            f"it begins with 0x{data[:2].hex()}"
        )


def _read_stamp(data: bytes) -> tuple[int, int]:
    """Return a message header's stamp in ns and the byte offset of the header's end."""
    sec, nanosec, length = _HEADER.unpack_from(data, ENCAPSULATION_BYTES)
    end = ENCAPSULATION_BYTES + _HEADER.size + length
    return sec * NANOSECONDS_PER_SECOND + nanosec, end


def _read_text(data: bytes, offset: int) -> str:
    """Return the text whose length is at a byte offset; ValueError past the end."""
    end = _text_end(data, offset)
    if end > len(data):
        raise ValueError(f"a text up to {end} of {len(data)} bytes")
    begin = offset + _LENGTH.size
    return data[begin:end].split(b"\0", 1)[0].decode("utf-8", "replace")


def _text_end(data: bytes, offset: int) -> int:
    """Return the byte offset of the end of the text whose length is at an offset."""
    offset = _align_length(offset)
    return int(offset + _LENGTH.size + _LENGTH.unpack_from(data, offset)[0])


def _align_length(offset: int) -> int:
    """Return the first byte offset from `offset` where a 32-bit number may start."""
    return offset + -offset % 4


def _align_double(offset: int) -> int:
    """Return the first byte offset from `offset` where a double may start."""
    # Alignment counts from the end of the encapsulation.
    return offset + (ENCAPSULATION_BYTES - offset) % 8


def _planar(position: Message, rotation: Message) -> Pose2D:
    """Return x, y and yaw of a position object and a quaternion object."""
    yaw = yaw_from_quaternion(rotation.x, rotation.y, rotation.z, rotation.w)
    return Pose2D(position.x, position.y, yaw)
