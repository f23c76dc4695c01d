"""The three processes of a run over ROS: commands, parameters and environment."""

import os
import socket
import sys
import tempfile
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, fields
from pathlib import Path
from typing import Any

from barn_eval.results.store import BagStore
from barn_eval.ros.supervision import launcher, start
from barn_eval.ros.supervision.process import SupervisedProcess
from barn_eval.running.planner_choices import split_command
from barn_eval.running.planner_packages import Executable, find_packaged
from barn_eval.trials.ros_config import PlannerLink, RosConfig
from barn_eval.trials.run_config import PlannerChoice, RunConfig, fill_placeholders
from barn_eval.trials.spec import TrialSpec
from barn_sim.config import SimulatorConfig, SimulatorNodeConfig, robot_of
from barn_worlds.base.config import Checked, as_dict
from barn_worlds.base.errors import ConfigError, convert_os_errors
from barn_worlds.base.files import dump_yaml, write_durably
from barn_worlds.base.types import Pose2D
from barn_worlds.robots.files import ROBOTS, robot_yaml

# Ends the detail of a fault that a planner without isolation may have caused.
PLANNER_SUSPECTED = "the planner may have caused it"
# A profile that keeps Fast DDS on the loopback interface.
_LOOPBACK = Path(__file__).parents[2] / "data" / "dds" / "loopback.xml"
_WHEELS_MARK = "_ROS_WHEELS_BOOTSTRAP_COMPLETE"
_LIBRARY_PATH = "LD_LIBRARY_PATH"
_RANGE = "ROS_AUTOMATIC_DISCOVERY_RANGE"
_TRANSPORTS = "FASTDDS_BUILTIN_TRANSPORTS"
_PROFILE = "FASTRTPS_DEFAULT_PROFILES_FILE"
# Variables by which a user may have set a profile for Fast DDS.
_USER_PROFILES = {_PROFILE, "FASTDDS_DEFAULT_PROFILES_FILE"}
# Variables with the default 1. The last has Fast DDS ignore a profile in the working
# directory, where a planner may leave one that cuts off the planners after it.
_SET_TO_1 = (
    "RCUTILS_LOGGING_BUFFERED_STREAM",
    "PYTHONUNBUFFERED",
    "OMP_NUM_THREADS",
    "OPENBLAS_NUM_THREADS",
    "NUMBA_NUM_THREADS",
    "SKIP_DEFAULT_XML_FILE",
)


@dataclass(frozen=True)
class NodeProcess:
    """A process to start."""

    # "simulator", "planner" or "evaluator".
    name: str
    command: tuple[str, ...]
    # ROS parameters; the command reads them from a file.
    parameters: Mapping[str, Any]
    # Other arguments of ROS, such as remappings.
    arguments: tuple[str, ...] = ()
    # Whether the command is the user's.
    foreign: bool = False
    # What is written to its standard input.
    input: str = ""
    # The executable of a planner that starts from the source of a package.
    executable: Executable | None = None

    def write_parameters(self, folder: Path) -> list[str]:
        """Write FOLDER/NAME.yaml, if there are parameters; return the command with it.

        Raises:
            ConfigError: If the file cannot be written.
        """
        # A planner of the user takes its parameters from its own command.
        if not self.parameters:
            return list(self.command)
        path = folder / f"{self.name}.yaml"
        # The wildcard fits the node under any name and in any namespace.
        content = {"/**": {"ros__parameters": dict(self.parameters)}}
        with convert_os_errors(ConfigError, path):
            path.write_text(dump_yaml(content), "utf-8")
        return [
            *self.command,
            "--ros-args",
            *self.arguments,
            "--params-file",
            str(path),
        ]

    def variables(self, inherited: Mapping[str, str], folder: Path) -> dict[str, str]:
        """Return its variables, without the suite's ROS if foreign; make FOLDER/prefix.

        Raises:
            ConfigError: If that cannot be written.
        """
        variables = dict(inherited)
        if self.foreign:
            variables = foreign_environment(variables)
        if self.executable is not None:
            variables |= self.executable.make_prefix(folder / "prefix", variables)
        return variables

    def start(
        self,
        inherited: Mapping[str, str],
        folder: Path,
        sockets: Sequence[socket.socket] = (),
        kind: str = launcher.SUITE,
    ) -> SupervisedProcess:
        """Write its files, start it under a launcher; add output to FOLDER/NAME.log.

        Args:
            inherited: Environment variables.
            folder: Folder of logs.
            sockets: Inherited by the command under the same numbers.
            kind: What the launcher is told about the command.

        Raises:
            ConfigError: If a file cannot be written.
        """
        return SupervisedProcess(
            self.name,
            self.write_parameters(folder),
            self.variables(inherited, folder),
            folder / f"{self.name}.log",
            sockets,
            kind,
            self.input,
        )


