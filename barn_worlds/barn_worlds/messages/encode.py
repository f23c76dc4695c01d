"""The suite's types as serialised messages. An encoder keeps the bytes of its last message and writes what changes."""

from __future__ import annotations

import struct
from collections.abc import Mapping, Sequence
from typing import Any

import numpy as np
import numpy.typing as npt

from barn_worlds.messages.cdr import Template, deserialise, layout, make, serialise
from barn_worlds.types import NANOSECONDS, OccupancyMap, Odometry, Pose2D, Scan, Velocity2D, quaternion_from_yaw

POSE_FIELDS = ("position.x", "position.y", "orientation.z", "orientation.w")
STAMP_FIELDS = ("header.stamp.sec", "header.stamp.nanosec")
FINE, WARNING, ERROR = 0, 1, 2  # levels of diagnostic_msgs/DiagnosticStatus
_POSE_BYTES = 56  # x, y, z of the position, x, y, z, w of the orientation


class ClockEncoder:
    """rosgraph_msgs/Clock."""

    type_name = "rosgraph_msgs/msg/Clock"

    def __init__(self) -> None:
        self._template = Template(make(self.type_name), ["clock.sec", "clock.nanosec"])

    def encode(self, stamp_ns: int) -> bytes:
        """Return the message."""
        return self._template.fill(*divmod(stamp_ns, NANOSECONDS))


class OdometryEncoder:
    """nav_msgs/Odometry."""

    type_name = "nav_msgs/msg/Odometry"

    def __init__(self, frame: str, child_frame: str) -> None:
        message = make(self.type_name, header=header(frame), child_frame_id=child_frame)
        message.pose.pose.orientation.w = 1.0
        pose = [f"pose.pose.{name}" for name in POSE_FIELDS]
        self._template = Template(message, [*STAMP_FIELDS, *pose, "twist.twist.linear.x", "twist.twist.angular.z"])

    def encode(self, odometry: Odometry, stamp_ns: int | None = None) -> bytes:
        """Return the message, with another stamp if one is given."""
        stamp = divmod(odometry.stamp_ns if stamp_ns is None else stamp_ns, NANOSECONDS)
        velocity = odometry.velocity
        return self._template.fill(*stamp, *_pose_values(odometry.pose), velocity.linear, velocity.angular)


class PoseWithCovarianceEncoder:
    """geometry_msgs/PoseWithCovarianceStamped with fixed variances of x, y (m2) and yaw (rad2)."""

    type_name = "geometry_msgs/msg/PoseWithCovarianceStamped"

    def __init__(self, frame: str, variances: Sequence[float] = (0.0, 0.0, 0.0)) -> None:
        message = make(self.type_name, header=header(frame))
        message.pose.covariance[[0, 7, 35]] = variances
        self._template = Template(message, [*STAMP_FIELDS, *(f"pose.pose.{name}" for name in POSE_FIELDS)])

    def encode(self, pose: Pose2D, stamp_ns: int) -> bytes:
        """Return the message."""
        return self._template.fill(*divmod(stamp_ns, NANOSECONDS), *_pose_values(pose))


class PoseStampedEncoder:
    """geometry_msgs/PoseStamped."""

    type_name = "geometry_msgs/msg/PoseStamped"

    def __init__(self, frame: str) -> None:
        message = make(self.type_name, header=header(frame))
        self._template = Template(message, [*STAMP_FIELDS, *(f"pose.{name}" for name in POSE_FIELDS)])

    def encode(self, pose: Pose2D, stamp_ns: int) -> bytes:
        """Return the message."""
        return self._template.fill(*divmod(stamp_ns, NANOSECONDS), *_pose_values(pose))


class ScanEncoder:
    """sensor_msgs/LaserScan of a fixed number of beams."""

    type_name = "sensor_msgs/msg/LaserScan"

    def __init__(self, first: Scan, frame: str, period_s: float) -> None:
        message = make(
            self.type_name,
            header=header(frame),
            angle_min=first.angle_min,
            angle_increment=first.angle_increment,
            angle_max=first.angle_min + first.angle_increment * (len(first.ranges) - 1),
            scan_time=period_s,
            range_min=first.range_min,
            range_max=first.range_max,
            ranges=np.zeros(len(first.ranges), np.float32),
        )
        self._template = Template(message, [*STAMP_FIELDS, "ranges"])

    def encode(self, scan: Scan, stamp_ns: int | None = None) -> bytes:
        """Return the message, with another stamp if one is given."""
        stamp = divmod(scan.stamp_ns if stamp_ns is None else stamp_ns, NANOSECONDS)
        return self._template.fill(*stamp, scan.ranges.tobytes())


