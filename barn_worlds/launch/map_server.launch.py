"""Serve a map: `ros2 launch barn_worlds map_server.launch.py world:=42`."""

from launch import LaunchDescription

from barn_worlds.ros.launching import NodeLaunch

TOPICS = ("map", "plan")


def generate_launch_description() -> LaunchDescription:
    """Return the node with its arguments."""
    launch = NodeLaunch("barn_worlds", "map_server", TOPICS, use_sim_time=True)
    return launch.description()
