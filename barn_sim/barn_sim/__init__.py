"""A Clearpath Jackal in PyBullet with lidar and odometry, as a library and a ROS node."""

from barn_worlds import __version__ as __version__
