"""The suite's topics in rclpy: classes, quality of service, publishers and subscriptions of serialised messages."""

import importlib
import secrets
from collections.abc import Callable
from typing import Any, TypeVar

from rclpy.event_handler import SubscriptionEventCallbacks
from rclpy.node import Node
from rclpy.publisher import Publisher
from rclpy.qos import DurabilityPolicy, HistoryPolicy, QoSProfile, ReliabilityPolicy
from rclpy.subscription import Subscription
from std_msgs.msg import Empty

from barn_worlds.base.errors import MessageError
from barn_worlds.messages.topics import Qos, Topic

T = TypeVar("T")


def qos_profile(qos: Qos) -> QoSProfile:
    """Return a quality of service for rclpy."""
    reliability, durability = (
        ReliabilityPolicy[qos.reliability.upper()],
        DurabilityPolicy[qos.durability.upper()],
    )
    return QoSProfile(
        depth=qos.depth,
        history=HistoryPolicy.KEEP_LAST,
        reliability=reliability,
        durability=durability,
    )


def read_endpoint_identity(node: Node) -> bytes:
    """Return the identity (GID) of an endpoint of this process, which begins as those of its other endpoints do."""
    # of a publisher on a topic that nobody else can know of; names of nodes can be taken by anybody
    probe = node.create_publisher(Empty, f"_barn_{secrets.token_hex(16)}", 1)
    try:
        (info,) = node.get_publishers_info_by_topic(probe.topic_name)
        return bytes(info.endpoint_gid)
    finally:
        node.destroy_publisher(probe)


def find_message_class(type_name: str) -> Any | None:
    """Return the class of a type such as "nav_msgs/msg/Odometry", None if its package is not installed."""
    package, kind, name = type_name.split("/")
    try:
        return getattr(importlib.import_module(f"{package}.{kind}"), name, None)
    except ImportError:
        return None


def create_publisher(node: Node, topic: Topic, qos: Qos | None = None) -> Publisher:
    """Return a publisher of a topic, which takes serialised messages."""
    return node.create_publisher(
        find_message_class(topic.type_name), topic.name, qos_profile(qos or topic.qos)
    )


def create_optional_publisher(node: Node, topic: Topic) -> Publisher | None:
    """Return a publisher of a topic, None if its type is not installed."""
    return (
        create_publisher(node, topic)
        if find_message_class(topic.type_name) is not None
        else None
    )


def subscribe(
    node: Node, topic: Topic, decode: Callable[[bytes], T], take: Callable[[T], None], qos: Qos | None = None,
    event_callbacks: SubscriptionEventCallbacks | None = None,
) -> Subscription:  # fmt: skip
    """Subscribe to a topic and pass on its decoded messages; malformed ones are logged and skipped."""

    def on_data(data: bytes) -> None:
        try:
            content = decode(data)
        except MessageError as error:
            node.get_logger().error(f"{topic.name} refused: {error}")
        else:
            take(content)

    kind, quality = find_message_class(topic.type_name), qos_profile(qos or topic.qos)
    return node.create_subscription(
        kind, topic.name, on_data, quality, raw=True, event_callbacks=event_callbacks
    )
