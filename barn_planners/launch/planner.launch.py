"""Start a planner.

ros2 launch barn_planners planner.launch.py planner:=eband use_map:=true
"""

from launch import LaunchDescription

from barn_worlds.ros.launching import NodeLaunch

TOPICS = ("cmd_vel", "scan", "odom", "goal_pose", "map", "amcl_pose")


def generate_launch_description() -> LaunchDescription:
    """Return a launch description of the planner's node and its arguments."""
    launch = NodeLaunch("barn_planners", "planner", TOPICS, use_sim_time=True)
    return launch.description()
