"""Start simulator, planner and evaluator together.

    ros2 launch barn_eval trial.launch.py worlds:=0 planner:=dwa rviz:=true

`start_planner:=false` leaves the planner out, for one of your own. All arguments go to
the other launch files, also those that only they declare; `params_file` can have a
section for each node.
"""

from contextlib import suppress
from importlib.util import find_spec
from pathlib import Path
from typing import Any

import yaml
from launch import LaunchContext, LaunchDescription, LaunchDescriptionEntity
from launch.actions import OpaqueFunction, SetLaunchConfiguration
from launch.conditions import IfCondition
from launch.substitutions import LaunchConfiguration

from barn_worlds.ros.launching import declare_arguments, include_launch_file

# The launch files below declare more, such as namespace and params_file.
ARGUMENTS = {
    "dataset": ("barn300", "data set: a name, folder or file"),
    "worlds": ("0", "worlds of the data set, such as 0, 0-49 or 0:300:6"),
    "planner": ("dwa", "name of the planner"),
    "protocol": (
        "challenge",
        "challenge, dynabarn, known_map, paper2020 or a YAML file",
    ),
    "preset": ("", "preset of the planner's parameters; empty: the protocol's"),
    "use_map": ("", "the planner plans on a map; empty: as the protocol says"),
    "out": ("barn_out", "folder of the results"),
    "lockstep": ("true", "the simulator waits for a command after each scan"),
    "start_planner": ("true", "start one of the suite's planners"),
    "rviz": ("false", "show the trials in RViz"),
}
# Keys of a protocol for arguments that are left empty, and their values in a protocol
# without them: see `Protocol`.
PROTOCOL_KEYS = {
    "preset": ("planner_preset", "paper2020"),
    "use_map": ("map_given", True),
}


def generate_launch_description() -> LaunchDescription:
    """Return a launch description of all nodes and their arguments."""
    start_planner = IfCondition(LaunchConfiguration("start_planner"))
    start_rviz = IfCondition(LaunchConfiguration("rviz"))
    return LaunchDescription(
        [
            *declare_arguments(ARGUMENTS),
            OpaqueFunction(function=_apply_protocol),
            include_launch_file("barn_sim", "simulator", start_paused="true"),
            include_launch_file("barn_planners", "planner", start_planner),
            include_launch_file("barn_eval", "evaluator", use_sim_time="false"),
            include_launch_file("barn_eval", "rviz", start_rviz),
        ]
    )


def _apply_protocol(context: LaunchContext) -> list[LaunchDescriptionEntity]:
    """Return actions that set empty arguments to what the protocol says."""
    protocol = _read_protocol(LaunchConfiguration("protocol").perform(context))
    return [
        SetLaunchConfiguration(name, str(protocol.get(key, default)))
        for name, (key, default) in PROTOCOL_KEYS.items()
        if not LaunchConfiguration(name).perform(context)
    ]


def _read_protocol(source: str) -> dict[str, Any]:
    """Return the keys of a protocol and its bases, {} if it is missing or broken.

    The evaluator says what is wrong with it.
    """
    # Importing the package would import libraries that this Python lacks.
    package = find_spec("barn_eval")
    if package is None or package.origin is None:
        return {}
    file = Path(package.origin).parent / "data" / "protocols.yaml"
    protocols = yaml.safe_load(file.read_text("utf-8"))
    own_file = Path(source)
    if source not in protocols:
        own = None
        with suppress(OSError, UnicodeDecodeError, yaml.YAMLError):
            own = yaml.safe_load(own_file.read_text("utf-8"))
        if isinstance(own, dict):
            protocols[source] = own

    content: dict[str, Any] = {}
    while isinstance(source, str) and source in protocols:
        content = protocols.pop(source) | content
        source = content.pop("base", "")
    return content
