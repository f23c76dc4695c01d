"""What runs a planner without ROS: its tasks, its synchronized inputs, its messages."""
