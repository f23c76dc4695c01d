"""The ROS 2 node; nothing else in the package imports from here."""
