"""The command topic, whose type depends on its publisher."""

from collections.abc import Callable
from dataclasses import replace
from functools import partial

from rclpy.node import Node
from rclpy.qos import ReliabilityPolicy
from rclpy.subscription import Subscription

from barn_worlds.messages import decode
from barn_worlds.messages.topics import CMD_VEL, CMD_VEL_STAMPED
from barn_worlds.ros.topics import subscribe
from barn_worlds.types import Velocity2D

_TOPICS = {"twist": CMD_VEL, "twist_stamped": CMD_VEL_STAMPED}
_KINDS = {topic.type_name: kind for kind, topic in _TOPICS.items()}


class CommandInput:
    """Subscribes to cmd_vel as Twist or TwistStamped.

    `kind` is the type subscribed to, "twist" or "twist_stamped"; `complaint` says what is wrong with the publishers
    on the topic, or is empty.
    """

    def __init__(self, node: Node, wanted: str, take: Callable[[Velocity2D], None]) -> None:
        self.complaint = ""
        self.kind = "twist" if wanted == "auto" else wanted
        self._node = node
        self._fixed = wanted != "auto"
        self._take = take
        self._topic = node.resolve_topic_name(CMD_VEL.name)
        self._subscription: Subscription | None = None
        self._complained = False
        self._reliable = True
        self._subscribe()

    def _subscribe(self) -> None:
        if self._subscription is not None:
            self._node.destroy_subscription(self._subscription)
        topic = _TOPICS[self.kind]
        read = partial(decode.command, type_name=topic.type_name)
        qos = topic.qos if self._reliable else replace(topic.qos, reliability="best_effort")
        self._subscription = subscribe(self._node, topic, read, self._take, qos)

    def publishers(self) -> int:
        """Return the number of publishers of commands."""
        return 0 if self._subscription is None else int(self._subscription.get_publisher_count())

    def begin_trial(self) -> None:
        """Allow one complaint in the new trial."""
        self._complained = False
        self.look()

    def look(self) -> None:
        """Check the publishers on the topic: adopt their type and reliability, or complain, once per trial."""
        publishers = self._node.get_publishers_info_by_topic(self._topic)
        types = sorted({info.topic_type for info in publishers})
        kinds = [_KINDS[name] for name in types if name in _KINDS]
        kind = kinds[0] if not self._fixed and kinds and self.kind not in kinds else self.kind
        # a reliable subscription does not receive from a best-effort publisher
        guaranteed = all(info.qos_profile.reliability is not ReliabilityPolicy.BEST_EFFORT for info in publishers)
        if publishers and (kind, guaranteed) != (self.kind, self._reliable):
            self.kind, self._reliable = kind, guaranteed
            self._subscribe()
            delivery = "reliably" if guaranteed else "best-effort"
            name = _TOPICS[kind].type_name.rpartition("/")[2]
            self._node.get_logger().info(f"{self._topic}: commands come {delivery} as {name}")
        wrong = [f"{info.topic_type} of {info.node_name}" for info in publishers if not self._matches(info.topic_type)]
        self.complaint = ""
        if wrong:
            expected = _TOPICS[self.kind].type_name
            self.complaint = f"{self._topic}: not heard: {', '.join(sorted(wrong))}; this run expects {expected}"
            if not self._complained:
                self._complained = True
                self._node.get_logger().error(self.complaint)

    def _matches(self, type_name: str) -> bool:
        return _KINDS.get(type_name) == self.kind
