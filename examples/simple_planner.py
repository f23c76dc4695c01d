"""A planner in plain rclpy: drive where it is open, near the goal's direction."""

from math import atan2, cos, sin

import rclpy
from geometry_msgs.msg import PoseStamped, Twist
from nav_msgs.msg import Odometry
from rclpy.node import Node
from rclpy.qos import qos_profile_sensor_data
from sensor_msgs.msg import LaserScan

HEADINGS = [0.1 * k for k in range(-15, 16)]  # rad


class SimplePlanner(Node):
    """Answers each scan with a command."""

    def __init__(self):
        super().__init__("simple_planner")
        self.goal = None
        self.pose = None
        self.commands = self.create_publisher(Twist, "cmd_vel", 10)
        self.create_subscription(PoseStamped, "goal_pose", self.on_goal, 10)
        self.create_subscription(Odometry, "odom", self.on_odometry, 10)
        self.create_subscription(
            LaserScan, "scan", self.on_scan, qos_profile_sensor_data
        )

    def on_goal(self, message):
        """Store the goal's position."""
        self.goal = message.pose.position

    def on_odometry(self, message):
        """Store the robot's pose."""
        self.pose = message.pose.pose

    def on_scan(self, scan):
        """Turn to the best heading; drive slower the nearer the obstacle ahead."""
        command = Twist()
        if self.goal and self.pose:
            points = []
            for i in range(0, len(scan.ranges), 4):
                distance = min(scan.ranges[i], 5.0)
                points.append((distance, scan.angle_min + i * scan.angle_increment))

            bearing = self.goal_bearing()
            heading = max(
                HEADINGS,
                key=lambda angle: free_length(points, angle) - abs(angle - bearing),
            )
            speed = max(0.0, min(0.5, 0.4 * free_length(points, 0.0) - 0.1))
            command.linear.x = speed * cos(heading)
            command.angular.z = max(-1.5, min(1.5, 2.0 * heading))
        self.commands.publish(command)

    def goal_bearing(self):
        """Return the direction of the goal as the robot sees it, in rad."""
        yaw = 2.0 * atan2(self.pose.orientation.z, self.pose.orientation.w)
        dx = self.goal.x - self.pose.position.x
        dy = self.goal.y - self.pose.position.y
        return atan2(dy, dx) - yaw


def free_length(points, angle, half_width=0.4):
    """Return how far a corridor is free of points.

    Args:
        points: Range in m and bearing in rad of each return.
        angle: Direction of the corridor in rad.
        half_width: Half the width of the corridor in m.
    """
    length = 5.0
    for distance, bearing in points:
        ahead = distance * cos(bearing - angle)
        aside = distance * sin(bearing - angle)
        if ahead > 0.0 and abs(aside) < half_width:
            length = min(length, ahead)
    return length


if __name__ == "__main__":
    rclpy.init()
    rclpy.spin(SimplePlanner())
