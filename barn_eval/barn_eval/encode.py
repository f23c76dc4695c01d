"""The suite's types as serialised ROS messages: what the nodes publish, made without ROS.

Each gives the same bytes as the conversion of `barn_worlds.ros.conversions` followed by ROS's own serialiser, and
keeps the bytes of its last message to overwrite what changes.
"""

from __future__ import annotations

import struct
from collections.abc import Sequence

import numpy as np
import numpy.typing as npt

from barn_eval.messages import ENCAPSULATION_BYTES, Template, deserialise, layout, make, serialise
from barn_worlds.types import NANOSECONDS, OccupancyMap, Odometry, Pose2D, Scan, Velocity2D, quaternion_from_yaw

POSE_FIELDS = ("position.x", "position.y", "orientation.z", "orientation.w")
STAMP_FIELDS = ("header.stamp.sec", "header.stamp.nanosec")


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
        message = make(self.type_name, header=_header(frame), child_frame_id=child_frame)
        message.pose.pose.orientation.w = 1.0
        pose = [f"pose.pose.{name}" for name in POSE_FIELDS]
        self._template = Template(message, [*STAMP_FIELDS, *pose, "twist.twist.linear.x", "twist.twist.angular.z"])

    def encode(self, odometry: Odometry) -> bytes:
        """Return the message."""
        stamp, velocity = divmod(odometry.stamp_ns, NANOSECONDS), odometry.velocity
        return self._template.fill(*stamp, *_pose_values(odometry.pose), velocity.linear, velocity.angular)


class PoseEncoder:
    """geometry_msgs/PoseWithCovarianceStamped with fixed variances of x, y (m2) and yaw (rad2)."""

    type_name = "geometry_msgs/msg/PoseWithCovarianceStamped"

    def __init__(self, frame: str, variances: Sequence[float] = (0.0, 0.0, 0.0)) -> None:
        message = make(self.type_name, header=_header(frame))
        message.pose.covariance[[0, 7, 35]] = variances
        self._template = Template(message, [*STAMP_FIELDS, *(f"pose.pose.{name}" for name in POSE_FIELDS)])

    def encode(self, pose: Pose2D, stamp_ns: int) -> bytes:
        """Return the message."""
        return self._template.fill(*divmod(stamp_ns, NANOSECONDS), *_pose_values(pose))


class GoalEncoder:
    """geometry_msgs/PoseStamped."""

    type_name = "geometry_msgs/msg/PoseStamped"

    def __init__(self, frame: str) -> None:
        message = make(self.type_name, header=_header(frame))
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
            header=_header(frame),
            angle_min=first.angle_min,
            angle_increment=first.angle_increment,
            angle_max=first.angle_min + first.angle_increment * (len(first.ranges) - 1),
            scan_time=period_s,
            range_min=first.range_min,
            range_max=first.range_max,
            ranges=np.zeros(len(first.ranges), np.float32),
        )
        self._template = Template(message, [*STAMP_FIELDS, "ranges"])

    def encode(self, scan: Scan) -> bytes:
        """Return the message."""
        return self._template.fill(*divmod(scan.stamp_ns, NANOSECONDS), scan.ranges.tobytes())


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


class JointEncoder:
    """sensor_msgs/JointState with positions and velocities of a fixed list of joints."""

    type_name = "sensor_msgs/msg/JointState"

    def __init__(self, names: Sequence[str], frame: str = "") -> None:
        zeros = np.zeros(len(names))
        message = make(self.type_name, header=_header(frame), name=list(names), position=zeros, velocity=zeros)
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
            make("geometry_msgs/msg/TransformStamped", header=_header(frame), child_frame_id=child)
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

    From the second on, poses lie at the same distance from each other; so two of them serve as the pattern of all.
    """

    type_name = "nav_msgs/msg/Path"

    def __init__(self, frame: str) -> None:
        header = _header(frame)
        pose = make("geometry_msgs/msg/PoseStamped", header=header)
        self._empty, one, two = (
            serialise(make(self.type_name, header=header, poses=[pose] * count)) for count in range(3)
        )
        self._first, self._other = one, two[len(one) :]
        self._slots = layout(deserialise(two, self.type_name))

    def encode(self, points: npt.NDArray[np.float64], stamp_ns: int) -> bytes:
        """Return the message; points (n, 2) in metres, or (n, 3) with yaw in radians."""
        count = len(points)
        data = bytearray(self._first + self._other * (count - 1) if count else self._empty)
        struct.pack_into("<iI", data, ENCAPSULATION_BYTES, *divmod(stamp_ns, NANOSECONDS))
        struct.pack_into("<I", data, len(self._empty) - 4, count)
        if count:
            self._write_poses(np.frombuffer(data, np.uint8), points, stamp_ns)
        return bytes(data)

    def _write_poses(self, data: npt.NDArray[np.uint8], points: npt.NDArray[np.float64], stamp_ns: int) -> None:
        stamp = np.frombuffer(struct.pack("<iI", *divmod(stamp_ns, NANOSECONDS)), np.uint8)
        numbers = np.zeros((len(points), 7))
        numbers[:, :2] = points[:, :2]
        yaws = points[:, 2] if points.shape[1] > 2 else np.zeros(len(points))
        numbers[:, 5:] = [quaternion_from_yaw(yaw) for yaw in yaws.tolist()]
        data[self._offsets("header.stamp.sec", len(points))[:, None] + np.arange(8)] = stamp
        data[self._offsets("pose.position.x", len(points))[:, None] + np.arange(56)] = numbers.view(np.uint8)

    def _offsets(self, name: str, count: int) -> npt.NDArray[np.int64]:
        """Return where a field of each pose lies."""
        offsets = self._slots[f"poses.1.{name}"].offset + len(self._other) * (np.arange(count) - 1)
        offsets[0] = self._slots[f"poses.0.{name}"].offset
        return offsets


def encode_map(grid: OccupancyMap, stamp_ns: int, frame: str) -> bytes:
    """Return nav_msgs/OccupancyGrid."""
    message = make("nav_msgs/msg/OccupancyGrid", header=_header(frame, stamp_ns))
    message.info.map_load_time = message.header.stamp
    message.info.resolution = grid.resolution
    message.info.height, message.info.width = grid.data.shape
    message.info.origin.position.x, message.info.origin.position.y = grid.origin_x, grid.origin_y
    message.info.origin.orientation.w = 1.0
    message.data = np.ascontiguousarray(grid.data, np.int8).ravel()
    return serialise(message)


def _header(frame: str, stamp_ns: int = 0) -> object:
    header = make("std_msgs/msg/Header", frame_id=frame)
    header.stamp.sec, header.stamp.nanosec = divmod(stamp_ns, NANOSECONDS)
    return header


def _pose_values(pose: Pose2D) -> tuple[float, float, float, float]:
    return (pose.x, pose.y, *quaternion_from_yaw(pose.yaw))
