"""The suite's types as serialised ROS messages: what the nodes publish, made without ROS.

Each gives the same bytes as the conversion of `barn_worlds.ros.conversions` followed by ROS's own serialiser, and
keeps the bytes of its last message to overwrite what changes.
"""

from __future__ import annotations

import struct
from collections.abc import Sequence

import numpy as np
import numpy.typing as npt

from barn_eval.bags.messages import Template, deserialise, layout, make, serialise
from barn_worlds.types import NANOSECONDS, OccupancyMap, Odometry, Pose2D, Scan, Velocity2D, quaternion_from_yaw

POSE_FIELDS = ("position.x", "position.y", "orientation.z", "orientation.w")
_POSE_BYTES = 56  # x, y, z of the position, x, y, z, w of the orientation
MAP_TYPE = "nav_msgs/msg/OccupancyGrid"
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

    What lies from the numbers of one pose to those of the next is the same for all poses of a message: a row of bytes
    that is repeated, with the numbers written into it.
    """

    type_name = "nav_msgs/msg/Path"

    def __init__(self, frame: str) -> None:
        header = _header(frame)
        pose = make("geometry_msgs/msg/PoseStamped", header=header)
        pose.pose.orientation.w = 1.0
        self._empty, _, two = (
            serialise(make(self.type_name, header=header, poses=[pose] * count)) for count in range(3)
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
    message = make(MAP_TYPE, header=_header(frame, stamp_ns))
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
