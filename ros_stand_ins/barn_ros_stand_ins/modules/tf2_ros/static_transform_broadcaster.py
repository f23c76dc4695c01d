"""A publisher of transforms of all times."""

from rclpy.qos import DurabilityPolicy, QoSProfile
from tf2_msgs.msg import TFMessage


class StaticTransformBroadcaster:
    """Publishes on /tf_static all transforms that it was ever given."""

    def __init__(self, node, qos=None):
        """Publish by a node."""
        latched = QoSProfile(depth=1, durability=DurabilityPolicy.TRANSIENT_LOCAL)
        self.pub_tf = node.create_publisher(TFMessage, "/tf_static", qos or latched)
        self._transforms = {}

    def sendTransform(self, transform):
        """Publish a TransformStamped, or several, with those before."""
        if not hasattr(transform, "__iter__"):
            transform = [transform]
        for item in transform:
            self._transforms[item.child_frame_id] = item
        self.pub_tf.publish(TFMessage(transforms=list(self._transforms.values())))
