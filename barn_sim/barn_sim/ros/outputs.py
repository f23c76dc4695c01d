"""The publishers of the simulator node."""

from collections.abc import Iterable

from rclpy.node import Node

from barn_sim.ros.node_config import SimulatorNodeConfig
from barn_worlds.messages import topics
from barn_worlds.messages.topics import BEST_EFFORT, Outgoing
from barn_worlds.ros.topics import optional_publisher, publisher

_TOPICS = (
    topics.CLOCK,
    topics.ODOM,
    topics.GROUND_TRUTH,
    topics.AMCL_POSE,
    topics.COLLISION,
    topics.JOINT_STATES,
    topics.ROBOT_DESCRIPTION,
    topics.SIMULATOR_DIAGNOSTICS,
    topics.TF,
    topics.TF_STATIC,
)


class Outputs:
    """Publish messages on the topics of the simulator; transforms only where their type is installed."""

    def __init__(self, node: Node, config: SimulatorNodeConfig) -> None:
        free = config.scan_reliability == "auto" and not config.lockstep
        scan = BEST_EFFORT if free or config.scan_reliability == "best_effort" else None
        self._scan = publisher(node, topics.SCAN, scan)
        self._publishers = {topic.name: optional_publisher(node, topic) for topic in _TOPICS}
        self._publishers[topics.SCAN.name] = self._scan
        if self._publishers[topics.TF.name] is None:
            node.get_logger().info("tf2_msgs is not installed: /tf and /tf_static are off")

    def publish(self, messages: Iterable[Outgoing]) -> None:
        """Publish messages, in their order."""
        for topic, data in messages:
            sender = self._publishers[topic.name]
            if sender is not None:
                sender.publish(data)

    def scan_subscriptions(self) -> int:
        """Return how many subscriptions the scans reach."""
        return self._scan.get_subscription_count()
