"""Code that the nodes' launch files share.

`ros2 launch` runs in the system's Python, which lacks the libraries of the suite. So
this module and the launch files import only the standard library, launch and what
launch needs itself, and read a node's parameters from its file in the folder config.

Each launch file has the arguments params_file, namespace and log_level, an argument
NAME_topic for each topic, and one for each parameter of the node whose name has no dot
or begins with `patience.`. A parameter that you do not set keeps the value in the file,
else the node's default.
"""

import re
import subprocess
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from functools import cached_property
from pathlib import Path
from typing import Any

import yaml
from ament_index_python import get_package_prefix, get_package_share_directory
from launch import LaunchContext, LaunchDescription, LaunchDescriptionEntity
from launch.actions import (
    DeclareLaunchArgument,
    GroupAction,
    IncludeLaunchDescription,
    OpaqueFunction,
    Shutdown,
)
from launch.condition import Condition
from launch.events.process import ProcessExited
from launch.launch_description_sources import PythonLaunchDescriptionSource
from launch.substitutions import LaunchConfiguration, PathJoinSubstitution
from launch_ros.actions import Node
from launch_ros.parameter_descriptions import ParameterFile, ParameterValue
from launch_ros.substitutions import FindPackageShare

# Default and meaning of the arguments that every launch file has.
COMMON_ARGUMENTS = {
    "params_file": ("", "file with parameters; arguments override it"),
    "namespace": ("", "namespace of node and topics"),
    "log_level": ("info", "debug, info, warn, error or fatal"),
}
# Name and meaning of an argument of nodes that follow /clock.
SIM_TIME = ("use_sim_time", "take the time from /clock")
# Command-line arguments of a node.
LOG_LEVEL = ("--ros-args", "--log-level", LaunchConfiguration("log_level"))
# A parameter of a generated file, behind the comment that says what it means.
_ENTRY = re.compile(r"^ +# (.+)\n +([\w.]+): (.+)", re.MULTILINE)


@dataclass(frozen=True)
class NodeLaunch:
    """A node and its launch arguments."""

    package: str

    executable: str
    """Name of the executable, of the node, and of its parameter file in config."""

    topics: Sequence[str]
    """Topics that can be remapped."""

    use_sim_time: bool | None = None
    """Default of use_sim_time, None if the node does not follow /clock."""

    ends_launch: bool = False
    """Whether the whole launch ends when the node does, with its exit code."""

    def description(self) -> LaunchDescription:
        """Return the launch description: all arguments, then the node."""
        arguments = {}
        for name, (_, default, meaning) in self._parameters.items():
            arguments[name] = (default, meaning)
        for name in self.topics:
            arguments[topic_argument(name)] = (name, f"topic to use for {name}")
        actions = declare_arguments(arguments | COMMON_ARGUMENTS)
        return LaunchDescription([*actions, OpaqueFunction(function=self._make_node)])

    @cached_property
    def _parameters(self) -> dict[str, tuple[Any, str, str]]:
        """Type, default and meaning of parameters that are arguments, by name."""
        parameters: dict[str, tuple[Any, str, str]] = {}
        share = Path(get_package_share_directory(self.package))
        text = (share / "config" / f"{self.executable}.yaml").read_text("utf-8")
        for meaning, name, value in _ENTRY.findall(text):
            if "." not in name or name.startswith("patience."):
                kind: Any = type(yaml.safe_load(value))
                if kind is list:
                    kind = list[str]
                parameters[name] = (kind, "", meaning)
        if self.use_sim_time is not None:
            name, meaning = SIM_TIME
            parameters[name] = (bool, str(self.use_sim_time).lower(), meaning)
        return parameters

    def _make_node(self, context: LaunchContext) -> list[LaunchDescriptionEntity]:
        """Return the node's action, in a list; RuntimeError without libraries."""
        check_environment(self.package, self.executable)
        values = {}
        for name, (kind, _, _) in self._parameters.items():
            argument = LaunchConfiguration(name)
            # An empty argument leaves the parameter to the file or the node.
            if argument.perform(context):
                values[name] = ParameterValue(argument, value_type=kind)

        # Later parameters override earlier ones.
        file = LaunchConfiguration("params_file").perform(context)
        parameters = [ParameterFile(file), values] if file else [values]
        node = Node(
            package=self.package,
            executable=self.executable,
            name=self.executable,
            namespace=LaunchConfiguration("namespace"),
            parameters=parameters,
            remappings=[
                (name, LaunchConfiguration(topic_argument(name)))
                for name in self.topics
            ],
            arguments=list(LOG_LEVEL),
            output="screen",
            on_exit=self._end if self.ends_launch else None,
        )
        return [node]

    def _end(self, event: ProcessExited, context: LaunchContext) -> Shutdown | None:
        """Return the launch's shutdown; RuntimeError if the node failed by itself.

        Raises:
            RuntimeError: The node has failed. launch ends all the same, and only an
                exception makes it exit with 1.
        """
        if event.returncode and not context.is_shutdown:
            raise RuntimeError(f"the {self.executable} ended with {event.returncode}")
        return Shutdown(reason=f"the {self.executable} has ended")


def check_environment(package: str, executable: str) -> None:
    """Raise RuntimeError unless the Python of a node has the libraries of the suite.

    Raises:
        RuntimeError: If it lacks them, or if there is no such Python anymore.
    """
    script = Path(get_package_prefix(package), "lib", package, executable)
    with script.open("rb") as file:
        python = file.readline().decode().removeprefix("#!").split()
    try:
        # cattrs comes with no distribution of ROS.
        subprocess.run(
            [*python, "-c", "import cattrs"], capture_output=True, check=True
        )
    except (OSError, subprocess.CalledProcessError):
        raise RuntimeError(
            f"{package}: the Python of {executable}, {' '.join(python)}, lacks the"
            " suite's libraries: activate their environment and build the workspace"
            " again"
        ) from None


def declare_arguments(
    arguments: Mapping[str, tuple[Any, str]],
) -> list[DeclareLaunchArgument]:
    """Return launch actions that declare arguments with their defaults and meanings.

    Args:
        arguments: Default, a text or a substitution, and meaning of each by its name.
    """
    return [
        DeclareLaunchArgument(name, default_value=default, description=meaning)
        for name, (default, meaning) in arguments.items()
    ]


def topic_argument(name: str) -> str:
    """Return the launch argument that remaps a topic: a_b_topic for a/b."""
    return name.replace("/", "_") + "_topic"


def include_launch_file(
    package: str, name: str, when: Condition | None = None, **fixed: str
) -> GroupAction:
    """Return an action that includes a launch file, which sees this one's arguments.

    Args:
        package: Package with the file.
        name: Name of the file without .launch.py.
        when: Condition of the include.
        fixed: Values of arguments that differ; they do not reach other launch files.
    """
    path = PathJoinSubstitution(
        [FindPackageShare(package), "launch", f"{name}.launch.py"]
    )
    launch_file = IncludeLaunchDescription(
        PythonLaunchDescriptionSource(path), launch_arguments=fixed.items()
    )
    return GroupAction([launch_file], condition=when, scoped=True)
