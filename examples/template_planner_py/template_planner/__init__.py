"""A planner to copy: `core` is the algorithm; `node` and `registered` run it.

`node` needs only rclpy. `registered` makes the algorithm a planner of the suite.
"""
