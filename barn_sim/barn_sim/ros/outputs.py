"""What the simulator node publishes, with messages that are made once and filled again."""

from __future__ import annotations

import array

from geometry_msgs.msg import Pose, PoseWithCovarianceStamped, TransformStamped
from nav_msgs.msg import Odometry as OdometryMessage
from rclpy.node import Node
from rclpy.qos import qos_profile_sensor_data
from rosgraph_msgs.msg import Clock
from sensor_msgs.msg import JointState, LaserScan
from std_msgs.msg import Bool, Header, String

from barn_sim.model import WHEELS, fixed_frames, robot_description
from barn_sim.ros.node_config import LIDAR_FRAME, RunConfig, SimulatorNodeConfig
from barn_sim.simulator import Joints
from barn_worlds.ros.conversions import LATCHED, reliable, to_scan, to_time
from barn_worlds.types import NANOSECONDS, Odometry, Pose2D, Scan, quaternion_from_yaw

try:
    from tf2_msgs.msg import TFMessage
except ImportError:
    TFMessage = None

_DEPTH = 10


class Outputs:
    """The publishers of the node. Stamps are of simulated time; `stamp` sets it for all that follows."""

    def __init__(self, node: Node, config: SimulatorNodeConfig) -> None:
        self._frames = config
        quality = reliable(_DEPTH)
        best_effort = config.scan_reliability == "best_effort" or (
            config.scan_reliability == "auto" and not config.lockstep
        )
        self._clock = node.create_publisher(Clock, "/clock", quality)
        self._odometry = node.create_publisher(OdometryMessage, "odom", quality)
        self._truth = node.create_publisher(OdometryMessage, "ground_truth/odom", quality)
        self._localisation = node.create_publisher(PoseWithCovarianceStamped, "amcl_pose", quality)
        self._collision = node.create_publisher(Bool, "collision", quality)
        self._joints = node.create_publisher(JointState, "joint_states", quality)
        self._description = node.create_publisher(String, "robot_description", LATCHED)
        self._scan = node.create_publisher(LaserScan, "scan", qos_profile_sensor_data if best_effort else quality)
        self._transforms = self._static_transforms = None
        if TFMessage is None:
            node.get_logger().info("tf2_msgs is not installed: /tf and /tf_static are off")
        else:
            self._transforms = node.create_publisher(TFMessage, "/tf", reliable(100))
            self._static_transforms = node.create_publisher(TFMessage, "/tf_static", LATCHED)
        self._make_messages()

    def _make_messages(self) -> None:
        frames = self._frames
        self._clock_message = Clock()
        self._stamp = self._clock_message.clock
        self._bool_message = Bool()
        self._odometry_message = OdometryMessage(
            header=Header(stamp=self._stamp, frame_id=frames.odom_frame), child_frame_id=frames.base_frame
        )
        self._truth_message = OdometryMessage(
            header=Header(stamp=self._stamp, frame_id=frames.map_frame), child_frame_id=frames.base_frame
        )
        self._pose_message = PoseWithCovarianceStamped(header=Header(stamp=self._stamp, frame_id=frames.map_frame))
        self._joint_message = JointState(header=Header(stamp=self._stamp), name=[f"{wheel}_joint" for wheel in WHEELS])
        self._map_to_odom = _transform(self._stamp, frames.map_frame, frames.odom_frame)
        self._odom_to_base = _transform(self._stamp, frames.odom_frame, frames.base_frame)
        self._correction = Pose2D(0.0, 0.0, 0.0)

    def describe(self, config: RunConfig) -> None:
        """Publish once what does not change during a trial, and take its start for the transforms to begin with."""
        _fill_transform(self._map_to_odom, config.start)
        _fill_transform(self._odom_to_base, Pose2D(0.0, 0.0, 0.0))
        self._description.publish(String(data=robot_description(config.lidar)))
        self._scan_time_s = config.control_period_s if self._frames.lockstep else 1.0 / config.lidar.rate_hz
        believed = config.localisation
        exact = believed.mode == "exact"
        for index, std in ((0, believed.position_std_m), (7, believed.position_std_m), (35, believed.yaw_std_rad)):
            self._pose_message.pose.covariance[index] = 0.0 if exact else std**2
        if self._static_transforms is not None:
            fixed = []
            for child, xyz in fixed_frames(config.lidar).items():
                frame = self._frames.lidar_frame if child == LIDAR_FRAME else child
                message = _transform(to_time(0), self._frames.base_frame, frame)
                where = message.transform.translation
                where.x, where.y, where.z = xyz
                fixed.append(message)
            self._static_transforms.publish(TFMessage(transforms=fixed))

    def scan_subscriptions(self) -> int:
        """Return how many subscriptions the scans reach."""
        return int(self._scan.get_subscription_count())

    def stamp(self, stamp_ns: int) -> None:
        """Publish the time; all that follows is of this instant."""
        self._stamp.sec, self._stamp.nanosec = divmod(stamp_ns, NANOSECONDS)
        self._clock.publish(self._clock_message)

    def odometry(self, odometry: Odometry) -> None:
        """Publish what the robot measures of its motion."""
        _fill_odometry(self._odometry_message, odometry)
        self._odometry.publish(self._odometry_message)

    def truth(self, truth: Odometry) -> None:
        """Publish how the robot really moves."""
        _fill_odometry(self._truth_message, truth)
        self._truth.publish(self._truth_message)

    def localisation(self, pose: Pose2D, odometry: Pose2D) -> None:
        """Publish where the robot believes to be, its odometry being as given."""
        _fill_pose(self._pose_message.pose.pose, pose)
        self._localisation.publish(self._pose_message)
        self._correction = pose @ odometry.inverse()

    def transforms(self, odometry: Pose2D) -> None:
        """Publish the transforms that follow from the odometry and the last localisation."""
        if self._transforms is None:
            return
        _fill_transform(self._map_to_odom, self._correction)
        _fill_transform(self._odom_to_base, odometry)
        self.repeat_transforms()

    def repeat_transforms(self) -> None:
        """Publish the transforms as they were last, with the time as it is."""
        if self._transforms is not None:
            self._transforms.publish(TFMessage(transforms=[self._map_to_odom, self._odom_to_base]))

    def collision(self, touched: bool) -> None:
        """Publish whether the robot has touched anything."""
        self._bool_message.data = touched
        self._collision.publish(self._bool_message)

    def joints(self, joints: Joints) -> None:
        """Publish the state of the wheels."""
        self._joint_message.position = array.array("d", joints.positions)
        self._joint_message.velocity = array.array("d", joints.velocities)
        self._joints.publish(self._joint_message)

    def scan(self, scan: Scan) -> None:
        """Publish a scan."""
        message = to_scan(scan, self._frames.lidar_frame, self._scan_time_s)
        message.header.stamp = self._stamp
        self._scan.publish(message)


def _transform(stamp: object, parent: str, child: str) -> TransformStamped:
    message = TransformStamped(header=Header(stamp=stamp, frame_id=parent), child_frame_id=child)
    message.transform.rotation.w = 1.0
    return message


def _fill_pose(message: Pose, pose: Pose2D) -> None:
    message.position.x, message.position.y = pose.x, pose.y
    message.orientation.z, message.orientation.w = quaternion_from_yaw(pose.yaw)


def _fill_odometry(message: OdometryMessage, odometry: Odometry) -> None:
    _fill_pose(message.pose.pose, odometry.pose)
    message.twist.twist.linear.x = odometry.velocity.linear
    message.twist.twist.angular.z = odometry.velocity.angular


def _fill_transform(message: TransformStamped, pose: Pose2D) -> None:
    message.transform.translation.x, message.transform.translation.y = pose.x, pose.y
    message.transform.rotation.z, message.transform.rotation.w = quaternion_from_yaw(pose.yaw)
