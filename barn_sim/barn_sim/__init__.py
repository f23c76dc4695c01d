"""A PyBullet Clearpath Jackal with lidar, odometry and contact detection, as a library and as a ROS 2 node."""

from barn_worlds import __version__ as __version__
