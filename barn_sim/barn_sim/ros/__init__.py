"""ROS 2 node of the package, and what only it needs. The cores never import from here."""
