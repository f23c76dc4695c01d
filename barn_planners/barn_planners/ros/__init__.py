"""ROS 2 nodes of the package and what only they need; the cores never import from here."""
