"""Start a planner: `ros2 launch barn_planners planner.launch.py planner:=eband use_map:=true`."""

from launch import LaunchDescription
from launch.actions import DeclareLaunchArgument, OpaqueFunction
from launch.substitutions import LaunchConfiguration
from launch_ros.actions import Node
from launch_ros.parameter_descriptions import ParameterFile, ParameterValue

# name: (kind of the node's parameter of that name, description); what is not given stays as the node has it
PARAMETERS = {
    "planner": (str, "name of the planner"),
    "preset": (str, "preset of its parameters"),
    "use_map": (bool, "plan on a map, with the robot localised in it"),
    "seed": (int, "seed of the planner's random numbers"),
    "command_type": (str, "twist or twist_stamped"),
    "use_sim_time": (bool, "take the time from /clock"),
}
TOPICS = ("cmd_vel", "scan", "odom", "goal_pose", "map", "amcl_pose")


def generate_launch_description():
    """Return the node with its arguments."""
    arguments = [
        DeclareLaunchArgument(name, default_value="true" if name == "use_sim_time" else "", description=description)
        for name, (_, description) in PARAMETERS.items()
    ]
    arguments += [
        DeclareLaunchArgument(topic_argument(name), default_value=name, description=f"topic that is {name} to the node")
        for name in TOPICS
    ]
    arguments += [
        DeclareLaunchArgument("params_file", default_value="", description="file with parameters of the node"),
        DeclareLaunchArgument("namespace", default_value="", description="namespace of node and topics"),
        DeclareLaunchArgument("log_level", default_value="info", description="debug, info, warn, error or fatal"),
    ]
    return LaunchDescription([*arguments, OpaqueFunction(function=make_node)])


def make_node(context):
    """Return the node with the parameters that have been given; they come on top of those of the file."""
    given = {
        name: ParameterValue(LaunchConfiguration(name), value_type=kind)
        for name, (kind, _) in PARAMETERS.items()
        if LaunchConfiguration(name).perform(context)
    }
    file = LaunchConfiguration("params_file").perform(context)
    return [
        Node(
            package="barn_planners",
            executable="planner",
            name="planner",
            namespace=LaunchConfiguration("namespace"),
            parameters=[*([ParameterFile(file)] if file else []), given],
            remappings=[(name, LaunchConfiguration(topic_argument(name))) for name in TOPICS],
            arguments=["--ros-args", "--log-level", LaunchConfiguration("log_level")],
            output="screen",
        )
    ]


def topic_argument(name):
    """Return the name of the argument that remaps a topic."""
    return name.replace("/", "_") + "_topic"
