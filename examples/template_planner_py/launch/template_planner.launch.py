"""Start the node: `ros2 launch template_planner template_planner.launch.py max_speed_mps:=0.8`."""

from launch import LaunchDescription
from launch.actions import DeclareLaunchArgument
from launch.substitutions import LaunchConfiguration
from launch_ros.actions import Node
from launch_ros.parameter_descriptions import ParameterValue

ARGUMENTS = {
    "max_speed_mps": ("0.5", float),
    "max_turn_radps": ("1.5", float),
    "use_map": ("false", bool),
}


def generate_launch_description():
    """Return the node with its arguments."""
    declared = [
        DeclareLaunchArgument(name, default_value=value)
        for name, (value, _) in ARGUMENTS.items()
    ]
    given = {
        name: ParameterValue(LaunchConfiguration(name), value_type=kind)
        for name, (_, kind) in ARGUMENTS.items()
    }
    node = Node(
        package="template_planner",
        executable="template_planner",
        output="screen",
        parameters=[{"use_sim_time": True}, given],
    )
    return LaunchDescription([*declared, node])
