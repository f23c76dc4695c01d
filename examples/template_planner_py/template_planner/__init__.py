"""A planner to copy: `core` is the algorithm, `node` runs it in plain rclpy, `registered` in the suite."""
