"""A planner of somebody else in a process of its own: plain rclpy, no suite. It drives
ahead, but for what its kind is.

Usage: foreign_planner.py NOTE KIND...: the file NOTE counts the starts, the n-th start
does the n-th kind, the last one for all starts beyond. What the curious one hears of
the truth, and how often the late one is asked, is in NOTE.heard.
"""

import math
import os
import signal
import sys
import time
from pathlib import Path

import rclpy
from geometry_msgs.msg import PoseStamped, Twist, TwistStamped
from nav_msgs.msg import Odometry
from rcl_interfaces.srv import SetParameters
from rclpy.clock import Clock as NodeClock
from rclpy.clock import ClockType
from rclpy.executors import SingleThreadedExecutor
from rclpy.node import Node
from rclpy.parameter import Parameter
from rclpy.qos import qos_profile_sensor_data
from rosgraph_msgs.msg import Clock
from sensor_msgs.msg import LaserScan
from std_msgs.msg import Bool, Float64, String
from std_srvs.srv import SetBool, Trigger

SPEED_MPS = 0.5
CYCLES = 30  # driven properly before a fault in the middle of a trial
AT_GOAL = Odometry()
AT_GOAL.header.frame_id = "odom"
AT_GOAL.pose.pose.position.x, AT_GOAL.pose.pose.position.y = (
    -2.25,
    13.0,
)  # the challenge's goal
AT_GOAL.pose.pose.orientation.w = 1.0
AT_GOAL.twist.twist.linear.x = 2.0
FORGED = {  # by kind: what is published with each scan
    "poses": [("odom", AT_GOAL), ("ground_truth/odom", AT_GOAL)],
    "older_stamps": [("/clock", Clock())],
    "no_contact": [("collision", Bool())],
    "score": [("/score", Float64(data=0.5))],
    "twin": [("scan", LaserScan())],
    "talks": [("thoughts", String(data=60_000 * "x"))],
}
COMMANDS = {"wrong_type": String, "wall_clock": TwistStamped}


class ForeignPlanner(Node):
    def __init__(self, kind, heard):
        simulated = Parameter("use_sim_time", value=kind == "timer")
        name = "simulator" if kind == "twin" else "foreign"
        super().__init__(name, parameter_overrides=[simulated])
        self.kind = kind
        if kind == "timer":
            self.create_timer(0.2, lambda: self.commands.publish(self.command()))
        self.cycles = 0
        sensor = qos_profile_sensor_data  # as a free running simulator sends its scans
        qos = sensor if kind == "best_effort" else 10
        # A node of its own that only publishes need not be spun.
        sender = rclpy.create_node("sender") if kind == "apart" else self
        of = COMMANDS.get(kind, Twist)
        self.commands = sender.create_publisher(of, "cmd_vel", qos)
        self.create_subscription(
            LaserScan, "scan", self.answer, sensor if kind == "dozes" else 10
        )
        self.create_subscription(Odometry, "odom", lambda _: None, 10)
        self.create_subscription(PoseStamped, "goal_pose", lambda _: None, 10)
        self.forged = [
            (self.create_publisher(type(message_type), topic, 10), message_type)
            for topic, message_type in FORGED.get(kind, [])
        ]
        if kind == "silent":
            self.create_subscription(String, "missing_path", lambda _: None, 10)
        if kind == "one_shot":
            self.create_subscription(String, "outcome", self.retire, 10)
        if kind == "curious":
            listen = lambda truth: heard.write_text(truth.header.frame_id)  # noqa: E731
            self.create_subscription(Odometry, "ground_truth/odom", listen, 10)
            self.second = self.create_publisher(Twist, "cmd_vel", 10)
        start = [Parameter("start_y_m", value=12.5).to_parameter_msg()]
        self.requests = {
            "parameters": (
                "set_parameters",
                SetParameters,
                SetParameters.Request(parameters=start),
            ),
            "reset": ("reset", Trigger, Trigger.Request()),
            "pause": ("pause", SetBool, SetBool.Request(data=True)),
        }
        if kind in self.requests:
            service, of, self.request = self.requests[kind]
            self.service = self.create_client(of, f"/simulator/{service}")

    def retire(self, outcome):
        if outcome.data != "running":  # the trial is over
            sys.exit(0)

    def answer(self, scan):
        self.cycles += 1
        for sender, message in self.forged:
            if hasattr(message, "header"):
                message.header.stamp = scan.header.stamp
            sender.publish(message)
        if self.kind in self.requests:
            self.service.call_async(self.request)
        if self.kind in ("silent", "timer") or (
            self.kind == "dozes" and self.cycles % 10 > 4
        ):
            return
        if self.cycles > CYCLES:
            self.fail()
        self.commands.publish(self.command())

    def command(self):
        if self.kind == "wrong_type":
            return String(data="forward")
        if self.kind == "broken_command":
            return b"\0\1\0"
        if self.kind == "wall_clock":  # stands still
            command = TwistStamped()
            command.header.stamp = self.get_clock().now().to_msg()
            return command
        command = Twist()
        command.linear.x = 0.0 if self.kind == "poses" else SPEED_MPS
        if self.kind == "nan" and self.cycles > CYCLES:
            command.linear.x = math.nan
        return command

    def fail(self):
        if self.kind == "dies":
            os.kill(os.getpid(), signal.SIGKILL)
        elif self.kind == "exits":
            sys.exit(3)
        elif self.kind == "hangs":
            time.sleep(600)


class Late(Node):
    """A second node, which says that the planner is ready once it has been asked twice."""

    def __init__(self, notes):
        super().__init__("late")
        self.notes = notes
        self.asked = 0
        self.create_service(Trigger, "~/ready", self.answer)

    def answer(self, _, response):
        self.asked += 1
        response.success = self.asked > 1
        self.notes.write_text(str(self.asked))
        return response


if __name__ == "__main__":
    note = Path(sys.argv[1])
    starts = int(note.read_text()) if note.exists() else 0
    note.write_text(str(starts + 1))
    kinds = sys.argv[2:]
    kind = kinds[min(starts, len(kinds) - 1)]
    heard = note.with_suffix(".heard")
    if kind == "elsewhere":
        os.environ["ROS_DOMAIN_ID"] = "0"
    rclpy.init()
    planner = ForeignPlanner(kind, heard)
    executor = SingleThreadedExecutor()
    executor.add_node(planner)
    if kind == "late":
        wall = NodeClock(clock_type=ClockType.STEADY_TIME)
        timer = planner.create_timer(
            3.0, lambda: (timer.cancel(), executor.add_node(Late(heard))), clock=wall
        )
    executor.spin()
