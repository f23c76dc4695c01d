"""Give every trial a fresh Nav2, and tell the evaluator when Nav2 is ready.

The evaluator uses it as `planner_node:=/nav2_trial`. Costmaps, goal and the
controller's memory would otherwise outlive the world that they belong to. Between two
trials the simulator stands still. It goes on publishing the clock and the transforms of
the start, which Nav2's servers need to become active.

Services
    ~/reset (std_srvs/Trigger): takes Nav2 down to unconfigured and begins to start it
    again ~/ready (std_srvs/Trigger): succeeds once Nav2 is active, works on a goal and
    has a
        plan; otherwise its message says what is missing
Calls
    MANAGER/manage_nodes (nav2_msgs/ManageLifecycleNodes)
    MANAGER/is_active (std_srvs/Trigger)
Subscribes
    navigate_to_pose/_action/status (action_msgs/GoalStatusArray), plan (nav_msgs/Path)
Parameter
    manager (lifecycle_manager_navigation): name of the lifecycle manager
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

WORKING_STATUSES = (GoalStatus.STATUS_ACCEPTED, GoalStatus.STATUS_EXECUTING)
POLL_PERIOD_S = 0.2


class TrialNode(Node):
    """Commands the lifecycle manager and tracks the state of Nav2."""

    def __init__(self):
        super().__init__("nav2_trial")
        self._manager = self.declare_parameter(
            "manager", "lifecycle_manager_navigation"
        ).value
        self._is_active = False
        self._has_goal = False
        self._has_plan = False
        self._is_restarting = False
        self._failure = ""
        # The manager answers only between two changes of state, so nothing waits for
        # its answer to a poll.
        self._poll_answer = None
        self._active_client = self.create_client(Trigger, f"{self._manager}/is_active")
        # A reset waits for the manager's answers, so it must not keep their callbacks
        # from running.
        group = ReentrantCallbackGroup()
        # A client that is used as soon as it is made can miss the answer. This one is
        # made here, and the poll checks that it is connected.
        self._manage_client = self.create_client(
            ManageLifecycleNodes, f"{self._manager}/manage_nodes", callback_group=group
        )
        latched = QoSProfile(depth=1, durability=QoSDurabilityPolicy.TRANSIENT_LOCAL)
        self.create_subscription(
            GoalStatusArray, "navigate_to_pose/_action/status", self._on_status, latched
        )
        self.create_subscription(Path, "plan", self._on_plan, 1)
        self.create_service(Trigger, "~/reset", self._on_reset, callback_group=group)
        self.create_service(Trigger, "~/ready", self._on_ready)
        # By the machine's clock: simulated time stands still while Nav2 starts.
        clock = Clock(clock_type=ClockType.STEADY_TIME)
        self.create_timer(POLL_PERIOD_S, self._poll, clock=clock)

    def missing(self):
        """Return what Nav2 still lacks, or an empty text."""
        if self._failure:
            return self._failure
        if self._is_restarting or not self._is_active:
            return "Nav2 is being brought up"
        if not self._has_goal:
            return "Nav2 has taken no goal yet"
        return "" if self._has_plan else "Nav2 has no plan yet"

    def _poll(self):
        if self._poll_answer is not None and self._poll_answer.done():
            is_active = self._poll_answer.result().success
            self._is_active = is_active and not self._is_restarting
            self._poll_answer = None
        is_connected = (
            self._active_client.service_is_ready()
            and self._manage_client.service_is_ready()
        )
        if self._poll_answer is None and not self._is_restarting and is_connected:
            self._poll_answer = self._active_client.call_async(Trigger.Request())

    def _on_status(self, message):
        # A status comes only once, so it counts even before a poll has found Nav2
        # active.
        self._has_goal = any(
            goal.status in WORKING_STATUSES for goal in message.status_list
        )

    def _on_plan(self, message):
        self._has_plan = bool(message.poses)

    async def _on_reset(self, _, response):
        """Answer once Nav2 is down, so that no goal reaches the last trial."""
        self._failure = ""
        # A Nav2 that is not active yet has nothing to forget.
        if self._is_active:
            self._is_active = False
            self._is_restarting = True
            await self._change_state("RESET")
            self._has_goal = False
            self._has_plan = False
            self.executor.create_task(self._start)
        response.success = not self._failure
        response.message = self._failure
        return response

    async def _start(self):
        if not self._failure:
            await self._change_state("STARTUP")
        self._is_restarting = False
        self._poll_answer = None

    async def _change_state(self, command):
        """Call the lifecycle manager with STARTUP or RESET and record a failure."""
        self.get_logger().info(f"{command} of Nav2")
        request = ManageLifecycleNodes.Request(
            command=getattr(ManageLifecycleNodes.Request, command)
        )
        answer = await self._manage_client.call_async(request)
        if not answer.success:
            self._failure = f"{self._manager} could not do {command}"
            self.get_logger().error(self._failure)

    def _on_ready(self, _, response):
        response.message = self.missing()
        response.success = not response.message
        return response


def main():
    """Run the node until SIGINT or SIGTERM."""
    # rclpy ends the spinning on Ctrl-C. An exception in addition could strike anywhere.
    signal.signal(signal.SIGINT, lambda *_: None)
    rclpy.init()
    node = TrialNode()
    try:
        rclpy.spin(node)
    except ExternalShutdownException:
        pass
    except Exception:
        # A callback that runs while the context goes away may fail; that is no error.
        if rclpy.ok():
            raise
    finally:
        node.destroy_node()
        rclpy.try_shutdown()


if __name__ == "__main__":
    main()
