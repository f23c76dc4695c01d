"""Start simulator, planner and evaluator together.

    ros2 launch barn_eval trial.launch.py worlds:=0 planner:=dwa rviz:=true

`start_planner:=false` leaves the planner out, for one of your own. Other arguments go
to the other launch files; `params_file` goes to all nodes and can have a section for each.
"""

from launch import LaunchContext, LaunchDescription, LaunchDescriptionEntity
from launch.actions import OpaqueFunction, SetLaunchConfiguration
from launch.conditions import IfCondition
from launch.substitutions import LaunchConfiguration

from barn_eval.trials.protocol import load_protocol
from barn_worlds.ros.launching import (
    COMMON_ARGUMENTS,
    include_launch_file,
    launch_argument,
)

ARGUMENTS = {
    "dataset": ("barn300", "data set: a name, folder or file"),
    "worlds": ("0", "which of its worlds, such as 0, 0-49 or 0:300:6"),
    "planner": ("dwa", "name of the planner"),
    "protocol": (
        "challenge",
        "challenge, dynabarn, known_map, paper2020 or a YAML file",
    ),
    "preset": ("", "preset of the planner's parameters; empty: the protocol's"),
    "use_map": ("", "the planner plans on a map; empty: as the protocol says"),
    "seed": ("0", "seed of the run"),
    "repetitions": ("1", "trials per world"),
    "out": ("barn_out", "folder of the results"),
    "lockstep": ("true", "the simulator waits for a command after each scan"),
    "real_time_factor": ("1.0", "simulated by real time without lockstep"),
    "command_type": ("twist", "type of the commands: twist or twist_stamped"),
    "start_planner": ("true", "start one of the suite's planners"),
    "rviz": ("false", "show the trials in RViz"),
    "use_sim_time": ("true", "planner and RViz take the time from /clock"),
    **COMMON_ARGUMENTS,
}
ALL = tuple(COMMON_ARGUMENTS)
SIMULATOR = ("dataset", "lockstep", "real_time_factor", "command_type", *ALL)
PLANNER = ("planner", "preset", "use_map", "command_type", "use_sim_time", *ALL)
RVIZ = ("use_sim_time", "namespace", "log_level")
EVALUATOR = (
    "dataset",
    "worlds",
    "planner",
    "protocol",
    "seed",
    "repetitions",
    "out",
    "command_type",
    *ALL,
)


def generate_launch_description() -> LaunchDescription:
    """Return the nodes with their arguments."""
    arguments = [
        launch_argument(name, default, meaning)
        for name, (default, meaning) in ARGUMENTS.items()
    ]
    start_planner = IfCondition(LaunchConfiguration("start_planner"))
    start_rviz = IfCondition(LaunchConfiguration("rviz"))
    return LaunchDescription(
        [
            *arguments,
            OpaqueFunction(function=_apply_protocol),
            include_launch_file(
                "barn_sim", "simulator", SIMULATOR, start_paused="true"
            ),
            include_launch_file("barn_planners", "planner", PLANNER, start_planner),
            include_launch_file(
                "barn_eval", "evaluator", EVALUATOR, use_sim_time="false"
            ),
            include_launch_file("barn_eval", "rviz", RVIZ, start_rviz),
        ]
    )


def _apply_protocol(context: LaunchContext) -> list[LaunchDescriptionEntity]:
    """Set the arguments that are left empty to what the protocol says."""
    protocol = load_protocol(LaunchConfiguration("protocol").perform(context))
    defaults = {
        "preset": protocol.planner_preset,
        "use_map": str(protocol.map_given).lower(),
    }
    return [
        SetLaunchConfiguration(name, value)
        for name, value in defaults.items()
        if not LaunchConfiguration(name).perform(context)
    ]