class BoolEncoder:
    """std_msgs/Bool."""

    type_name = "std_msgs/msg/Bool"

    def __init__(self) -> None:
        self._bytes = {value: serialise(make(self.type_name, data=value)) for value in (False, True)}

    def encode(self, value: bool) -> bytes:
        """Return the message."""
        return self._bytes[value]


class TwistEncoder:
    """geometry_msgs/Twist."""

    type_name = "geometry_msgs/msg/Twist"

    def __init__(self) -> None:
        self._template = Template(make(self.type_name), ["linear.x", "angular.z"])

    def encode(self, velocity: Velocity2D) -> bytes:
        """Return the message."""
        return self._template.fill(velocity.linear, velocity.angular)


class TwistStampedEncoder:
    """geometry_msgs/TwistStamped."""

    type_name = "geometry_msgs/msg/TwistStamped"

    def __init__(self, frame: str) -> None:
        message = make(self.type_name, header=header(frame))
        self._template = Template(message, [*STAMP_FIELDS, "twist.linear.x", "twist.angular.z"])

    def encode(self, velocity: Velocity2D, stamp_ns: int) -> bytes:
        """Return the message."""
        return self._template.fill(*divmod(stamp_ns, NANOSECONDS), velocity.linear, velocity.angular)


class JointEncoder:
    """sensor_msgs/JointState with positions and velocities of a fixed list of joints."""

    type_name = "sensor_msgs/msg/JointState"

    def __init__(self, names: Sequence[str], frame: str = "") -> None:
        zeros = np.zeros(len(names))
        message = make(self.type_name, header=header(frame), name=list(names), position=zeros, velocity=zeros)
        self._template = Template(message, [*STAMP_FIELDS, "position", "velocity"])

    def encode(self, positions: Sequence[float], velocities: Sequence[float], stamp_ns: int) -> bytes:
        """Return the message; radians and rad/s in the order of the names."""
        values = (np.asarray(part, np.float64).tobytes() for part in (positions, velocities))
        return self._template.fill(*divmod(stamp_ns, NANOSECONDS), *values)


class TransformEncoder:
    """tf2_msgs/TFMessage with one planar transform for each (frame, child frame)."""

    type_name = "tf2_msgs/msg/TFMessage"

    def __init__(self, frames: Sequence[tuple[str, str]]) -> None:
        transforms = [
            make("geometry_msgs/msg/TransformStamped", header=header(frame), child_frame_id=child)
            for frame, child in frames
        ]
        parts = (*STAMP_FIELDS, "transform.translation.x", "transform.translation.y")
        rotation = ("transform.rotation.z", "transform.rotation.w")
        fields = [f"transforms.{index}.{name}" for index in range(len(frames)) for name in (*parts, *rotation)]
        self._template = Template(make(self.type_name, transforms=transforms), fields)

    def encode(self, poses: Sequence[Pose2D], stamp_ns: int) -> bytes:
        """Return the message, given the pose of each child frame in its frame."""
        stamp = divmod(stamp_ns, NANOSECONDS)
        return self._template.fill(*(value for pose in poses for value in (*stamp, *_pose_values(pose))))


