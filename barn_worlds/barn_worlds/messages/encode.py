"""The suite's types as serialised messages. An encoder keeps the bytes of its last message and writes what changes."""

import struct
from collections.abc import Callable, Iterable, Mapping, Sequence
from types import MappingProxyType
from typing import Any, Generic, TypeVar

import numpy as np

from barn_worlds.base.arrays import Floats
from barn_worlds.base.types import (
    NANOSECONDS_PER_SECOND,
    OccupancyMap,
    Odometry,
    Pose2D,
    Scan,
    Velocity2D,
    quaternion_from_yaw,
)
from barn_worlds.messages.cdr import Message, Template, layout, make, serialise

STAMP_FIELDS = ("header.stamp.sec", "header.stamp.nanosec")
FINE, WARNING, ERROR = 0, 1, 2  # levels of diagnostic_msgs/DiagnosticStatus
# Constants of visualization_msgs/Marker: types and actions.
CUBE, SPHERE, CYLINDER, LINE_STRIP, LINE_LIST, TEXT_VIEW_FACING = 1, 2, 3, 4, 5, 9
ADD, DELETE_ALL = 0, 3
_LITTLE_ENDIAN = b"\x00\x01\x00\x00"  # in front of every message; those without texts and lengths are packed at once
_POSE_BYTES = 56  # x, y, z of the position, x, y, z, w of the orientation
T = TypeVar("T")


class Encoder(Generic[T]):
    """Messages of one type with a header; their frames, other texts and lengths are always the same.

    message: one of them. fields: dotted names of what varies beside the stamp. values: gives these of a content.
    """

    def __init__(
        self,
        message: Message,
        fields: Iterable[str],
        values: Callable[[T], Iterable[Any]],
    ) -> None:
        self.type_name: str = message.__msgtype__
        self._fill = Template(message, [*STAMP_FIELDS, *fields]).fill
        self._values = values

    def encode(self, content: T, stamp_ns: int) -> bytes:
        """Return the message."""
        return self._fill(
            *divmod(stamp_ns, NANOSECONDS_PER_SECOND), *self._values(content)
        )


class OdometryEncoder(Encoder[Odometry]):
    """nav_msgs/Odometry; the stamp is the one given with it."""

    def __init__(self, frame: str, child_frame: str) -> None:
        message = make(
            "nav_msgs/msg/Odometry", header=header(frame), child_frame_id=child_frame
        )
        fields = (
            *_pose_fields("pose.pose"),
            "twist.twist.linear.x",
            "twist.twist.angular.z",
        )
        super().__init__(
            message,
            fields,
            lambda it: (
                *_pose_values(it.pose),
                it.velocity.linear,
                it.velocity.angular,
            ),
        )


class PoseWithCovarianceEncoder(Encoder[Pose2D]):
    """geometry_msgs/PoseWithCovarianceStamped with fixed variances of x, y (m2) and yaw (rad2)."""

    def __init__(
        self, frame: str, variances: Sequence[float] = (0.0, 0.0, 0.0)
    ) -> None:
        message = make(
            "geometry_msgs/msg/PoseWithCovarianceStamped", header=header(frame)
        )
        message.pose.covariance[[0, 7, 35]] = variances
        super().__init__(message, _pose_fields("pose.pose"), _pose_values)


class PoseStampedEncoder(Encoder[Pose2D]):
    """geometry_msgs/PoseStamped."""

    def __init__(self, frame: str) -> None:
        message = make("geometry_msgs/msg/PoseStamped", header=header(frame))
        super().__init__(message, _pose_fields("pose"), _pose_values)


class ScanEncoder(Encoder[Scan]):
    """sensor_msgs/LaserScan of a fixed number of beams; the stamp is the one given with it."""

    def __init__(self, first: Scan, frame: str, period_s: float) -> None:
        names = ("angle_min", "angle_increment", "range_min", "range_max")
        message = make(
            "sensor_msgs/msg/LaserScan",
            header=header(frame),
            **{one: getattr(first, one) for one in names},
        )
        message.angle_max = first.angle_min + first.angle_increment * (
            len(first.ranges) - 1
        )
        message.scan_time, message.ranges = (
            period_s,
            np.zeros(len(first.ranges), np.float32),
        )
        super().__init__(message, ["ranges"], lambda scan: (scan.ranges.tobytes(),))


