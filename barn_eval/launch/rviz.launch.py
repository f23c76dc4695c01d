"""Show a trial: `ros2 launch barn_eval rviz.launch.py`."""

from launch import LaunchDescription
from launch.substitutions import LaunchConfiguration, PathJoinSubstitution
from launch_ros.actions import Node
from launch_ros.parameter_descriptions import ParameterValue
from launch_ros.substitutions import FindPackageShare

from barn_worlds.ros.launching import (
    COMMON_ARGUMENTS,
    LOG_LEVEL,
    SIM_TIME,
    declare_arguments,
)

# The layout names topics from the root; relative names follow the namespace.
TOPICS = (
    "band",
    "candidates",
    "goal_pose",
    "local_costmap/costmap",
    "local_plan",
    "map",
    "odom",
    "plan",
    "robot_description",
    "scan",
)


def generate_launch_description() -> LaunchDescription:
    """Return a launch description of RViz with the suite's layout."""
    layout = PathJoinSubstitution(
        [FindPackageShare("barn_eval"), "config", "barn.rviz"]
    )
    arguments = {
        "layout": (layout, "layout of RViz"),
        "use_sim_time": ("true", SIM_TIME[1]),
        "namespace": COMMON_ARGUMENTS["namespace"],
        "log_level": COMMON_ARGUMENTS["log_level"],
    }

    sim_time = ParameterValue(LaunchConfiguration("use_sim_time"), value_type=bool)
    node = Node(
        package="rviz2",
        executable="rviz2",
        name="rviz2",
        namespace=LaunchConfiguration("namespace"),
        parameters=[{"use_sim_time": sim_time}],
        remappings=[(f"/{name}", name) for name in TOPICS],
        arguments=["-d", LaunchConfiguration("layout"), *LOG_LEVEL],
        output="screen",
    )
    return LaunchDescription([*declare_arguments(arguments), node])
