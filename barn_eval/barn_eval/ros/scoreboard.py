"""Publishes and records how a trial stands.

The bag gets it from here and not over DDS: what the evaluator finds out belongs to an instant that is over by then.
"""

from __future__ import annotations

from collections.abc import Collection, Iterable

from rclpy.node import Node

from barn_eval.bags.live_score import TOPICS, Shown
from barn_eval.bags.recorder import Recorder
from barn_eval.ros.inbox import message_class
from barn_worlds.ros.conversions import reliable


class Scoreboard:
    """The publishers of `barn_eval.bags.live_score`; a topic whose message type is not installed is recorded only."""

    def __init__(self, node: Node, unrecorded: Collection[str]) -> None:
        kinds = {topic: message_class(type_name) for topic, type_name in TOPICS.items()}
        self._publishers = {
            topic: node.create_publisher(kind, topic, reliable(10)) for topic, kind in kinds.items() if kind
        }
        self._unrecorded = set(unrecorded)

    def show(self, shown: Iterable[Shown], stamp_ns: int, recorder: Recorder | None) -> None:
        """Publish messages where somebody listens, and write them to the bag, if there is one."""
        for topic, data in shown:
            publisher = self._publishers.get(topic)
            if publisher is not None and publisher.get_subscription_count():
                publisher.publish(data)
            if recorder is not None and topic not in self._unrecorded:
                recorder.add_topic(topic, TOPICS[topic])
                recorder.write(topic, data, stamp_ns)
