"""Give every trial a fresh Nav2, and say when it is ready; the evaluator uses it as `planner_node:=/nav2_trial`.

Costmaps, goal and the controller's memory would otherwise outlive the world that they belong to. Between two trials
the simulator stands still and keeps publishing the clock and the transforms of the start, which is what Nav2's servers
need to become active.

Services
    ~/reset (std_srvs/Trigger): take Nav2 down to unconfigured, and begin to bring it up again
    ~/ready (std_srvs/Trigger): succeeds once Nav2 is active, works on a goal and has a plan; else says what is missing
Calls
    MANAGER/manage_nodes (nav2_msgs/ManageLifecycleNodes), MANAGER/is_active (std_srvs/Trigger)
Subscribes
    navigate_to_pose/_action/status (action_msgs/GoalStatusArray), plan (nav_msgs/Path)
Parameter `manager` (lifecycle_manager_navigation): name of the lifecycle manager.
"""

import signal

import rclpy
from action_msgs.msg import GoalStatus, GoalStatusArray
from nav2_msgs.srv import ManageLifecycleNodes
from nav_msgs.msg import Path
from rclpy.callback_groups import ReentrantCallbackGroup
from rclpy.clock import Clock, ClockType
from rclpy.executors import ExternalShutdownException
from rclpy.node import Node
from rclpy.qos import QoSDurabilityPolicy, QoSProfile
from std_srvs.srv import Trigger

WORKING = (GoalStatus.STATUS_ACCEPTED, GoalStatus.STATUS_EXECUTING)
POLL_PERIOD_S = 0.2


class TrialNode(Node):
    """Leads the lifecycle manager and keeps in mind how far Nav2 is."""

    def __init__(self):
        super().__init__("nav2_trial")
        self._manager = self.declare_parameter(
            "manager", "lifecycle_manager_navigation"
        ).value
        self._active = self._goal = self._plan = False
        self._renewing = False
        self._failure = ""
        self._asked = None  # the manager answers only between two changes, so its answers are not waited for
        self._is_active = self.create_client(Trigger, f"{self._manager}/is_active")
        # a reset waits for the manager's answers, so it must not keep their callbacks from running
        group = ReentrantCallbackGroup()
        # made once, and connected by the first reset: a client that is used as soon as it is made can miss the answer
        self._manage = self.create_client(
            ManageLifecycleNodes, f"{self._manager}/manage_nodes", callback_group=group
        )
        latched = QoSProfile(depth=1, durability=QoSDurabilityPolicy.TRANSIENT_LOCAL)
        self.create_subscription(
            GoalStatusArray, "navigate_to_pose/_action/status", self._on_status, latched
        )
        self.create_subscription(Path, "plan", self._on_plan, 1)
        self.create_service(Trigger, "~/reset", self._on_reset, callback_group=group)
        self.create_service(Trigger, "~/ready", self._on_ready)
        # by the machine's clock: simulated time stands still while Nav2 comes up
        self.create_timer(
            POLL_PERIOD_S, self._poll, clock=Clock(clock_type=ClockType.STEADY_TIME)
        )

    def missing(self):
        """Return what Nav2 still lacks, an empty text if nothing."""
        if self._failure:
            return self._failure
        if self._renewing or not self._active:
            return "Nav2 is being brought up"
        if not self._goal:
            return "Nav2 has taken no goal yet"
        return "" if self._plan else "Nav2 has no plan yet"

    def _poll(self):
        if self._asked is not None and self._asked.done():
            self._active = not self._renewing and self._asked.result().success
            self._asked = None
        connected = (
            self._is_active.service_is_ready() and self._manage.service_is_ready()
        )
        if self._asked is None and not self._renewing and connected:
            self._asked = self._is_active.call_async(Trigger.Request())

    def _on_status(self, message):
        # kept even where the poll has not seen yet that Nav2 is active: a status comes only once
        self._goal = any(one.status in WORKING for one in message.status_list)

    def _on_plan(self, message):
        self._plan = bool(message.poses)

    async def _on_reset(self, _, response):
        """Answer once Nav2 is down: from then on no goal can reach what is left of the last trial."""
        self._failure = ""
        if self._active:  # what is not up yet has nothing to forget
            self._active, self._renewing = False, True
            await self._change("RESET")
            self._goal = self._plan = False
            self.executor.create_task(self._start)
        response.success, response.message = not self._failure, self._failure
        return response

    async def _start(self):
        if not self._failure:
            await self._change("STARTUP")
        self._renewing, self._asked = False, None

    async def _change(self, name):
        """Ask the lifecycle manager for STARTUP or RESET, and note it if not all its nodes have done it."""
        self.get_logger().info(f"{name} of Nav2")
        request = ManageLifecycleNodes.Request(
            command=getattr(ManageLifecycleNodes.Request, name)
        )
        if not (await self._manage.call_async(request)).success:
            self._failure = f"{self._manager} could not do {name}"
            self.get_logger().error(self._failure)

    def _on_ready(self, _, response):
        response.message = self.missing()
        response.success = not response.message
        return response


def main():
    """Run the node until it is told to end."""
    # rclpy ends the spinning on Ctrl-C; an exception on top of that could strike anywhere
    signal.signal(signal.SIGINT, lambda *_: None)
    rclpy.init()
    node = TrialNode()
    try:
        rclpy.spin(node)
    except ExternalShutdownException:
        pass
    except Exception:  # whatever was under way may fail when its context is gone
        if rclpy.ok():
            raise
    finally:
        node.destroy_node()
        rclpy.try_shutdown()


if __name__ == "__main__":
    main()
