"""The two ways in which a planner gets its goal: a topic, or an action that also tells what became of it."""

import math
from typing import Any

from action_msgs.msg import GoalStatus
from geometry_msgs.msg import PoseStamped
from rclpy.action import ActionClient
from rclpy.serialization import deserialize_message
from rclpy.task import Future

from barn_eval.ros.graph import GraphView
from barn_eval.ros.readiness import Endpoint
from barn_eval.ros.session import PLANNER, Session, TrialEnded
from barn_eval.trials.outcome import Outcome
from barn_eval.trials.ros_config import EvaluatorConfig
from barn_eval.trials.trial import MAX_TEXT_LENGTH
from barn_worlds.base.errors import ConfigError
from barn_worlds.messages.topics import GOAL_POSE
from barn_worlds.ros.topics import message_class, publisher

_POSE_TYPE = "geometry_msgs/PoseStamped"
_AGAIN_S = 0.5  # between two attempts at a goal that was refused
_ENDINGS = {
    GoalStatus.STATUS_SUCCEEDED: "succeeded",
    GoalStatus.STATUS_CANCELED: "canceled",
    GoalStatus.STATUS_ABORTED: "aborted",
}


class TopicGoal:
    """Goals, each a serialised PoseStamped, by the publisher `offered`; what becomes of them is not heard."""

    action: tuple[str, str] | None = None
    verdict: str | None = None

    def __init__(
        self, session: Session, view: GraphView, config: EvaluatorConfig
    ) -> None:
        self._session, self._view = session, view
        self._limit_s = config.patience.service_s
        self._publisher = publisher(session.node, GOAL_POSE)
        self.offered = [Endpoint(self._publisher.topic_name, GOAL_POSE.type_name, b"")]

    def begin(self, goal: bytes) -> None:
        """Publish the goal once all who subscribe are connected: a planner without ~/ready hears it only once."""
        topic = self._publisher.topic_name
        listeners, heard = (
            len(self._view.subscriptions(topic)),
            self._publisher.get_subscription_count,
        )
        if not self._session.wait(lambda: heard() >= listeners, self._limit_s, PLANNER):
            raise TrialEnded(
                Outcome.PLANNER_NOT_READY,
                f"no connection to the subscription to {topic}",
            )
        self.repeat(goal)

    def repeat(self, goal: bytes) -> None:
        """Publish the goal."""
        self._publisher.publish(goal)

    def end(self) -> None:
        """Do nothing: what is published cannot be taken back."""


class ActionGoal:
    """Goals as those of an action such as NavigateToPose, given by name and type; it tells what became of the last."""

    def __init__(self, session: Session, config: EvaluatorConfig) -> None:
        self._session, self._patience = session, config.patience
        self._kind = action_class(config.goal_action_type)
        self._client = ActionClient(session.node, self._kind, config.goal_action)
        self._name = session.node.resolve_service_name(config.goal_action)
        self.action = (self._name, config.goal_action_type)
        self.offered: list[Endpoint] = []
        self._sent: Future | None = None
        self._result: Future | None = None

    @property
    def verdict(self) -> str | None:
        """How the last goal fares: sent, rejected, executing, or how it ended; None where there is none."""
        if self._sent is None:
            return None
        if not self._sent.done():
            return "sent"
        handle = self._sent.result()
        if not handle.accepted:
            return "rejected"
        self._result = self._result or handle.get_result_async()
        return _described(self._result.result()) if self._result.done() else "executing"

    def begin(self, goal: bytes) -> None:
        """Send the goal until it is accepted."""
        name, patience = self._name, self._patience
        # a server that ~/reset has taken down may be on its way up
        if not self._session.wait(
            self._client.server_is_ready, patience.gate_s, PLANNER
        ):
            raise TrialEnded(
                Outcome.PLANNER_NOT_READY, f"no connection to the action {name}"
            )
        for _ in range(1 + math.ceil(patience.gate_s / _AGAIN_S)):
            self.repeat(goal)
            if not self._session.wait(
                lambda: self.verdict != "sent", patience.service_s, PLANNER
            ):
                raise TrialEnded(
                    Outcome.PLANNER_NOT_READY, f"no answer from the action {name}"
                )
            if self.verdict != "rejected":
                return
            self._session.sleep(_AGAIN_S, PLANNER)
        raise TrialEnded(
            Outcome.PLANNER_NOT_READY, f"the action {name} has refused the goal"
        )

    def repeat(self, goal: bytes) -> None:
        """Send the goal, or again if the planner has given it up."""
        if self.verdict not in ("sent", "executing", "succeeded"):
            request = self._kind.Goal(pose=deserialize_message(goal, PoseStamped))
            self._sent, self._result = self._client.send_goal_async(request), None

    def end(self) -> None:
        """Cancel the goal if it is still being worked on, and see that the planner has heard so."""
        verdict, sent, self._sent = self.verdict, self._sent, None
        if sent is not None and verdict == "executing":
            future = sent.result().cancel_goal_async()
            try:
                self._session.wait(future.done, self._patience.vanished_s, PLANNER)
            except TrialEnded as end:
                self._session.node.get_logger().info(
                    f"while the goal was cancelled: {end}"
                )


def action_class(type_name: str) -> Any:
    """Return the class of an action such as "nav2_msgs/action/NavigateToPose"; ConfigError if it cannot take a goal."""
    where = f"goal_action_type {type_name!r}"
    if type_name.count("/") != 2:
        raise ConfigError(f"{where}: must be PACKAGE/action/NAME")
    found = message_class(type_name)
    if found is None:
        raise ConfigError(
            f"{where}: {type_name.partition('/')[0]} is not installed; goal_by topic does without"
        )
    fields = found.Goal.get_fields_and_field_types()
    if fields.get("pose") != _POSE_TYPE:
        raise ConfigError(
            f"{where}: its goal must have a field pose of type {_POSE_TYPE}, it has {fields}"
        )
    return found


def _described(answer: Any) -> str:
    """Return how an action ended, with the code and the message that some results have."""
    ending, code = (
        _ENDINGS.get(answer.status, f"status {answer.status}"),
        getattr(answer.result, "error_code", 0),
    )
    details = ", ".join(
        filter(
            None,
            (f"error {code}" if code else "", getattr(answer.result, "error_msg", "")),
        )
    )
    return f"{ending} ({details})"[:MAX_TEXT_LENGTH] if details else ending
