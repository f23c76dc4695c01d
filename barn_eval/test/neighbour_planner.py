"""A planner as others write them, in a process of its own: plain rclpy, no suite.

Usage: neighbour_planner.py KIND NOTES, where what it lives through is added to the file NOTES.

managed: a lifecycle node named `managed` that becomes active with the tenth scan and takes goals by the action
navigate_to_pose: the first it works on until it is cancelled, the second it aborts, the third it refuses at first.
inactive: the same, but never active. drives, best_effort, wall_clock, deaf: see `Plain`. late: as drives, with a second
node, named `late` and started a while after the first, that says whether the planner is ready.
"""

import sys
import time
from pathlib import Path

import rclpy
from geometry_msgs.msg import PoseStamped, Twist, TwistStamped
from nav_msgs.msg import Odometry
from rclpy.action import ActionServer, CancelResponse, GoalResponse
from rclpy.callback_groups import ReentrantCallbackGroup
from rclpy.clock import Clock, ClockType
from rclpy.executors import MultiThreadedExecutor, SingleThreadedExecutor
from rclpy.lifecycle import LifecycleNode, TransitionCallbackReturn
from rclpy.node import Node
from rclpy.qos import qos_profile_sensor_data
from sensor_msgs.msg import LaserScan
from std_srvs.srv import Trigger

SPEED_MPS = 0.5


class Plain(Node):
    """Drives ahead. best_effort: sends without guarantee of delivery; wall_clock: stands still and stamps by its own
    clock; deaf: waits for its goal on another topic.
    """

    def __init__(self, kind):
        super().__init__("plain")
        self.kind = kind
        self.stamped = kind == "wall_clock"
        profile = qos_profile_sensor_data if kind == "best_effort" else 10
        self.commands = self.create_publisher(TwistStamped if self.stamped else Twist, "cmd_vel", profile)
        self.create_subscription(PoseStamped, "goal" if kind == "deaf" else "goal_pose", lambda _: None, 10)
        self.create_subscription(Odometry, "odom", lambda _: None, 10)
        self.create_subscription(LaserScan, "scan", self.answer, 10)

    def answer(self, _):
        if self.stamped:
            command = TwistStamped()
            command.header.stamp = self.get_clock().now().to_msg()
        else:
            command = Twist()
            command.linear.x = SPEED_MPS
        self.commands.publish(command)


class Late(Node):
    """Says that the planner is ready once it has been asked twice."""

    def __init__(self, notes):
        super().__init__("late")
        self.notes, self.asked = notes, 0
        self.create_service(Trigger, "~/ready", self.answer)

    def answer(self, _, response):
        self.asked += 1
        response.success = self.asked > 1
        self.notes.write_text(f"asked {self.asked} times")
        return response


class Managed(LifecycleNode):
    """Has a life cycle and an action."""

    def __init__(self, stays_inactive, notes):
        super().__init__("managed")
        from nav2_msgs.action import NavigateToPose  # noqa: PLC0415 (the others do without)
        from nav2_msgs.msg import Costmap  # noqa: PLC0415

        self.costmap = Costmap(data=[1, 2, 3])
        self.costmap.metadata.layer = "master"
        self.costmaps = self.create_publisher(Costmap, "costmap_raw", 10)
        self.kind, self.notes, self.stays_inactive = NavigateToPose, notes, stays_inactive
        self.scans = self.goals = self.refusals = 0
        self.working = self.live = False
        group = ReentrantCallbackGroup()
        self.commands = self.create_publisher(Twist, "cmd_vel", 10)
        self.create_subscription(Odometry, "odom", lambda _: None, 10)
        self.create_subscription(LaserScan, "scan", self.answer, 10)
        self.server = ActionServer(
            self,
            NavigateToPose,
            "navigate_to_pose",
            self.work,
            goal_callback=self.judge,
            cancel_callback=lambda _: CancelResponse.ACCEPT,
            callback_group=group,
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
        self.note(f"goal {self.goals} in {goal.header.frame_id}: {goal.pose.position.x:.1f}")
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
    if kind in ("managed", "inactive"):
        executor = MultiThreadedExecutor(3)
        executor.add_node(Managed(kind == "inactive", Path(path)))
        executor.spin()
    else:
        plain = Plain(kind)
        executor = SingleThreadedExecutor()
        executor.add_node(plain)
        if kind == "late":
            wall = Clock(clock_type=ClockType.STEADY_TIME)
            timer = plain.create_timer(3.0, lambda: (timer.cancel(), executor.add_node(Late(Path(path)))), clock=wall)
        executor.spin()
