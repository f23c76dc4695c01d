"""The evaluator: runs trials with any planner over ROS 2."""