@dataclass(frozen=True)
class Assignment:
    """What the evaluator is to do: trials of one planner."""

    # With that planner only.
    run: RunConfig
    # Names of the trials that have no result yet, and the numbers of their worlds.
    trials: tuple[str, ...]
    worlds: tuple[int, ...]
    # Folder of the results, where bags go.
    out: str
    # Name or file of the robot, for the simulator node.
    robot: str
    # Nothing else has been started: the evaluator first looks for other nodes on the
    # domain, and then has simulator and planner started.
    look_first: bool = False
    # Whether the planner cannot signal the suite's processes.
    isolated: bool = False

    @property
    def store(self) -> BagStore:
        """The results folder, with the run's rule on which bags are kept."""
        return BagStore(Path(self.out), self.run.bags)

    def specs(self) -> list[TrialSpec]:
        """Return the specifications of the assigned trials, with their worlds read.

        Raises:
            WorldError: If a world cannot be read.
        """
        specs = self.run.trials(self.worlds)
        return [spec for spec in specs if spec.trial_id in self.trials]


def simulator(setup: RosConfig, line: int, robot: str) -> NodeProcess:
    """Return the simulator's process to start; `line` is a file descriptor.

    The evaluator sets world, start and seed later.

    Args:
        setup: How the nodes are set up.
        line: File descriptor of its end of the private line.
        robot: Name or file of the robot.

    Returns:
        The process to start.
    """
    parameters = {
        "robot": robot,
        "start_paused": True,
        "evaluator_fd": line,
        **_parameters_of(setup, SimulatorNodeConfig),
        "real_time_factor": setup.real_time_factor,
        "command_wait_s": setup.command_wait_s,
    }
    return _suite_node("simulator", "barn_sim.ros.simulator:main", parameters, setup)


def name_robot(config: SimulatorConfig, folder: Path) -> str:
    """Return the robot's built-in name, or write FOLDER/robot.yaml and return its path.

    Args:
        config: Configuration of the simulator.
        folder: Where the file is written.

    Returns:
        A name or an absolute path.
    """
    name = config.chassis.name
    if name in ROBOTS and ROBOTS[name].chassis == config.chassis:
        return name
    path = folder / "robot.yaml"
    write_durably(path, robot_yaml(robot_of(config)).encode())
    return str(path.resolve())


def planner(
    choice: PlannerChoice, run: RunConfig, goal: Pose2D | None = None
) -> NodeProcess:
    """Return the planner's process, a command or node; ConfigError without its goal.

    Args:
        choice: The planner.
        run: Protocol and settings of the run.
        goal: Goal of the next trial, for placeholders in command and input; None if it
            is not known when the planner starts.

    Returns:
        The process to start.

    Raises:
        ConfigError: If there are placeholders of a goal that is not known.
    """
    setup = run.ros
    if choice.command:
        if goal is None and choice.takes_goal_at_start:
            raise ConfigError(
                f"planner {choice.name!r}: no goal is known at its start to fill in {{goal_x}} and other placeholders"
            )
        frame = setup.map_frame if run.protocol.map_given else setup.odom_frame
        command = choice.command
        text = choice.input
        if goal is not None:
            command = fill_placeholders(command, goal, frame)
            text = fill_placeholders(text, goal, frame)
        words = split_command(command)
        executable = find_packaged(words)
        if executable is not None:
            words[:1] = executable.command
        return NodeProcess(
            "planner", tuple(words), {}, foreign=True, input=text, executable=executable
        )

    # The node would not find presets of the protocol and changes by the robot itself.
    planner_setup = run.resolve_planner(choice)
    # The suite's planners cannot find out which type a simulator takes.
    command_type = "twist"
    if setup.command_type == "twist_stamped":
        command_type = "twist_stamped"
    parameters: dict[str, Any] = {
        "planner": choice.entry_name,
        "preset": planner_setup.preset,
        "use_map": run.protocol.map_given,
        "use_sim_time": True,
        "map_frame": setup.map_frame,
        "odom_frame": setup.odom_frame,
        "base_frame": setup.base_frame,
        "command_type": command_type,
        **planner_setup.overrides,
    }
    return _suite_node("planner", "barn_planners.ros.planner:main", parameters, setup)