class TwistStampedEncoder(Encoder[Velocity2D]):
    """geometry_msgs/TwistStamped."""

    def __init__(self, frame: str) -> None:
        message = make("geometry_msgs/msg/TwistStamped", header=header(frame))
        fields = ("twist.linear.x", "twist.angular.z")
        super().__init__(
            message, fields, lambda velocity: (velocity.linear, velocity.angular)
        )


class JointEncoder(Encoder[tuple[Sequence[float], Sequence[float]]]):
    """sensor_msgs/JointState of positions (rad) and velocities (rad/s) in the order of a fixed list of joints."""

    def __init__(self, names: Sequence[str]) -> None:
        fields, rest = ("position", "velocity"), np.zeros(len(names))
        message = make(
            "sensor_msgs/msg/JointState",
            header=header(""),
            name=list(names),
            position=rest,
            velocity=rest,
        )
        super().__init__(
            message,
            fields,
            lambda both: [np.asarray(one, np.float64).tobytes() for one in both],
        )


class TransformEncoder:
    """tf2_msgs/TFMessage with one planar transform for each (frame, child frame)."""

    type_name = "tf2_msgs/msg/TFMessage"

    def __init__(self, frames: Sequence[tuple[str, str]]) -> None:
        parts = ("translation.x", "translation.y", "rotation.z", "rotation.w")
        varying = (*STAMP_FIELDS, *(f"transform.{name}" for name in parts))
        fields = [
            f"transforms.{index}.{name}"
            for index in range(len(frames))
            for name in varying
        ]
        self._template = Template(
            make(self.type_name, transforms=[_transform(*pair) for pair in frames]),
            fields,
        )

    def encode(self, poses: Sequence[Pose2D], stamp_ns: int) -> bytes:
        """Return the message, given the pose of each child frame in its frame."""
        stamp = divmod(stamp_ns, NANOSECONDS_PER_SECOND)
        return self._template.fill(
            *(value for pose in poses for value in (*stamp, *_pose_values(pose)))
        )


class PathEncoder:
    """nav_msgs/Path of any number of poses.

    Between the numbers of one pose and those of the next, all poses of a message have the same bytes. So one row of
    bytes is repeated, and the numbers are written into it.
    """

    type_name = "nav_msgs/msg/Path"

    def __init__(self, frame: str) -> None:
        pose = make("geometry_msgs/msg/PoseStamped", header=header(frame))
        pose.pose.orientation.w = 1.0
        empty, two = (
            make(self.type_name, header=header(frame), poses=[pose] * count)
            for count in (0, 2)
        )
        self._empty, slots, data = len(serialise(empty)), layout(two), serialise(two)
        first, second = (
            slots[f"poses.{index}.pose.position.x"].offset for index in (0, 1)
        )
        self._head, self._row = bytearray(data[:first]), bytearray(data[first:second])
        self._head_stamps = (
            slots["header.stamp.sec"].offset,
            slots["poses.0.header.stamp.sec"].offset,
        )
        self._row_stamp = slots["poses.1.header.stamp.sec"].offset - first

    def encode(self, points: Floats, stamp_ns: int) -> bytes:
        """Return the message; points (n, 2) in metres, or (n, 3) with yaw in radians."""
        stamp = struct.pack("<iI", *divmod(stamp_ns, NANOSECONDS_PER_SECOND))
        for offset in self._head_stamps:
            self._head[offset : offset + 8] = stamp
        struct.pack_into("<I", self._head, self._empty - 4, len(points))
        if not len(points):
            return bytes(self._head[: self._empty])
        self._row[self._row_stamp : self._row_stamp + 8] = stamp
        rows = np.tile(np.frombuffer(self._row, np.uint8), (len(points), 1))
        rows[:, :16] = np.ascontiguousarray(points[:, :2], np.float64).view(np.uint8)
        if points.shape[1] > 2:
            turns = np.array(
                [quaternion_from_yaw(yaw) for yaw in points[:, 2].tolist()]
            )
            rows[:, 40:_POSE_BYTES] = turns.view(np.uint8)
        return (
            bytes(self._head)
            + rows.tobytes()[: rows.size - len(self._row) + _POSE_BYTES]
        )


