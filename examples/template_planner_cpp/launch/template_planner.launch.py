"""Start the node.

ros2 launch template_planner_cpp template_planner.launch.py max_speed_mps:=0.8
"""

from launch import LaunchDescription
from launch.actions import DeclareLaunchArgument
from launch.substitutions import LaunchConfiguration
from launch_ros.actions import Node
from launch_ros.parameter_descriptions import ParameterValue

# Default and type of each launch argument, which is a parameter of the node.
ARGUMENTS = {
    "max_speed_mps": ("0.5", float),
    "max_turn_radps": ("1.5", float),
    "use_map": ("false", bool),
}


def generate_launch_description():
    """Return the node and its arguments."""
    arguments = []
    parameters = {"use_sim_time": True}
    for name, (default, value_type) in ARGUMENTS.items():
        arguments.append(DeclareLaunchArgument(name, default_value=default))
        parameters[name] = ParameterValue(
            LaunchConfiguration(name), value_type=value_type
        )
    node = Node(
        package="template_planner_cpp",
        executable="template_planner",
        output="screen",
        parameters=[parameters],
    )
    return LaunchDescription([*arguments, node])
