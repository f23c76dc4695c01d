"""Conversions between the suite's types and ROS messages, as pure functions."""

from __future__ import annotations

import array
from collections.abc import Iterable

import numpy as np
import numpy.typing as npt
from builtin_interfaces.msg import Time
from geometry_msgs.msg import Pose, PoseStamped, PoseWithCovarianceStamped, Quaternion, Twist, TwistStamped
from nav_msgs.msg import OccupancyGrid, Path
from nav_msgs.msg import Odometry as OdometryMessage
from rclpy.qos import DurabilityPolicy, HistoryPolicy, QoSProfile, ReliabilityPolicy
from sensor_msgs.msg import LaserScan
from std_msgs.msg import Header

from barn_worlds.types import (
    NANOSECONDS,
    OccupancyMap,
    Odometry,
    Pose2D,
    Scan,
    Velocity2D,
    quaternion_from_yaw,
    yaw_from_quaternion,
)

LATCHED = QoSProfile(
    depth=1,
    history=HistoryPolicy.KEEP_LAST,
    reliability=ReliabilityPolicy.RELIABLE,
    durability=DurabilityPolicy.TRANSIENT_LOCAL,
)


def reliable(depth: int) -> QoSProfile:
    """Return the profile of topics of which nothing may be lost; any subscription is compatible with it."""
    return QoSProfile(
        depth=depth,
        history=HistoryPolicy.KEEP_LAST,
        reliability=ReliabilityPolicy.RELIABLE,
        durability=DurabilityPolicy.VOLATILE,
    )


def to_time(stamp_ns: int) -> Time:
    """Return a stamp as a message."""
    return Time(sec=stamp_ns // NANOSECONDS, nanosec=stamp_ns % NANOSECONDS)


def from_time(time: Time) -> int:
    """Return a message's stamp in nanoseconds."""
    return int(time.sec) * NANOSECONDS + int(time.nanosec)


def to_header(stamp_ns: int, frame: str) -> Header:
    """Return a header."""
    return Header(stamp=to_time(stamp_ns), frame_id=frame)


def to_pose(pose: Pose2D) -> Pose:
    """Return a pose in the plane as a message."""
    message = Pose()
    message.position.x, message.position.y = float(pose.x), float(pose.y)
    z, w = quaternion_from_yaw(pose.yaw)
    message.orientation = Quaternion(x=0.0, y=0.0, z=z, w=w)
    return message


def from_pose(message: Pose) -> Pose2D:
    """Return the part of a pose that lies in the plane."""
    q = message.orientation
    return Pose2D(message.position.x, message.position.y, yaw_from_quaternion(q.x, q.y, q.z, q.w))


def to_pose_stamped(pose: Pose2D, stamp_ns: int, frame: str) -> PoseStamped:
    """Return a stamped pose, such as a goal."""
    return PoseStamped(header=to_header(stamp_ns, frame), pose=to_pose(pose))


def to_pose_with_covariance(
    pose: Pose2D, stamp_ns: int, frame: str, variances: tuple[float, float, float] = (0.0, 0.0, 0.0)
) -> PoseWithCovarianceStamped:
    """Return a localisation estimate; variances of x, y (m2) and yaw (rad2)."""
    message = PoseWithCovarianceStamped(header=to_header(stamp_ns, frame))
    message.pose.pose = to_pose(pose)
    for index, variance in zip((0, 7, 35), variances, strict=True):
        message.pose.covariance[index] = variance
    return message


def to_odometry(odometry: Odometry, frame: str, child_frame: str) -> OdometryMessage:
    """Return an odometry message."""
    message = OdometryMessage(header=to_header(odometry.stamp_ns, frame), child_frame_id=child_frame)
    message.pose.pose = to_pose(odometry.pose)
    message.twist.twist = to_twist(odometry.velocity)
    return message


def from_odometry(message: OdometryMessage) -> Odometry:
    """Return what an odometry message says of the plane."""
    return Odometry(from_time(message.header.stamp), from_pose(message.pose.pose), from_twist(message.twist.twist))


def to_twist(velocity: Velocity2D) -> Twist:
    """Return a velocity as Twist."""
    message = Twist()
    message.linear.x, message.angular.z = float(velocity.linear), float(velocity.angular)
    return message


def to_twist_stamped(velocity: Velocity2D, stamp_ns: int, frame: str) -> TwistStamped:
    """Return a velocity as TwistStamped."""
    return TwistStamped(header=to_header(stamp_ns, frame), twist=to_twist(velocity))


def from_twist(message: Twist | TwistStamped) -> Velocity2D:
    """Return forward speed and yaw rate of either kind of command."""
    twist = message.twist if isinstance(message, TwistStamped) else message
    return Velocity2D(twist.linear.x, twist.angular.z)


def to_scan(scan: Scan, frame: str, period_s: float) -> LaserScan:
    """Return a laser scan message; all beams are taken at one instant."""
    message = LaserScan(header=to_header(scan.stamp_ns, frame))
    message.angle_min = scan.angle_min
    message.angle_increment = scan.angle_increment
    message.angle_max = scan.angle_min + scan.angle_increment * (len(scan.ranges) - 1)
    message.scan_time = period_s
    message.range_min, message.range_max = scan.range_min, scan.range_max
    message.ranges = array.array("f", np.ascontiguousarray(scan.ranges, np.float32).tobytes())
    return message


def from_scan(message: LaserScan) -> Scan:
    """Return a laser scan; the ranges share the message's memory."""
    return Scan(
        from_time(message.header.stamp),
        np.frombuffer(message.ranges, np.float32),
        message.angle_min,
        message.angle_increment,
        message.range_min,
        message.range_max,
    )


def to_occupancy_grid(grid: OccupancyMap, stamp_ns: int, frame: str) -> OccupancyGrid:
    """Return a map as a message."""
    message = OccupancyGrid(header=to_header(stamp_ns, frame))
    message.info.map_load_time = to_time(stamp_ns)
    message.info.resolution = grid.resolution
    message.info.height, message.info.width = grid.data.shape
    message.info.origin = to_pose(Pose2D(grid.origin_x, grid.origin_y, 0.0))
    message.data = array.array("b", np.ascontiguousarray(grid.data, np.int8).tobytes())
    return message


def from_occupancy_grid(message: OccupancyGrid) -> OccupancyMap:
    """Return the map of a message; ValueError where its size and data disagree or it is rotated."""
    info = message.info
    if len(message.data) != info.height * info.width:
        raise ValueError(f"map data has {len(message.data)} cells, its size says {info.height} x {info.width}")
    origin = from_pose(info.origin)
    if abs(origin.yaw) > 1e-6:
        raise ValueError(f"map origin must not be rotated, got a yaw of {origin.yaw:g} rad")
    data = np.frombuffer(message.data, np.int8).reshape(info.height, info.width)
    return OccupancyMap(data, info.resolution, origin.x, origin.y)


def to_path(points: npt.NDArray[np.float64] | Iterable[Iterable[float]], stamp_ns: int, frame: str) -> Path:
    """Return points (n, 2) or poses (n, 3) in metres and radians as a path."""
    message = Path(header=to_header(stamp_ns, frame))
    for x, y, *yaw in points:
        pose = Pose2D(float(x), float(y), float(yaw[0]) if yaw else 0.0)
        message.poses.append(PoseStamped(header=message.header, pose=to_pose(pose)))
    return message
