"""A PyBullet Clearpath Jackal with lidar, odometry and contact detection, as a library and as a ROS 2 node."""

__version__ = "0.1.0"