def encode_map(grid: OccupancyMap, stamp_ns: int, frame: str) -> bytes:
    """Return nav_msgs/OccupancyGrid: a map or a costmap."""
    message = make("nav_msgs/msg/OccupancyGrid", header=header(frame, stamp_ns))
    message.info.map_load_time = message.header.stamp
    message.info.resolution = grid.resolution
    message.info.height, message.info.width = grid.data.shape
    message.info.origin.position.x, message.info.origin.position.y = (
        grid.origin_x,
        grid.origin_y,
    )
    message.info.origin.orientation.w = 1.0
    message.data = np.ascontiguousarray(grid.data, np.int8).ravel()
    return serialise(message)


def encode_fixed_transforms(
    parent: str,
    children: Mapping[str, tuple[float, float, float]],
    yaws: Mapping[str, float] = MappingProxyType({}),
) -> bytes:
    """Return tf2_msgs/TFMessage with fixed frames at (x, y, z) metres in another one.

    yaws: those of frames that are turned about z, rad.
    """
    transforms = []
    for child, xyz in children.items():
        made = _transform(parent, child)
        where = made.transform.translation
        where.x, where.y, where.z = xyz
        made.transform.rotation.z, made.transform.rotation.w = quaternion_from_yaw(
            yaws.get(child, 0.0)
        )
        transforms.append(made)
    return serialise(make(TransformEncoder.type_name, transforms=transforms))


def encode_diagnostics(
    stamp_ns: int,
    level: int,
    name: str,
    message: str,
    values: Mapping[str, str],
    hardware_id: str = "",
) -> bytes:
    """Return diagnostic_msgs/DiagnosticArray with one status; level: FINE, WARNING or ERROR."""
    pairs = [
        make("diagnostic_msgs/msg/KeyValue", key=key, value=value)
        for key, value in values.items()
    ]
    about = {
        "level": level,
        "name": name,
        "message": message,
        "hardware_id": hardware_id,
        "values": pairs,
    }
    status = make("diagnostic_msgs/msg/DiagnosticStatus", **about)
    return serialise(
        make(
            "diagnostic_msgs/msg/DiagnosticArray",
            header=header("", stamp_ns),
            status=[status],
        )
    )


def encode_clock(stamp_ns: int) -> bytes:
    """Return rosgraph_msgs/Clock."""
    return _LITTLE_ENDIAN + struct.pack(
        "<iI", *divmod(stamp_ns, NANOSECONDS_PER_SECOND)
    )


def encode_twist(velocity: Velocity2D) -> bytes:
    """Return geometry_msgs/Twist."""
    return _LITTLE_ENDIAN + struct.pack("<d32xd", velocity.linear, velocity.angular)


def encode_bool(value: bool) -> bytes:
    """Return std_msgs/Bool."""
    return _LITTLE_ENDIAN + struct.pack("<?", value)


def encode_text(text: str) -> bytes:
    """Return std_msgs/String."""
    return serialise(make("std_msgs/msg/String", data=text))


def encode_number(value: float) -> bytes:
    """Return std_msgs/Float64."""
    return serialise(make("std_msgs/msg/Float64", data=value))


def header(frame: str, stamp_ns: int = 0) -> Message:
    """Return std_msgs/Header as an object, for a message made by `make`."""
    made = make("std_msgs/msg/Header", frame_id=frame)
    made.stamp.sec, made.stamp.nanosec = divmod(stamp_ns, NANOSECONDS_PER_SECOND)
    return made


def marker(
    frame: str,
    namespace: str,
    kind: int = 0,
    *,
    index: int = 0,
    action: int = ADD,
    colour: tuple[float, float, float, float] = (0.0, 0.0, 0.0, 0.0),
    stamp_ns: int = 0,
) -> Message:
    """Return visualization_msgs/Marker as an object; colour: red, green, blue, opacity."""
    about = {"ns": namespace, "id": index, "type": kind, "action": action}
    paint = make("std_msgs/msg/ColorRGBA", **dict(zip("rgba", colour, strict=True)))
    made = make(
        "visualization_msgs/msg/Marker",
        header=header(frame, stamp_ns),
        color=paint,
        **about,
    )
    made.pose.orientation.w = 1.0
    return made


def _transform(frame: str, child_frame: str) -> Message:
    return make(
        "geometry_msgs/msg/TransformStamped",
        header=header(frame),
        child_frame_id=child_frame,
    )


def _pose_fields(pose: str) -> list[str]:
    return [
        f"{pose}.{name}"
        for name in ("position.x", "position.y", "orientation.z", "orientation.w")
    ]


def _pose_values(pose: Pose2D) -> tuple[float, float, float, float]:
    return (pose.x, pose.y, *quaternion_from_yaw(pose.yaw))
