"""Check that the messages of ROS and the NumPy that is installed agree on what an array is."""

import numpy as np
from geometry_msgs.msg import PoseWithCovariance
from nav_msgs.msg import OccupancyGrid
from rclpy.serialization import deserialize_message, serialize_message
from sensor_msgs.msg import LaserScan

# a list of any length, a list of bytes, and an array of fixed length
scan = LaserScan(ranges=np.linspace(0.1, 30.0, 720, dtype=np.float32))
grid = OccupancyGrid(data=np.arange(-1, 100, dtype=np.int8))
pose = PoseWithCovariance(covariance=np.arange(36.0))
for message in (scan, grid, pose):
    again = deserialize_message(serialize_message(message), type(message))
    if again != message:
        raise SystemExit(
            f"NumPy {np.__version__}: a {type(message).__name__} is not the same after a round trip"
        )
if np.asarray(pose.covariance).tolist() != list(range(36)):
    raise SystemExit(f"NumPy {np.__version__}: {pose.covariance}")
print(f"messages and NumPy {np.__version__} agree")
