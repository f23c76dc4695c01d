"""A managed planner as others write them, in a process of its own: plain rclpy, no
suite.

Usage: neighbour_planner.py KIND NOTES, where what it lives through is added to the file
NOTES.

managed: a lifecycle node named `managed` that becomes active with the tenth scan and
takes goals by the action navigate_to_pose: the first it works on until it is cancelled,
the second it aborts, the third it refuses at first. inactive: the same, but never
active.
"""

import sys
import time
from pathlib import Path

import rclpy
from geometry_msgs.msg import Twist
from nav2_msgs.action import NavigateToPose
from nav2_msgs.msg import Costmap
from nav_msgs.msg import Odometry
from rclpy.action import ActionServer, CancelResponse, GoalResponse
from rclpy.callback_groups import ReentrantCallbackGroup
from rclpy.executors import MultiThreadedExecutor
from rclpy.lifecycle import LifecycleNode, TransitionCallbackReturn
from sensor_msgs.msg import LaserScan

SPEED_MPS = 0.5


class Managed(LifecycleNode):
    """Has a life cycle and an action."""

    def __init__(self, stays_inactive, notes):
        super().__init__("managed")
        self.costmap = Costmap(data=[1, 2, 3])
        self.costmap.metadata.layer = "master"
        self.costmaps = self.create_publisher(Costmap, "costmap_raw", 10)
        self.kind = NavigateToPose
        self.notes = notes
        self.stays_inactive = stays_inactive
        self.scans = self.goals = self.refusals = 0
        self.working = self.live = False
        group = ReentrantCallbackGroup()
        self.commands = self.create_publisher(Twist, "cmd_vel", 10)
        self.create_subscription(Odometry, "odom", lambda _: None, 10)
        self.create_subscription(LaserScan, "scan", self.answer, 10)
        ways = {
            "goal_callback": self.judge,
            "cancel_callback": lambda _: CancelResponse.ACCEPT,
        }
        self.server = ActionServer(
            self,
            NavigateToPose,
            "navigate_to_pose",
            self.work,
            callback_group=group,
            **ways,
        )
        self.trigger_configure()

    def on_activate(self, state):
        self.note("active")
        self.live = True
        return TransitionCallbackReturn.SUCCESS

    def answer(self, _):
        self.scans += 1
        if self.scans == 10 and not self.stays_inactive:
            self.trigger_activate()
        command = Twist()
        command.linear.x = SPEED_MPS if self.working else 0.0
        self.commands.publish(command)
        self.costmaps.publish(self.costmap)

    def judge(self, goal):
        if self.goals == 2 and not self.refusals:
            self.refusals += 1
            self.note("refused")
            return GoalResponse.REJECT
        return GoalResponse.ACCEPT

    def work(self, handle):
        self.goals += 1
        goal = handle.request.pose
        self.note(
            f"goal {self.goals} in {goal.header.frame_id}: {goal.pose.position.x:.1f}"
        )
        self.working = True
        until = self.scans + 3
        while self.goals == 1 or self.scans < until:
            time.sleep(0.005)
            if handle.is_cancel_requested:
                self.note("canceled")
                handle.canceled()
                return self.kind.Result()
        if self.goals == 2:
            handle.abort()
            return self.kind.Result(error_code=104)
        handle.succeed()
        return self.kind.Result()

    def note(self, text):
        with self.notes.open("a") as file:
            file.write(text + "\n")


if __name__ == "__main__":
    kind, path = sys.argv[1:3]
    rclpy.init()
    executor = MultiThreadedExecutor(3)
    executor.add_node(Managed(kind == "inactive", Path(path)))
    executor.spin()
