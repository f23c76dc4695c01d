"""The ROS 2 node, and what only it needs. The cores never import from here."""
