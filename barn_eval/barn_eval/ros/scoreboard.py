"""Publishes and records how a trial stands.

The bag gets it from here and not over DDS: what the evaluator finds out belongs to an instant that is over by then.
"""

from __future__ import annotations

from collections.abc import Collection, Iterable

from rclpy.node import Node

from barn_eval.bags.live_score import TOPICS
from barn_eval.bags.recorder import Recorder
from barn_worlds.messages.topics import Outgoing
from barn_worlds.ros.topics import optional_publisher


class Scoreboard:
    """The publishers of `barn_eval.bags.live_score`; a topic whose message type is not installed is recorded only."""

    def __init__(self, node: Node, unrecorded: Collection[str]) -> None:
        self._publishers = {topic: optional_publisher(node, topic) for topic in TOPICS}
        self._unrecorded = set(unrecorded)

    def show(self, shown: Iterable[Outgoing], stamp_ns: int, recorder: Recorder | None) -> None:
        """Publish messages where somebody listens, and write them to the bag, if there is one."""
        for topic, data in shown:
            sender = self._publishers[topic]
            if sender is not None and sender.get_subscription_count():
                sender.publish(data)
            if recorder is not None and topic.path not in self._unrecorded:
                recorder.add_topic(topic.path, topic.type_name)
                recorder.write(topic.path, data, stamp_ns)
