"""A planner that drives at 0.3 m/s and meddles in another way each time it is started: plain rclpy, no suite.

Usage: meddling_planner.py NOTE KIND...: the file NOTE counts the starts, the n-th start does the n-th kind. What the
curious one hears of the truth is noted in NOTE.heard.
"""

import sys
from pathlib import Path

import rclpy
from geometry_msgs.msg import PoseStamped, Twist
from nav_msgs.msg import Odometry
from rcl_interfaces.srv import SetParameters
from rclpy.node import Node
from rclpy.parameter import Parameter
from rosgraph_msgs.msg import Clock
from sensor_msgs.msg import LaserScan
from std_msgs.msg import Bool, Float64
from std_srvs.srv import SetBool, Trigger

AT_GOAL = Odometry()
AT_GOAL.header.frame_id = "odom"
AT_GOAL.pose.pose.position.x, AT_GOAL.pose.pose.position.y = -2.25, 13.0  # the challenge's goal
AT_GOAL.pose.pose.orientation.w = 1.0
AT_GOAL.twist.twist.linear.x = 2.0
FORGED = {  # by kind: what is published with each scan
    "poses": [("odom", AT_GOAL), ("ground_truth/odom", AT_GOAL)],
    "older_stamps": [("/clock", Clock())],
    "no_contact": [("collision", Bool())],
    "score": [("/score", Float64(data=0.5))],
    "twin": [("scan", LaserScan())],
}


class MeddlingPlanner(Node):
    def __init__(self, kind, heard):
        super().__init__("simulator" if kind == "twin" else "meddler")
        self.kind = kind
        self.commands = self.create_publisher(Twist, "cmd_vel", 10)
        self.create_subscription(LaserScan, "scan", self.answer, 10)
        self.create_subscription(Odometry, "odom", lambda _: None, 10)
        self.create_subscription(PoseStamped, "goal_pose", lambda _: None, 10)
        self.forged = [(self.create_publisher(type(one), topic, 10), one) for topic, one in FORGED.get(kind, [])]
        if kind == "curious":
            self.create_subscription(
                Odometry, "ground_truth/odom", lambda truth: heard.write_text(truth.header.frame_id), 10
            )
            self.second = self.create_publisher(Twist, "cmd_vel", 10)
        self.parameters = self.create_client(SetParameters, "/simulator/set_parameters")
        self.reset = self.create_client(Trigger, "/simulator/reset")
        self.pause = self.create_client(SetBool, "/simulator/pause")

    def answer(self, scan):
        for sender, message in self.forged:
            if hasattr(message, "header"):
                message.header.stamp = scan.header.stamp
            sender.publish(message)
        if self.kind == "parameters":
            start = [Parameter("start_y_m", value=12.5).to_parameter_msg()]
            self.parameters.call_async(SetParameters.Request(parameters=start))
        elif self.kind == "reset":
            self.reset.call_async(Trigger.Request())
        elif self.kind == "pause":
            self.pause.call_async(SetBool.Request(data=True))
        if self.kind == "broken_command":
            self.commands.publish(b"\0\1\0")
            return
        command = Twist()
        command.linear.x = 0.0 if self.kind == "poses" else 0.3
        self.commands.publish(command)


if __name__ == "__main__":
    note = Path(sys.argv[1])
    starts = int(note.read_text()) if note.exists() else 0
    note.write_text(str(starts + 1))
    kinds = sys.argv[2:]
    rclpy.init()
    rclpy.spin(MeddlingPlanner(kinds[min(starts, len(kinds) - 1)], note.with_suffix(".heard")))
