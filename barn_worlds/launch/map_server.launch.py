"""Serve a map: `ros2 launch barn_worlds map_server.launch.py world:=42`."""

from launch import LaunchDescription

from barn_worlds.ros.launching import NodeLaunch
from barn_worlds.ros.map_server import MapServerConfig

TOPICS = ("map", "plan")


def generate_launch_description() -> LaunchDescription:
    """Return the node with its arguments."""
    return NodeLaunch(
        "barn_worlds", "map_server", [MapServerConfig()], TOPICS, use_sim_time=True
    ).description()
