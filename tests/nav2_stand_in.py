"""Play Nav2 to its trial node: a lifecycle manager, a navigator's goal states and a planner's plan. Plain rclpy.

Usage: nav2_stand_in.py TRIAL_NODE, a script, which is run in a process of its own as in a launch, and told to end as by
Ctrl-C. Prints what ~/ready says, what the manager is asked to do, and how the script ended.
"""

import signal
import subprocess
import sys
import time

import rclpy
from action_msgs.msg import GoalStatus, GoalStatusArray
from geometry_msgs.msg import PoseStamped
from nav2_msgs.srv import ManageLifecycleNodes
from nav_msgs.msg import Path
from rclpy.executors import SingleThreadedExecutor
from rclpy.qos import QoSDurabilityPolicy, QoSProfile
from std_srvs.srv import Trigger

PATIENCE_S = 600.0
TASKS = {ManageLifecycleNodes.Request.STARTUP: "STARTUP", ManageLifecycleNodes.Request.RESET: "RESET"}
state = {"active": False, "obedient": True, "begun": None}


def obey(request, response):
    task = TASKS[request.command]
    print(task)
    if task == "STARTUP" and state["begun"]:
        state["begun"]()
    state["active"] = state["obedient"] and task == "STARTUP"
    response.success = state["obedient"]
    return response


def answer(_, response):
    response.success = state["active"]
    return response


trial_node = subprocess.Popen([sys.executable, sys.argv[1]], stderr=subprocess.PIPE, text=True)
rclpy.init()
other = rclpy.create_node("stand_in")
other.create_service(Trigger, "lifecycle_manager_navigation/is_active", answer)
other.create_service(ManageLifecycleNodes, "lifecycle_manager_navigation/manage_nodes", obey)
latched = QoSProfile(depth=1, durability=QoSDurabilityPolicy.TRANSIENT_LOCAL)
statuses = other.create_publisher(GoalStatusArray, "navigate_to_pose/_action/status", latched)
plans = other.create_publisher(Path, "plan", 1)
reset = other.create_client(Trigger, "nav2_trial/reset")
ready = other.create_client(Trigger, "nav2_trial/ready")
executor = SingleThreadedExecutor()
executor.add_node(other)


def until(condition):
    deadline = time.monotonic() + PATIENCE_S
    while not condition():
        if time.monotonic() > deadline or trial_node.poll() is not None:
            trial_node.kill()
            raise SystemExit(f"waited in vain: {trial_node.communicate()[1]}")
        executor.spin_once(timeout_sec=0.05)


def call(client):
    future = client.call_async(Trigger.Request())
    until(future.done)
    return future.result()


def until_it_says(text):
    found = []
    until(lambda: found.append(call(ready)) or found[-1].message == text)
    print(found[-1].success, found[-1].message)


def take_goal():
    statuses.publish(GoalStatusArray(status_list=[GoalStatus(status=GoalStatus.STATUS_EXECUTING)]))


until(lambda: reset.service_is_ready() and ready.service_is_ready())
until(lambda: statuses.get_subscription_count() and plans.get_subscription_count())
call(reset)  # nothing is up: nothing is asked of the manager
until_it_says("Nav2 is being brought up")
state["active"] = True
until_it_says("Nav2 has taken no goal yet")
take_goal()
until_it_says("Nav2 has no plan yet")
plans.publish(Path(poses=[PoseStamped()]))
until_it_says("")
for _ in range(3):  # one reset after the other comes through
    call(reset)
    until_it_says("Nav2 has taken no goal yet")
state["begun"] = take_goal  # a goal by action is taken, and said so once, before Nav2 is known to be active
call(reset)
until_it_says("Nav2 has no plan yet")
state["obedient"] = False
refused = call(reset)
print(refused.success, refused.message)
until_it_says("lifecycle_manager_navigation could not do RESET")
trial_node.send_signal(signal.SIGINT)
_, said = trial_node.communicate(timeout=PATIENCE_S)
print("ended with", trial_node.returncode, "Traceback" in said)
print(said, file=sys.stderr)
rclpy.shutdown()
