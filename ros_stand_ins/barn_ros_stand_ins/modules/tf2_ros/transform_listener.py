"""A listener that fills a buffer from /tf and /tf_static."""

from threading import Thread

from rclpy.callback_groups import ReentrantCallbackGroup
from rclpy.executors import SingleThreadedExecutor
from rclpy.qos import DurabilityPolicy, QoSProfile
from tf2_msgs.msg import TFMessage

_AUTHORITY = "default_authority"


class TransformListener:
    """Puts transforms into a buffer as they are published."""

    def __init__(
        self,
        buffer,
        node,
        *,
        spin_thread=False,
        qos=None,
        static_qos=None,
        tf_topic="/tf",
        tf_static_topic="/tf_static",
    ):
        """Subscribe by a node, which a thread of its own spins if that is wanted."""
        latched = DurabilityPolicy.TRANSIENT_LOCAL
        self.buffer = buffer
        self.node = node
        # A callback of the node may wait for a transform.
        self.group = ReentrantCallbackGroup()
        self.tf_sub = node.create_subscription(
            TFMessage, tf_topic, self.callback, qos or 100, callback_group=self.group
        )
        self.tf_static_sub = node.create_subscription(
            TFMessage,
            tf_static_topic,
            self.static_callback,
            static_qos or QoSProfile(depth=100, durability=latched),
            callback_group=self.group,
        )
        if spin_thread:
            self.executor = SingleThreadedExecutor()
            self.executor.add_node(node)
            Thread(target=self.executor.spin, daemon=True).start()

    def unregister(self):
        """Listen no longer."""
        self.node.destroy_subscription(self.tf_sub)
        self.node.destroy_subscription(self.tf_static_sub)

    def callback(self, data):
        """Take transforms of a time."""
        for transform in data.transforms:
            self.buffer.set_transform(transform, _AUTHORITY)

    def static_callback(self, data):
        """Take transforms of all times."""
        for transform in data.transforms:
            self.buffer.set_transform_static(transform, _AUTHORITY)
