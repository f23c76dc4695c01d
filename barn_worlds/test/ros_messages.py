"""The slow way, to compare with: the suite's types as messages of rclpy, field by field."""

import array

from builtin_interfaces.msg import Time
from geometry_msgs.msg import Point, Pose, PoseStamped, PoseWithCovarianceStamped, Quaternion, Twist, TwistStamped
from nav_msgs.msg import OccupancyGrid, Path
from nav_msgs.msg import Odometry as OdometryMessage
from sensor_msgs.msg import LaserScan
from std_msgs.msg import Header

from barn_worlds.base.types import NANOSECONDS, Pose2D, quaternion_from_yaw


def to_time(stamp_ns):
    return Time(sec=stamp_ns // NANOSECONDS, nanosec=stamp_ns % NANOSECONDS)


def to_header(stamp_ns, frame):
    return Header(stamp=to_time(stamp_ns), frame_id=frame)


def to_pose(pose):
    z, w = quaternion_from_yaw(pose.yaw)
    return Pose(position=Point(x=pose.x, y=pose.y), orientation=Quaternion(z=z, w=w))


def to_pose_stamped(pose, stamp_ns, frame):
    return PoseStamped(header=to_header(stamp_ns, frame), pose=to_pose(pose))


def to_pose_with_covariance(pose, stamp_ns, frame, variances=(0.0, 0.0, 0.0)):
    message = PoseWithCovarianceStamped(header=to_header(stamp_ns, frame))
    message.pose.pose = to_pose(pose)
    for index, variance in zip((0, 7, 35), variances, strict=True):
        message.pose.covariance[index] = variance
    return message


def to_odometry(odometry, frame, child_frame):
    message = OdometryMessage(header=to_header(odometry.stamp_ns, frame), child_frame_id=child_frame)
    message.pose.pose = to_pose(odometry.pose)
    message.twist.twist = to_twist(odometry.velocity)
    return message


def to_twist(velocity):
    message = Twist()
    message.linear.x, message.angular.z = velocity.linear, velocity.angular
    return message


def to_twist_stamped(velocity, stamp_ns, frame):
    return TwistStamped(header=to_header(stamp_ns, frame), twist=to_twist(velocity))


def to_scan(scan, frame, period_s):
    message = LaserScan(header=to_header(scan.stamp_ns, frame))
    message.angle_min = scan.angle_min
    message.angle_increment = scan.angle_increment
    message.angle_max = scan.angle_min + scan.angle_increment * (len(scan.ranges) - 1)
    message.scan_time = period_s
    message.range_min, message.range_max = scan.range_min, scan.range_max
    message.ranges = array.array("f", scan.ranges.tobytes())
    return message


def to_occupancy_grid(grid, stamp_ns, frame):
    message = OccupancyGrid(header=to_header(stamp_ns, frame))
    message.info.map_load_time = to_time(stamp_ns)
    message.info.resolution = grid.resolution
    message.info.height, message.info.width = grid.data.shape
    message.info.origin = to_pose(Pose2D(grid.origin_x, grid.origin_y, 0.0))
    message.data = array.array("b", grid.data.tobytes())
    return message


def to_path(points, stamp_ns, frame):
    message = Path(header=to_header(stamp_ns, frame))
    for x, y, *yaw in points.tolist():
        pose = Pose2D(x, y, yaw[0] if yaw else 0.0)
        message.poses.append(PoseStamped(header=message.header, pose=to_pose(pose)))
    return message
