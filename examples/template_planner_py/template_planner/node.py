"""The algorithm as a node in plain rclpy. It runs wherever ROS does, without the suite.

Subscribes: goal_pose, scan, and the robot's pose in the goal's frame: odom, or
amcl_pose with the parameter `use_map`.
Publishes: cmd_vel, one command per scan, which a simulator in lockstep waits for.
"""

import math

import numpy as np
import rclpy
from geometry_msgs.msg import PoseStamped, PoseWithCovarianceStamped, Twist
from nav_msgs.msg import Odometry
from rclpy.executors import ExternalShutdownException
from rclpy.node import Node
from rclpy.qos import qos_profile_sensor_data
from sensor_msgs.msg import LaserScan

from template_planner.core import decide


class TemplatePlanner(Node):
    """Answers each scan with a command."""

    def __init__(self):
        super().__init__("template_planner")
        self.max_speed_mps = self.declare_parameter("max_speed_mps", 0.5).value
        self.max_turn_radps = self.declare_parameter("max_turn_radps", 1.5).value
        use_map = self.declare_parameter("use_map", False).value
        self.goal = None
        self.pose = None
        self.commands = self.create_publisher(Twist, "cmd_vel", 10)
        self.create_subscription(PoseStamped, "goal_pose", self.on_goal, 10)
        if use_map:
            self.create_subscription(
                PoseWithCovarianceStamped, "amcl_pose", self.on_pose, 10
            )
        else:
            self.create_subscription(Odometry, "odom", self.on_pose, 10)
        self.create_subscription(
            LaserScan, "scan", self.on_scan, qos_profile_sensor_data
        )

    def on_goal(self, message):
        """Store the goal."""
        self.goal = message.pose.position

    def on_pose(self, message):
        """Store the robot's pose."""
        self.pose = message.pose.pose

    def on_scan(self, scan):
        """Send a command; a stop while goal or pose are missing."""
        command = Twist()
        if self.goal is not None and self.pose is not None:
            beams = np.arange(len(scan.ranges))
            command.linear.x, command.angular.z = decide(
                self.goal_in_base(),
                scan.ranges,
                scan.angle_min + scan.angle_increment * beams,
                self.max_speed_mps,
                self.max_turn_radps,
            )
        self.commands.publish(command)

    def goal_in_base(self):
        """Return the goal (x, y) in m as the robot sees it."""
        yaw = 2.0 * math.atan2(self.pose.orientation.z, self.pose.orientation.w)
        dx = self.goal.x - self.pose.position.x
        dy = self.goal.y - self.pose.position.y
        ahead = math.cos(yaw) * dx + math.sin(yaw) * dy
        left = math.cos(yaw) * dy - math.sin(yaw) * dx
        return ahead, left


def main():
    """Run the node until SIGINT or SIGTERM."""
    rclpy.init()
    node = TemplatePlanner()
    try:
        rclpy.spin(node)
    except (KeyboardInterrupt, ExternalShutdownException):
        node.destroy_node()
        rclpy.try_shutdown()


if __name__ == "__main__":
    main()
