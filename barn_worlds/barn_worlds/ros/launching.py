"""Launch files made from a node's configuration.

Each has the arguments params_file, namespace and log_level, an argument NAME_topic for each topic, and every parameter
of the node without a dot in its name. A parameter that is not given keeps the value of the file, else of the node.
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

COMMON_ARGUMENTS = {
    "params_file": ("", "file with parameters; arguments override it"),
    "namespace": ("", "namespace of node and topics"),
    "log_level": ("info", "debug, info, warn, error or fatal"),
}
SIM_TIME = ("use_sim_time", "take the time from /clock")
LOG_LEVEL = (
    "--ros-args",
    "--log-level",
    LaunchConfiguration("log_level"),
)  # arguments of a node


@dataclass(frozen=True)
class NodeLaunch:
    """A node and its launch arguments.

    configs: name, type and meaning of the parameters. topics: those that can be remapped. more: parameters that are in
    no configuration, with their meaning. leave_out: parameters without an argument. use_sim_time: its default, None if
    the node does not follow /clock. ends_launch: whether the whole launch ends when the node does.
    """

    package: str
    executable: str
    configs: Sequence[Any]
    topics: Sequence[str]
    more: Mapping[str, str] = field(default_factory=dict)
    leave_out: Sequence[str] = ()
    use_sim_time: bool | None = None
    ends_launch: bool = False

    def description(self) -> LaunchDescription:
        """Return the node with its arguments."""
        declared = [
            launch_argument(name, "", about)
            for name, (_, about) in self._kinds().items()
        ]
        if self.use_sim_time is not None:
            declared.append(
                launch_argument(
                    SIM_TIME[0], str(self.use_sim_time).lower(), SIM_TIME[1]
                )
            )
        declared += [
            launch_argument(topic_argument(name), name, f"topic to use for {name}")
            for name in self.topics
        ]
        declared += [
            launch_argument(name, default, about)
            for name, (default, about) in COMMON_ARGUMENTS.items()
        ]
        return LaunchDescription([*declared, OpaqueFunction(function=self._make)])

    def _kinds(self) -> dict[str, tuple[type, str]]:
        """Return type and meaning of each parameter that is an argument."""
        kinds: dict[str, tuple[Any, str]] = {
            name: (str, about) for name, about in self.more.items()
        }
        for name, about, value in (
            found for config in self.configs for found in fields_of(config)
        ):
            if "." not in name and name not in self.leave_out:
                kinds[name] = (
                    list[str] if isinstance(value, tuple) else type(value),
                    about.summary(),
                )
        return kinds

    def _make(self, context: LaunchContext) -> list[LaunchDescriptionEntity]:
        kinds = {name: kind for name, (kind, _) in self._kinds().items()}
        kinds |= {SIM_TIME[0]: bool} if self.use_sim_time is not None else {}
        given = {
            name: ParameterValue(LaunchConfiguration(name), value_type=kind)
            for name, kind in kinds.items()
            if LaunchConfiguration(name).perform(context)
        }
        file = LaunchConfiguration("params_file").perform(context)
        node = Node(
            package=self.package,
            executable=self.executable,
            name=self.executable,
            namespace=LaunchConfiguration("namespace"),
            parameters=[*([ParameterFile(file)] if file else []), given],
            remappings=[
                (name, LaunchConfiguration(topic_argument(name)))
                for name in self.topics
            ],
            arguments=list(LOG_LEVEL),
            output="screen",
            on_exit=[Shutdown(reason=f"the {self.executable} has ended")]
            if self.ends_launch
            else None,
        )
        return [node]


def launch_argument(
    name: str, default: object, description: str
) -> DeclareLaunchArgument:
    """Return an argument of a launch file."""
    return DeclareLaunchArgument(name, default_value=default, description=description)


def topic_argument(name: str) -> str:
    """Return the name of the argument that remaps a topic."""
    return name.replace("/", "_") + "_topic"


def include_launch_file(
    package: str,
    name: str,
    passed: Iterable[str],
    when: Condition | None = None,
    **fixed: str,
) -> GroupAction:
    """Include a launch file of a package and pass the named arguments on; what it sets stays inside."""
    path = PathJoinSubstitution(
        [FindPackageShare(package), "launch", f"{name}.launch.py"]
    )
    values = {
        launch_argument: LaunchConfiguration(launch_argument)
        for launch_argument in passed
    } | fixed
    included = IncludeLaunchDescription(
        PythonLaunchDescriptionSource(path), launch_arguments=values.items()
    )
    return GroupAction([included], condition=when, scoped=True)
