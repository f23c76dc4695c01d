"""Play Nav2 to its trial node.

A lifecycle manager, a navigator's goal states and a planner's plan. Plain rclpy.

Usage: nav2_stand_in.py TRIAL_NODE, a script, which is run in a process of its own as in
a launch, and told to end as by Ctrl-C. Prints what ~/ready says, what the manager is
asked to do, and how the script ended.
"""

import sys

from action_msgs.msg import GoalStatus, GoalStatusArray
from geometry_msgs.msg import PoseStamped
from nav2_msgs.srv import ManageLifecycleNodes
from nav_msgs.msg import Path
from rclpy.qos import QoSDurabilityPolicy, QoSProfile
from ros_peer import Peer, Process
from std_srvs.srv import Trigger

TASKS = {
    ManageLifecycleNodes.Request.STARTUP: "STARTUP",
    ManageLifecycleNodes.Request.RESET: "RESET",
}
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


trial_node = Process(sys.argv[1])
peer = Peer("stand_in")
peer.node.create_service(Trigger, "lifecycle_manager_navigation/is_active", answer)
peer.node.create_service(
    ManageLifecycleNodes, "lifecycle_manager_navigation/manage_nodes", obey
)
latched = QoSProfile(depth=1, durability=QoSDurabilityPolicy.TRANSIENT_LOCAL)
statuses = peer.node.create_publisher(
    GoalStatusArray, "navigate_to_pose/_action/status", latched
)
plans = peer.node.create_publisher(Path, "plan", 1)


def look():
    if trial_node.process.poll() is not None:
        raise SystemExit(f"the node has ended: {trial_node.end()[1]}")


peer.node.create_timer(1.0, look)


def until_it_says(text):
    responses = []
    peer.wait(
        lambda: (
            responses.append(peer.call("nav2_trial/ready"))
            or responses[-1].message == text
        ),
        text,
    )
    print(responses[-1].success, responses[-1].message)


def reset():
    return peer.call("nav2_trial/reset")


def take_goal():
    statuses.publish(
        GoalStatusArray(status_list=[GoalStatus(status=GoalStatus.STATUS_EXECUTING)])
    )


peer.wait(lambda: statuses.get_subscription_count() and plans.get_subscription_count())
reset()  # nothing is up: nothing is asked of the manager
until_it_says("Nav2 is being brought up")
state["active"] = True
until_it_says("Nav2 has taken no goal yet")
take_goal()
until_it_says("Nav2 has no plan yet")
plans.publish(Path(poses=[PoseStamped()]))
until_it_says("")
for _ in range(3):  # one reset after the other comes through
    reset()
    until_it_says("Nav2 has taken no goal yet")
# a goal by action is taken, and said so once, before Nav2 is known to be active
state["begun"] = take_goal
reset()
until_it_says("Nav2 has no plan yet")
state["obedient"] = False
refused = reset()
print(refused.success, refused.message)
until_it_says("lifecycle_manager_navigation could not do RESET")
code, log = trial_node.stop()
print("ended with", code, "Traceback" in log)
print(log, file=sys.stderr)
peer.close()
