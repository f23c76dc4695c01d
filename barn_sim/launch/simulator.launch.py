"""Start the simulator: `ros2 launch barn_sim simulator.launch.py world:=42 lockstep:=true`.

It makes the time on /clock, so there is no use_sim_time here.
"""

from launch import LaunchDescription

from barn_worlds.ros.launching import NodeLaunch

TOPICS = ("cmd_vel", "scan", "odom", "amcl_pose", "ground_truth/odom", "collision")


def generate_launch_description() -> LaunchDescription:
    """Return a launch description of the simulator's node and its arguments."""
    return NodeLaunch("barn_sim", "simulator", TOPICS).description()
