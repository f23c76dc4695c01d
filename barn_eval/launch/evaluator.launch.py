"""Start the evaluator: `ros2 launch barn_eval evaluator.launch.py worlds:=0-9 planner:=my_planner out:=results`.

It leads a simulator and judges a planner that run already or are about to. When all trials have been made, everything
that was launched with it ends.
"""

from launch import LaunchDescription
from launch.actions import DeclareLaunchArgument, EmitEvent, OpaqueFunction, RegisterEventHandler
from launch.event_handlers import OnProcessExit
from launch.events import Shutdown
from launch.substitutions import LaunchConfiguration
from launch_ros.actions import Node
from launch_ros.parameter_descriptions import ParameterFile, ParameterValue

# name: (kind of the node's parameter of that name, description); what is not given stays as the node has it
PARAMETERS = {
    "dataset": (str, "data set: a name, folder or file"),
    "worlds": (str, "which of its worlds, such as 0, 0-49 or 0:300:6"),
    "planner": (str, "name that the planner has in the results"),
    "protocol": (str, "paper, challenge or a YAML file"),
    "seed": (int, "seed of the run"),
    "repetitions": (int, "trials per world"),
    "out": (str, "folder of the results"),
    "command_type": (str, "auto, twist or twist_stamped"),
    "simulator_node": (str, "full name of the simulator node"),
    "planner_node": (str, "full name of the planner node"),
    "bags": (str, "which trials keep a bag: all, failed or none"),
}
TOPICS = ("cmd_vel", "scan", "odom", "ground_truth/odom", "collision", "goal_pose", "map")


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
    evaluator = Node(
        package="barn_eval",
        executable="evaluator",
        name="evaluator",
        namespace=LaunchConfiguration("namespace"),
        parameters=[*([ParameterFile(file)] if file else []), given],
        remappings=[(name, LaunchConfiguration(topic_argument(name))) for name in TOPICS],
        arguments=["--ros-args", "--log-level", LaunchConfiguration("log_level")],
        output="screen",
    )
    ended = OnProcessExit(
        target_action=evaluator, on_exit=[EmitEvent(event=Shutdown(reason="the evaluator has ended"))]
    )
    return [evaluator, RegisterEventHandler(ended)]


def topic_argument(name):
    """Return the name of the argument that remaps a topic."""
    return name.replace("/", "_") + "_topic"
