"""The routes of a goal to a planner: a topic, or an action that reports its result."""

import math
from typing import Any

from action_msgs.msg import GoalStatus
from geometry_msgs.msg import PoseStamped
from rclpy.action import ActionClient
from rclpy.serialization import deserialize_message
from rclpy.task import Future

from barn_eval.ros.evaluator_loop import EvaluatorLoop, PlannerNotReady, TrialEnded
from barn_eval.ros.graph import GraphView
from barn_eval.ros.readiness import Endpoint
from barn_eval.trials.result import PLANNER
from barn_eval.trials.ros_config import EvaluatorConfig
from barn_eval.trials.trial import MAX_TEXT_LENGTH
from barn_worlds.base.errors import ConfigError
from barn_worlds.messages.topics import GOAL_POSE
from barn_worlds.ros.topics import create_publisher, find_message_class

_POSE_TYPE = "geometry_msgs/PoseStamped"
_RETRY_PERIOD_S = 0.5  # between two attempts at a goal that was refused
_RESULT_STATES = {
    GoalStatus.STATUS_SUCCEEDED: "succeeded",
    GoalStatus.STATUS_CANCELED: "canceled",
    GoalStatus.STATUS_ABORTED: "aborted",
}


class TopicGoal:
    """Goals as messages of a topic, which says nothing about their result."""

    action: tuple[str, str] | None = None
    action_result: str | None = None

    def __init__(self, loop: EvaluatorLoop, view: GraphView, config: EvaluatorConfig):
        """Create the publisher of goals.

        Args:
            loop: Spends the time of waits.
            view: Shows who subscribes.
            config: Limits of waits.
        """
        self._loop = loop
        self._view = view
        self._limit_s = config.patience.service_s
        self._publisher = create_publisher(loop.node, GOAL_POSE)
        # The publisher, as an endpoint that inputs of the planner are compared with.
        self.offered = [Endpoint(self._publisher.topic_name, GOAL_POSE.type_name, b"")]

    def begin(self, goal: bytes) -> None:
        """Publish a goal once all subscriptions, if any, connect; or PlannerNotReady.

        All subscriptions on the graph must connect within the limit. A planner without
        ~/ready gets the goal only once.
        """
        topic = self._publisher.topic_name
        subscriptions = len(self._view.subscriptions(topic))

        def is_connected() -> bool:
            """Return whether all subscriptions on the graph are connected."""
            return bool(self._publisher.get_subscription_count() >= subscriptions)

        if not self._loop.wait(is_connected, self._limit_s, PLANNER):
            raise PlannerNotReady(f"no connection to the subscription to {topic}")
        self.repeat(goal)

    def repeat(self, goal: bytes) -> None:
        """Publish a serialized PoseStamped at once."""
        self._publisher.publish(goal)

    def end(self) -> None:
        """Do nothing: a message cannot be taken back."""


class ActionGoal:
    """Goals of an action such as NavigateToPose, which reports their result."""

    def __init__(self, loop: EvaluatorLoop, config: EvaluatorConfig):
        """Create the action client; ConfigError if its type cannot be used.

        Args:
            loop: Spends the time of waits.
            config: Name and type of the action, and limits of waits.

        Raises:
            ConfigError: If the type is not installed or cannot take a goal.
        """
        self._loop = loop
        self._patience = config.patience
        self._action_class = action_class(config.goal_action_type)
        self._client = ActionClient(loop.node, self._action_class, config.goal_action)
        self._name = loop.node.resolve_service_name(config.goal_action)
        self.action = (self._name, config.goal_action_type)
        self.offered: list[Endpoint] = []
        self._handle: Future | None = None
        self._result: Future | None = None

    @property
    def action_result(self) -> str | None:
        """State of the last goal: sent, rejected, executing, how it ended; or None."""
        # Before the first goal, and after `end`.
        if self._handle is None:
            return None
        if not self._handle.done():
            return "sent"
        handle = self._handle.result()
        if not handle.accepted:
            return "rejected"
        if self._result is None:
            self._result = handle.get_result_async()
        if not self._result.done():
            return "executing"
        return _describe_result(self._result.result())

    def begin(self, goal: bytes) -> None:
        """Send a serialized PoseStamped until accepted, or raise PlannerNotReady.

        PlannerNotReady is raised if the action is missing, silent or keeps rejecting.
        """
        patience = self._patience
        # A server that ~/reset has taken down may be starting again.
        if not self._loop.wait(self._client.server_is_ready, patience.gate_s, PLANNER):
            raise PlannerNotReady(f"no connection to the action {self._name}")

        # A planner that is still starting may refuse goals. The attempts span the time
        # that it is given to become ready.
        for _ in range(1 + math.ceil(patience.gate_s / _RETRY_PERIOD_S)):
            self.repeat(goal)
            if not self._loop.wait(
                lambda: self.action_result != "sent", patience.service_s, PLANNER
            ):
                raise PlannerNotReady(f"no answer from the action {self._name}")
            if self.action_result != "rejected":
                return
            self._loop.sleep(_RETRY_PERIOD_S, PLANNER)
        raise PlannerNotReady(f"the action {self._name} has refused the goal")

    def repeat(self, goal: bytes) -> None:
        """Send a serialized PoseStamped, unless the last is pending or reached."""
        if self.action_result in ("sent", "executing", "succeeded"):
            return
        pose = deserialize_message(goal, PoseStamped)
        self._handle = self._client.send_goal_async(self._action_class.Goal(pose=pose))
        self._result = None

    def end(self) -> None:
        """Cancel a goal that is executing, wait for the answer, forget the goal."""
        is_executing = self.action_result == "executing"
        handle = self._handle
        self._handle = None
        if handle is None or not is_executing:
            return
        future = handle.result().cancel_goal_async()
        try:
            self._loop.wait(future.done, self._patience.vanished_s, PLANNER)
        except TrialEnded as end:
            self._loop.node.get_logger().info(f"while the goal was canceled: {end}")


def action_class(type_name: str) -> Any:
    """Return the class of an action by type; ConfigError if missing or without a pose.

    Raises:
        ConfigError: If it is not installed or its goal has no pose.
    """
    option = f"goal_action_type {type_name!r}"
    if type_name.count("/") != 2:
        raise ConfigError(f"{option}: must be PACKAGE/action/NAME")
    action = find_message_class(type_name)
    if action is None:
        package = type_name.partition("/")[0]
        raise ConfigError(
            f"{option}: {package} is not installed; install it, or use goal_by topic"
        )
    fields = action.Goal.get_fields_and_field_types()
    if fields.get("pose") != _POSE_TYPE:
        raise ConfigError(
            f"{option}: its goal must have a field pose of type {_POSE_TYPE}, but it"
            f" has {fields}"
        )
    return action


def _describe_result(answer: Any) -> str:
    """Return how an action ended, with its error code and message, if any."""
    state = _RESULT_STATES.get(answer.status, f"status {answer.status}")
    details = []
    # Not every action of ROS has the code and message that Nav2 gives.
    code = getattr(answer.result, "error_code", 0)
    if code:
        details.append(f"error {code}")
    message = getattr(answer.result, "error_msg", "")
    if message:
        details.append(message)
    if not details:
        return state
    return f"{state} ({', '.join(details)})"[:MAX_TEXT_LENGTH]
