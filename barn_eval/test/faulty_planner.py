"""A planner in a process of its own that goes wrong in another way each time it is started: plain rclpy, no suite.

Usage: faulty_planner.py NOTE KIND...: the file NOTE counts the starts, the n-th start does the n-th kind, the last one
for all starts beyond.
"""

import math
import os
import signal
import sys
import time
from pathlib import Path

import rclpy
from geometry_msgs.msg import PoseStamped, Twist
from nav_msgs.msg import Odometry
from rclpy.node import Node
from rclpy.qos import qos_profile_sensor_data
from sensor_msgs.msg import LaserScan
from std_msgs.msg import String

CYCLES = 30  # driven properly before a fault in the middle of a trial


class FaultyPlanner(Node):
    def __init__(self, kind):
        super().__init__("faulty_planner")
        self.kind = kind
        self.cycles = 0
        self.commands = self.create_publisher(String if kind == "wrong_type" else Twist, "cmd_vel", 10)
        # a free running simulator sends its scans as sensors do
        self.create_subscription(LaserScan, "scan", self.answer, qos_profile_sensor_data if kind == "dozes" else 10)
        self.create_subscription(Odometry, "odom", lambda _: None, 10)
        self.create_subscription(PoseStamped, "goal_pose", lambda _: None, 10)
        self.thoughts = self.create_publisher(String, "thoughts", 10) if kind == "talks" else None
        if kind == "one_shot":
            self.create_subscription(String, "outcome", self.retire, 10)

    def retire(self, outcome):
        if outcome.data != "running":  # the trial is over
            sys.exit(0)

    def answer(self, _):
        self.cycles += 1
        command = Twist()
        command.linear.x = 0.5
        if self.kind == "wrong_type":
            self.commands.publish(String(data="forward"))
            return
        if self.kind == "silent" or (self.kind == "dozes" and self.cycles % 10 > 4):
            return
        if self.thoughts is not None:
            self.thoughts.publish(String(data=60_000 * "x"))
        if self.cycles > CYCLES:
            if self.kind == "nan":
                command.linear.x = math.nan
            elif self.kind == "dies":
                os.kill(os.getpid(), signal.SIGKILL)
            elif self.kind == "exits":
                sys.exit(3)
            elif self.kind == "hangs":
                time.sleep(600)
        self.commands.publish(command)


if __name__ == "__main__":
    note = Path(sys.argv[1])
    starts = int(note.read_text()) if note.exists() else 0
    note.write_text(str(starts + 1))
    kinds = sys.argv[2:]
    rclpy.init()
    rclpy.spin(FaultyPlanner(kinds[min(starts, len(kinds) - 1)]))