def evaluator(
    assignment: Path, setup: RosConfig, supervisor: int, simulator: int
) -> NodeProcess:
    """Return the evaluator's process to start; the last two are file descriptors.

    Args:
        assignment: File of what it is to do.
        setup: How the nodes are set up.
        supervisor: File descriptor of its socket to the supervisor.
        simulator: File descriptor of its end of the private line.

    Returns:
        The process to start.
    """
    parameters = {
        **_parameters_of(setup, PlannerLink),
        "assignment": str(assignment),
        "supervisor_fd": supervisor,
        "simulator_fd": simulator,
    }
    return _suite_node("evaluator", "barn_eval.ros.evaluator:main", parameters, setup)


def _parameters_of(setup: RosConfig, node_config: type[Checked]) -> dict[str, Any]:
    """Return the settings of a run whose names are fields of the node's config."""
    names = {field.name for field in fields(node_config)}
    return {key: value for key, value in as_dict(setup).items() if key in names}


def environment(inherited: Mapping[str, str], domain: int) -> dict[str, str]:
    """Return the user's variables with defaults, and with domain and DDS transport set.

    Args:
        inherited: Variables of the user, which win over buffers and threads.
        domain: ROS domain of the processes.

    Returns:
        Variables for a domain of its own on the loopback interface, with one thread for
        each library.
    """
    defaults = dict.fromkeys(_SET_TO_1, "1")
    # rclpy does not start without a folder for its logs, and services have no home.
    if not os.access(inherited.get("HOME", ""), os.W_OK):
        defaults["ROS_LOG_DIR"] = tempfile.gettempdir()
    fixed = _transport(inherited) | {"ROS_DOMAIN_ID": str(domain)}
    return defaults | dict(inherited) | fixed


def _transport(inherited: Mapping[str, str]) -> dict[str, str]:
    """Return DDS variables: discovery on this host or as the user set it, by UDP.

    The range LOCALHOST alone has Fast DDS listen on all interfaces and use shared
    memory, whatever transports it is configured for. Through shared memory a process
    started in place of one that was killed may hear nothing for seconds (up to 3 s, by
    UDP 0.15 s), and each kill leaves segments behind. So a profile says the same and
    more.
    """
    discovery = inherited.get(_RANGE, "LOCALHOST")
    middleware = inherited.get("RMW_IMPLEMENTATION", "rmw_fastrtps_cpp")
    if (
        discovery == "LOCALHOST"
        and middleware.startswith("rmw_fastrtps")
        and _USER_PROFILES.isdisjoint(inherited)
    ):
        return {_RANGE: "SYSTEM_DEFAULT", _PROFILE: str(_LOOPBACK)}
    return {_RANGE: discovery, _TRANSPORTS: inherited.get(_TRANSPORTS, "UDPv4")}


def discovery_range() -> str:
    """Return this process's discovery range; LOCALHOST by the suite's profile."""
    # The profile may be that of another installation of the package, from which the
    # process was started.
    profile = Path(os.environ.get(_PROFILE, ""))
    if profile.parts[-3:] == _LOOPBACK.parts[-3:]:
        return "LOCALHOST"
    return os.environ.get(_RANGE, "SUBNET")


def foreign_environment(variables: Mapping[str, str]) -> dict[str, str]:
    """Return a copy of the variables without those that this Python's ROS wheels set.

    They put their libraries into LD_LIBRARY_PATH and leave a mark that this has been
    done. The wheels of another virtual environment would then load these libraries.
    """
    prefix = Path(sys.prefix).resolve()
    folders = []
    for folder in variables.get(_LIBRARY_PATH, "").split(os.pathsep):
        if folder and not Path(folder).resolve().is_relative_to(prefix):
            folders.append(folder)
    foreign = dict(variables)
    foreign.pop(_WHEELS_MARK, None)
    foreign.pop(_LIBRARY_PATH, None)
    if folders:
        foreign[_LIBRARY_PATH] = os.pathsep.join(folders)
    return foreign


def _suite_node(
    name: str, entry: str, parameters: Mapping[str, Any], setup: RosConfig
) -> NodeProcess:
    """Return a node of "MODULE:FUNCTION" to start, with namespace and remappings."""
    # The user's remappings are for simulator, evaluator and planners of the suite
    # alike.
    rules = list(setup.remap)
    namespace = setup.namespace.strip("/")
    if namespace:
        rules.insert(0, f"__ns:=/{namespace}")
    arguments: list[str] = []
    for rule in rules:
        arguments += ["-r", rule]
    return NodeProcess(
        name, (sys.executable, start.__file__, entry), parameters, tuple(arguments)
    )
