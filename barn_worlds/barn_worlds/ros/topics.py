"""Publishers and subscriptions of rclpy for serialized messages."""

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
    """Return the QoS profile of rclpy for a quality of service of the suite."""
    return QoSProfile(
        depth=qos.depth,
        history=HistoryPolicy.KEEP_LAST,
        reliability=ReliabilityPolicy[qos.reliability.upper()],
        durability=DurabilityPolicy[qos.durability.upper()],
    )


def read_endpoint_identity(node: Node) -> bytes:
    """Return the GID of a publisher that is created, and destroyed, to read it.

    The identities of its other endpoints begin with the same bytes.
    """
    # Anybody can take the name of a node, but nobody else can know this topic.
    probe = node.create_publisher(Empty, f"_barn_{secrets.token_hex(16)}", 1)
    try:
        (info,) = node.get_publishers_info_by_topic(probe.topic_name)
        return bytes(info.endpoint_gid)
    finally:
        node.destroy_publisher(probe)


def find_message_class(type_name: str) -> Any | None:
    """Return the rclpy class of a type such as "nav_msgs/msg/Odometry", or None.

    None means that the package of the type is not installed.
    """
    package, kind, name = type_name.split("/")
    try:
        return getattr(importlib.import_module(f"{package}.{kind}"), name, None)
    except ImportError:
        return None


def create_publisher(node: Node, topic: Topic, qos: Qos | None = None) -> Publisher:
    """Create and return a publisher for serialized messages of a topic.

    Args:
        node: Node that publishes.
        topic: Topic of the suite.
        qos: Quality of service. By default it is that of the topic.
    """
    kind = find_message_class(topic.type_name)
    return node.create_publisher(kind, topic.name, qos_profile(qos or topic.qos))


def create_optional_publisher(node: Node, topic: Topic) -> Publisher | None:
    """Create and return a publisher, None if the message type is not installed.

    Args:
        node: Node that publishes.
        topic: Topic of the suite.
    """
    if find_message_class(topic.type_name) is None:
        return None
    return create_publisher(node, topic)


def subscribe(
    node: Node,
    topic: Topic,
    decode: Callable[[bytes], T],
    take: Callable[[T], None],
    qos: Qos | None = None,
    event_callbacks: SubscriptionEventCallbacks | None = None,
) -> Subscription:
    """Subscribe to a topic; pass decoded messages to `take`, log malformed ones.

    Args:
        node: Node that subscribes.
        topic: Topic of the suite.
        decode: Reads a serialized message. Raises MessageError if it is malformed.
        take: Receives what `decode` returns.
        qos: Quality of service. By default it is that of the topic.
        event_callbacks: Callbacks of rclpy for events of the subscription.
    """

    def on_data(data: bytes) -> None:
        """Pass a decoded message to `take`, or log why it is malformed."""
        try:
            content = decode(data)
        except MessageError as error:
            node.get_logger().error(f"{topic.name} refused: {error}")
        else:
            take(content)

    # raw: rclpy hands over the bytes instead of making an object of them.
    return node.create_subscription(
        find_message_class(topic.type_name),
        topic.name,
        on_data,
        qos_profile(qos or topic.qos),
        raw=True,
        event_callbacks=event_callbacks,
    )
