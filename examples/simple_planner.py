"""A planner in plain rclpy that drives to the most open direction near the goal's; it imports nothing of the suite."""

from math import atan2, cos, sin

import rclpy
from geometry_msgs.msg import PoseStamped, Twist
from nav_msgs.msg import Odometry
from rclpy.node import Node
from rclpy.qos import qos_profile_sensor_data
from sensor_msgs.msg import LaserScan


class SimplePlanner(Node):
    """Answers each scan with a command."""

    def __init__(self):
        super().__init__("simple_planner")
        self.goal = self.pose = None
        self.commands = self.create_publisher(Twist, "cmd_vel", 10)
        self.create_subscription(
            PoseStamped,
            "goal_pose",
            lambda m: setattr(self, "goal", m.pose.position),
            10,
        )
        self.create_subscription(
            Odometry, "odom", lambda m: setattr(self, "pose", m.pose.pose), 10
        )
        self.create_subscription(LaserScan, "scan", self.drive, qos_profile_sensor_data)

    def drive(self, scan):
        """Turn to the best of 31 headings, and go the slower the nearer the obstacle ahead."""
        command = Twist()
        if self.goal and self.pose:
            yaw = 2.0 * atan2(self.pose.orientation.z, self.pose.orientation.w)
            goal = (
                atan2(
                    self.goal.y - self.pose.position.y,
                    self.goal.x - self.pose.position.x,
                )
                - yaw
            )
            hits = [
                (min(r, 5.0), scan.angle_min + i * scan.angle_increment)
                for i, r in enumerate(scan.ranges)
            ][::4]
            heading = max(
                (0.1 * k for k in range(-15, 16)),
                key=lambda way: free(hits, way) - abs(way - goal),
            )
            command.angular.z = max(-1.5, min(1.5, 2.0 * heading))
            command.linear.x = max(0.0, min(0.5, 0.4 * free(hits, 0.0) - 0.1)) * cos(
                heading
            )
        self.commands.publish(command)


def free(hits, way, half_width=0.4):
    """Return how far a corridor in that direction is free of hits (range, bearing)."""
    inside = [
        r * cos(bearing - way)
        for r, bearing in hits
        if abs(r * sin(bearing - way)) < half_width
    ]
    return min((ahead for ahead in inside if ahead > 0.0), default=5.0)


if __name__ == "__main__":
    rclpy.init()
    rclpy.spin(SimplePlanner())
