"""A publisher of transforms of a time."""

from tf2_msgs.msg import TFMessage


class TransformBroadcaster:
    """Publishes on /tf."""

    def __init__(self, node, qos=100):
        """Publish by a node."""
        self.pub_tf = node.create_publisher(TFMessage, "/tf", qos)

    def sendTransform(self, transform):
        """Publish a TransformStamped, or several."""
        if not hasattr(transform, "__iter__"):
            transform = [transform]
        self.pub_tf.publish(TFMessage(transforms=list(transform)))
