"""Simulator, planner and evaluator together: `ros2 launch barn_eval trial.launch.py worlds:=0 planner:=dwa`.

With `start_planner:=false` the planner is left out, for one of your own. All else is handed to the three launch files.
"""

from launch import LaunchDescription
from launch.actions import DeclareLaunchArgument, IncludeLaunchDescription
from launch.conditions import IfCondition
from launch.launch_description_sources import PythonLaunchDescriptionSource
from launch.substitutions import EqualsSubstitution, LaunchConfiguration, PathJoinSubstitution
from launch_ros.substitutions import FindPackageShare

ARGUMENTS = {
    "dataset": ("barn300", "data set: a name, folder or file"),
    "worlds": ("0", "which of its worlds, such as 0, 0-49 or 0:300:6"),
    "planner": ("dwa", "name of the planner"),
    "protocol": ("challenge", "paper, challenge or a YAML file"),
    "seed": ("0", "seed of the run"),
    "repetitions": ("1", "trials per world"),
    "out": ("barn_out", "folder of the results"),
    "lockstep": ("true", "the simulator waits for a command after each scan"),
    "real_time_factor": ("1.0", "simulated by real time without lockstep"),
    "start_planner": ("true", "start one of the suite's planners"),
    "log_level": ("info", "debug, info, warn, error or fatal"),
}


def generate_launch_description():
    """Return the three nodes with their arguments."""
    arguments = [
        DeclareLaunchArgument(name, default_value=default, description=description)
        for name, (default, description) in ARGUMENTS.items()
    ]
    use_map = DeclareLaunchArgument(
        "use_map",
        default_value=EqualsSubstitution(LaunchConfiguration("protocol"), "paper"),
        description="the planner plans on a map; has to be what the protocol says",
    )
    return LaunchDescription(
        [
            *arguments,
            use_map,
            include(
                "barn_sim", "simulator", "dataset", "lockstep", "real_time_factor", "log_level", start_paused="true"
            ),
            include(
                "barn_planners",
                "planner",
                "planner",
                "use_map",
                "log_level",
                condition=IfCondition(LaunchConfiguration("start_planner")),
            ),
            include(
                "barn_eval",
                "evaluator",
                "dataset",
                "worlds",
                "planner",
                "protocol",
                "seed",
                "repetitions",
                "out",
                "log_level",
            ),
        ]
    )


def include(package, name, *passed, condition=None, **fixed):
    """Include a launch file of a package, handing on the arguments named."""
    path = PathJoinSubstitution([FindPackageShare(package), "launch", f"{name}.launch.py"])
    values = {argument: LaunchConfiguration(argument) for argument in passed} | fixed
    return IncludeLaunchDescription(
        PythonLaunchDescriptionSource(path), launch_arguments=values.items(), condition=condition
    )
