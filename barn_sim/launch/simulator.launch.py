"""Start the simulator: `ros2 launch barn_sim simulator.launch.py world:=42 lockstep:=true`.

It makes the time on /clock, so there is no use_sim_time here.
"""

from launch import LaunchDescription

from barn_sim.ros.node_config import NodeConfig, RunConfig
from barn_worlds.ros.launching import NodeLaunch

PARAMETERS = (
    "dataset",
    "world",
    "start_x_m",
    "start_y_m",
    "start_yaw_rad",
    "seed",
    "lockstep",
    "start_paused",
    "real_time_factor",
    "command_wait_s",
    "command_type",
    "map_frame",
    "odom_frame",
    "base_frame",
    "lidar_frame",
)
TOPICS = ("cmd_vel", "scan", "odom", "amcl_pose", "ground_truth/odom", "collision")


def generate_launch_description() -> LaunchDescription:
    """Return the node with its arguments."""
    return NodeLaunch("barn_sim", "simulator", [NodeConfig(), RunConfig()], PARAMETERS, topics=TOPICS).description()