class PathEncoder:
    """nav_msgs/Path of any number of poses.

    Between the numbers of one pose and those of the next, all poses of a message have the same bytes. So one row of
    bytes is repeated, and the numbers are written into it.
    """

    type_name = "nav_msgs/msg/Path"

    def __init__(self, frame: str) -> None:
        pose = make("geometry_msgs/msg/PoseStamped", header=header(frame))
        pose.pose.orientation.w = 1.0
        self._empty, two = (
            serialise(make(self.type_name, header=header(frame), poses=[pose] * count)) for count in (0, 2)
        )
        slots = layout(deserialise(two, self.type_name))
        first, second = (slots[f"poses.{index}.pose.position.x"].offset for index in (0, 1))
        self._head = bytearray(two[:first])
        self._row = bytearray(two[first:second])
        self._head_stamps = (slots["header.stamp.sec"].offset, slots["poses.0.header.stamp.sec"].offset)
        self._row_stamp = slots["poses.1.header.stamp.sec"].offset - first

    def encode(self, points: npt.NDArray[np.float64], stamp_ns: int) -> bytes:
        """Return the message; points (n, 2) in metres, or (n, 3) with yaw in radians."""
        stamp = struct.pack("<iI", *divmod(stamp_ns, NANOSECONDS))
        for offset in self._head_stamps:
            self._head[offset : offset + 8] = stamp
        struct.pack_into("<I", self._head, len(self._empty) - 4, len(points))
        if not len(points):
            return bytes(self._head[: len(self._empty)])
        self._row[self._row_stamp : self._row_stamp + 8] = stamp
        rows = np.tile(np.frombuffer(self._row, np.uint8), (len(points), 1))
        rows[:, :16] = np.ascontiguousarray(points[:, :2], np.float64).view(np.uint8)
        if points.shape[1] > 2:
            turns = np.array([quaternion_from_yaw(yaw) for yaw in points[:, 2].tolist()])
            rows[:, 40:_POSE_BYTES] = turns.view(np.uint8)
        return bytes(self._head) + rows.tobytes()[: rows.size - len(self._row) + _POSE_BYTES]


def encode_map(grid: OccupancyMap, stamp_ns: int, frame: str) -> bytes:
    """Return nav_msgs/OccupancyGrid: a map or a costmap."""
    message = make("nav_msgs/msg/OccupancyGrid", header=header(frame, stamp_ns))
    message.info.map_load_time = message.header.stamp
    message.info.resolution = grid.resolution
    message.info.height, message.info.width = grid.data.shape
    message.info.origin.position.x, message.info.origin.position.y = grid.origin_x, grid.origin_y
    message.info.origin.orientation.w = 1.0
    message.data = np.ascontiguousarray(grid.data, np.int8).ravel()
    return serialise(message)


def encode_fixed_transforms(parent: str, children: Mapping[str, tuple[float, float, float]]) -> bytes:
    """Return tf2_msgs/TFMessage with fixed frames at (x, y, z) metres in another one."""
    transforms = []
    for child, xyz in children.items():
        transform = make("geometry_msgs/msg/TransformStamped", header=header(parent), child_frame_id=child)
        where = transform.transform.translation
        where.x, where.y, where.z = xyz
        transform.transform.rotation.w = 1.0
        transforms.append(transform)
    return serialise(make(TransformEncoder.type_name, transforms=transforms))


def encode_diagnostics(
    stamp_ns: int, level: int, name: str, message: str, values: Mapping[str, str], hardware_id: str = ""
) -> bytes:
    """Return diagnostic_msgs/DiagnosticArray with one status; level: FINE, WARNING or ERROR."""
    pairs = [make("diagnostic_msgs/msg/KeyValue", key=key, value=value) for key, value in values.items()]
    about = {"level": level, "name": name, "message": message, "hardware_id": hardware_id, "values": pairs}
    status = make("diagnostic_msgs/msg/DiagnosticStatus", **about)
    return serialise(make("diagnostic_msgs/msg/DiagnosticArray", header=header("", stamp_ns), status=[status]))


def encode_text(text: str) -> bytes:
    """Return std_msgs/String."""
    return serialise(make("std_msgs/msg/String", data=text))


def encode_number(value: float) -> bytes:
    """Return std_msgs/Float64."""
    return serialise(make("std_msgs/msg/Float64", data=value))


def header(frame: str, stamp_ns: int = 0) -> Any:
    """Return std_msgs/Header as an object, for a message made by `make`."""
    made = make("std_msgs/msg/Header", frame_id=frame)
    made.stamp.sec, made.stamp.nanosec = divmod(stamp_ns, NANOSECONDS)
    return made


def _pose_values(pose: Pose2D) -> tuple[float, float, float, float]:
    return (pose.x, pose.y, *quaternion_from_yaw(pose.yaw))
