"""Start the simulator: `ros2 launch barn_sim simulator.launch.py world:=42 lockstep:=true`."""

from launch import LaunchDescription
from launch.actions import DeclareLaunchArgument, OpaqueFunction
from launch.substitutions import LaunchConfiguration
from launch_ros.actions import Node
from launch_ros.parameter_descriptions import ParameterFile, ParameterValue

# name: (kind of the node's parameter of that name, description); what is not given stays as the node has it
PARAMETERS = {
    "dataset": (str, "data set: a name, folder or file"),
    "world": (int, "number of the world"),
    "start_x_m": (float, "start in the map frame"),
    "start_y_m": (float, "start in the map frame"),
    "start_yaw_rad": (float, "heading at the start"),
    "seed": (int, "seed of all noise"),
    "lockstep": (bool, "wait for one command after each scan"),
    "start_paused": (bool, "begin paused"),
    "real_time_factor": (float, "simulated by real time without lockstep, 0 for as fast as it can"),
    "command_type": (str, "auto, twist or twist_stamped"),
}
TOPICS = ("cmd_vel", "scan", "odom")


def generate_launch_description():
    """Return the node with its arguments."""
    arguments = [
        DeclareLaunchArgument(name, default_value="", description=description)
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
            package="barn_sim",
            executable="simulator",
            name="simulator",
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
