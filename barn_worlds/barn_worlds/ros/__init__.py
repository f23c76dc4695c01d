"""ROS 2 nodes of the package, and what only they need. The cores never import them."""
