"""Launch files made from the configuration of a node.

Each has the arguments params_file, namespace and log_level, an argument NAME_topic for
each topic, and every parameter of the node without a dot in its name. A parameter that
is not set keeps the value of the file, else of the node.
"""

from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass, field
from typing import Any

from launch import LaunchContext, LaunchDescription, LaunchDescriptionEntity
from launch.actions import (
    DeclareLaunchArgument,
    GroupAction,
    IncludeLaunchDescription,
    OpaqueFunction,
    Shutdown,
)
from launch.condition import Condition
from launch.launch_description_sources import PythonLaunchDescriptionSource
from launch.substitutions import LaunchConfiguration, PathJoinSubstitution
from launch_ros.actions import Node
from launch_ros.parameter_descriptions import ParameterFile, ParameterValue
from launch_ros.substitutions import FindPackageShare

from barn_worlds.base.config import fields_of

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


@dataclass(frozen=True)
class NodeLaunch:
    """A node and its launch arguments."""

    package: str
    executable: str

    configs: Sequence[Any]
    """Configurations whose fields are the parameters of the node."""

    topics: Sequence[str]
    """Topics that can be remapped."""

    extra: Mapping[str, str] = field(default_factory=dict)
    """Meanings of further parameters, by name, which are texts."""

    leave_out: Sequence[str] = ()
    """Parameters without an argument."""

    use_sim_time: bool | None = None
    """Default of use_sim_time, None if the node does not follow /clock."""

    ends_launch: bool = False
    """Whether the whole launch ends when the node does."""

    def description(self) -> LaunchDescription:
        """Return the node with its arguments."""
        arguments = []
        defaults = {SIM_TIME[0]: str(self.use_sim_time).lower()}
        for name, (_, meaning) in self._parameters().items():
            arguments.append(launch_argument(name, defaults.get(name, ""), meaning))
        for name in self.topics:
            meaning = f"topic to use for {name}"
            arguments.append(launch_argument(topic_argument(name), name, meaning))
        for name, (default, meaning) in COMMON_ARGUMENTS.items():
            arguments.append(launch_argument(name, default, meaning))
        return LaunchDescription([*arguments, OpaqueFunction(function=self._make_node)])

    def _parameters(self) -> dict[str, tuple[Any, str]]:
        """Return type and meaning of the parameters that are arguments, by name."""
        parameters: dict[str, tuple[Any, str]] = {}
        for name, meaning in self.extra.items():
            parameters[name] = (str, meaning)
        for config in self.configs:
            for name, declaration, value in fields_of(config):
                if "." not in name and name not in self.leave_out:
                    kind = list[str] if isinstance(value, tuple) else type(value)
                    parameters[name] = (kind, declaration.summary())
        if self.use_sim_time is not None:
            name, meaning = SIM_TIME
            parameters[name] = (bool, meaning)
        return parameters

    def _make_node(self, context: LaunchContext) -> list[LaunchDescriptionEntity]:
        values = {}
        for name, (kind, _) in self._parameters().items():
            argument = LaunchConfiguration(name)
            # An empty argument leaves the parameter to the file or the node.
            if argument.perform(context):
                values[name] = ParameterValue(argument, value_type=kind)

        # Later parameters override earlier ones.
        parameters: list[Any] = [values]
        file = LaunchConfiguration("params_file").perform(context)
        if file:
            parameters.insert(0, ParameterFile(file))
        on_exit = None
        if self.ends_launch:
            on_exit = [Shutdown(reason=f"the {self.executable} has ended")]
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
            on_exit=on_exit,
        )
        return [node]


def launch_argument(
    name: str, default: object, description: str
) -> DeclareLaunchArgument:
    """Return an argument of a launch file.

    Args:
        name: What stands before := on the command line.
        default: Text or substitution that counts where the argument is not set.
        description: Meaning, for `ros2 launch --show-args`.
    """
    return DeclareLaunchArgument(name, default_value=default, description=description)


def topic_argument(name: str) -> str:
    """Return the name of the argument that remaps a topic."""
    return name.replace("/", "_") + "_topic"


def include_launch_file(
    package: str,
    name: str,
    arguments: Iterable[str],
    when: Condition | None = None,
    **fixed: str,
) -> GroupAction:
    """Include a launch file; what it sets stays inside.

    Args:
        package: Package with the file.
        name: Name of the file without .launch.py.
        arguments: Names of the arguments that are passed on.
        when: Condition of the include.
        fixed: Values of further arguments.
    """
    path = PathJoinSubstitution(
        [FindPackageShare(package), "launch", f"{name}.launch.py"]
    )
    values = {argument: LaunchConfiguration(argument) for argument in arguments} | fixed
    launch_file = IncludeLaunchDescription(
        PythonLaunchDescriptionSource(path), launch_arguments=values.items()
    )
    return GroupAction([launch_file], condition=when, scoped=True)
