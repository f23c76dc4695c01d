"""Raw subscriptions that are read when the evaluator wants to, all at once, instead of one callback per message.

A trial in lockstep brings some thousand messages a second. Taking them in bulk costs a quarter of what the executor's
callbacks would, and the processor time is the simulator's and the planner's.
"""

from collections.abc import Callable
from typing import Any, cast

from rclpy.callback_groups import CallbackGroup
from rclpy.node import Node
from rclpy.subscription import Subscription

from barn_eval.ros.instants import Message
from barn_worlds.messages.topics import Qos
from barn_worlds.ros.topics import message_class, profile

_DEPTH = 2000  # messages of a topic that may wait to be read: several seconds in lockstep


class Polled(CallbackGroup):
    """A group whose entities no executor touches: they are read by hand."""

    def can_execute(self, entity: object) -> bool:  # noqa: ARG002
        """Return False."""
        return False

    def beginning_execution(self, entity: object) -> bool:  # noqa: ARG002
        """Return False."""
        return False

    def ending_execution(self, entity: object) -> None:
        """Do nothing."""


class Inbox:
    """All topics that are judged or recorded.

    A latched message is kept, since every bag needs it although it was sent only once.
    """

    def __init__(self, node: Node) -> None:
        self._node = node
        self._group = Polled()
        self._subscriptions: dict[str, Subscription] = {}
        self._types: dict[str, str] = {}
        self._reliable: dict[str, bool] = {}
        self._latched: dict[str, Message | None] = {}
        self._woken: list[Message] = []

    def subscribe(
        self, topic: str, type_name: str, *, reliable: bool = True, latched: bool = False, wake: bool = False
    ) -> bool:
        """Subscribe to a topic, or anew if its type or reliability has changed; False for a type that is not installed.

        wake: a message also ends the executor's wait.
        """
        if self._types.get(topic) == type_name and self._reliable[topic] == reliable:
            return True
        kind = message_class(type_name)
        if kind is None:
            return False
        self.forget(topic)

        def received(data: bytes, about: dict[str, int]) -> None:
            self._woken.append(_message(topic, data, about))

        qos = Qos("reliable" if reliable else "best_effort", "transient_local" if latched else "volatile", _DEPTH)
        self._subscriptions[topic] = self._node.create_subscription(
            kind,
            topic,
            cast("Callable[[Any], None]", received),  # rclpy does not declare that it gives the second argument, too
            profile(qos),
            raw=True,
            callback_group=None if wake else self._group,
        )
        self._types[topic] = type_name
        self._reliable[topic] = reliable
        if latched:
            self._latched[topic] = None
        return True

    def forget(self, topic: str) -> None:
        """Unsubscribe from a topic, if subscribed."""
        if topic in self._subscriptions:
            self._node.destroy_subscription(self._subscriptions.pop(topic))
            del self._types[topic]
            self._latched.pop(topic, None)

    def topics(self) -> dict[str, str]:
        """Return the topics subscribed to and their types."""
        return dict(self._types)

    def unmatched(self, publishers: dict[str, int]) -> list[str]:
        """Return the topics on which fewer publishers are connected than the graph has, given their numbers."""
        return [
            topic
            for topic, number in publishers.items()
            if topic in self._subscriptions and self._subscriptions[topic].get_publisher_count() < number
        ]

    def read(self, take: Callable[[Message], None]) -> None:
        """Hand over all messages that have arrived, topic by topic."""
        for message in self._woken:
            take(message)
        self._woken.clear()
        for topic, subscription in self._subscriptions.items():
            handle = subscription.handle
            with handle:
                while (taken := handle.take_message(subscription.msg_type, True)) is not None:
                    message = _message(topic, *taken)
                    if topic in self._latched:
                        self._latched[topic] = message
                    take(message)

    def latched(self) -> list[Message]:
        """Return the last message of each latched topic."""
        return [message for message in self._latched.values() if message is not None]


def _message(topic: str, data: bytes, about: dict[str, int]) -> Message:
    return Message(topic, data, about["source_timestamp"])
