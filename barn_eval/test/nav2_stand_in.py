"""Play Nav2 to its trial node: a lifecycle manager, a navigator's goal states and a planner's plan. Plain rclpy.

Usage: nav2_stand_in.py FOLDER_OF_TRIAL_NODE. Prints what ~/ready says, and what the manager is asked to do.
"""

import sys
import time

import rclpy
from action_msgs.msg import GoalStatus, GoalStatusArray
from geometry_msgs.msg import PoseStamped
from nav_msgs.msg import Path
from rclpy.executors import SingleThreadedExecutor
from rclpy.qos import QoSDurabilityPolicy, QoSProfile
from std_srvs.srv import Trigger

sys.path.insert(0, sys.argv[1])
from trial_node import TrialNode

state = {"active": False, "obedient": True}


async def obey(name):
    print(name)
    state["active"] = state["obedient"] and name == "STARTUP"
    return state["obedient"]


def answer(_, response):
    response.success = state["active"]
    return response


rclpy.init()
node = TrialNode()
node.command = obey  # in place of a service of a type that comes with Nav2
other = rclpy.create_node("stand_in")
other.create_service(Trigger, "lifecycle_manager_navigation/is_active", answer)
latched = QoSProfile(depth=1, durability=QoSDurabilityPolicy.TRANSIENT_LOCAL)
statuses = other.create_publisher(GoalStatusArray, "navigate_to_pose/_action/status", latched)
plans = other.create_publisher(Path, "plan", 1)
reset = other.create_client(Trigger, "nav2_trial/reset")
ready = other.create_client(Trigger, "nav2_trial/ready")
executor = SingleThreadedExecutor()
executor.add_node(node)
executor.add_node(other)


def call(client):
    future = client.call_async(Trigger.Request())
    executor.spin_until_future_complete(future, timeout_sec=10.0)
    return future.result()


def until_it_says(text):
    deadline = time.monotonic() + 100.0
    while (found := call(ready)).message != text and time.monotonic() < deadline:
        executor.spin_once(timeout_sec=0.05)
    print(found.success, found.message)


for client in (reset, ready):
    while not client.service_is_ready():
        executor.spin_once(timeout_sec=0.05)
while not (statuses.get_subscription_count() and plans.get_subscription_count()):
    executor.spin_once(timeout_sec=0.05)
call(reset)  # nothing is up: nothing is asked of the manager
until_it_says("Nav2 is being brought up")
state["active"] = True
until_it_says("Nav2 has taken no goal yet")
working = GoalStatus(status=GoalStatus.STATUS_EXECUTING)
statuses.publish(GoalStatusArray(status_list=[working]))
until_it_says("Nav2 has no plan yet")
plans.publish(Path(poses=[PoseStamped()]))
until_it_says("")
call(reset)
until_it_says("Nav2 has taken no goal yet")
state["obedient"] = False
refused = call(reset)
print(refused.success, refused.message)
until_it_says("lifecycle_manager_navigation could not do RESET")
rclpy.shutdown()
