"""The three processes of a run over ROS: what is started, with which parameters, in which environment."""

import os
import sys
from collections.abc import Mapping
from dataclasses import dataclass, fields
from pathlib import Path
from typing import Any

import yaml

from barn_eval.results.store import BagStore
from barn_eval.ros.supervision import start
from barn_eval.running.planner_choices import split_command
from barn_eval.trials.ros_config import PlannerLink, RosConfig
from barn_eval.trials.run_config import PlannerChoice, RunConfig
from barn_eval.trials.spec import TrialSpec
from barn_sim.config import SimulatorConfig, robot_of
from barn_worlds.base.config import as_dict
from barn_worlds.base.errors import ConfigError, convert_os_errors
from barn_worlds.base.files import write_durably
from barn_worlds.robots.files import ROBOTS, robot_text

NOT_TOLD = "nothing tells that from the planner's doing"
_LOOPBACK = (
    Path(__file__).parents[2] / "data" / "dds" / "loopback.xml"
)  # keeps Fast DDS on the loopback interface
_WHEELS_MARK = "_ROS_WHEELS_BOOTSTRAP_COMPLETE"
_RANGE, _TRANSPORTS = "ROS_AUTOMATIC_DISCOVERY_RANGE", "FASTDDS_BUILTIN_TRANSPORTS"
_PROFILE = "FASTRTPS_DEFAULT_PROFILES_FILE"
_PROFILES = {_PROFILE, "FASTDDS_DEFAULT_PROFILES_FILE"}  # the user's own for Fast DDS
_BUFFERS = ("RCUTILS_LOGGING_BUFFERED_STREAM", "PYTHONUNBUFFERED")
_THREADS = ("OMP_NUM_THREADS", "OPENBLAS_NUM_THREADS", "NUMBA_NUM_THREADS")


@dataclass(frozen=True)
class NodeProcess:
    """A process to start: name, command, parameters, other arguments of ROS, and whether the command is the user's."""

    name: str
    command: tuple[str, ...]
    parameters: Mapping[str, Any]
    arguments: tuple[str, ...] = ()
    foreign: bool = False

    def with_parameter_file(self, folder: Path) -> list[str]:
        """Write the parameters to a file in the folder and return the command that reads them."""
        if not self.parameters:
            return list(self.command)
        path = folder / f"{self.name}.yaml"
        content = {"/**": {"ros__parameters": dict(self.parameters)}}
        with convert_os_errors(ConfigError, path):
            path.write_text(yaml.safe_dump(content, sort_keys=False), "utf-8")
        return [
            *self.command,
            "--ros-args",
            *self.arguments,
            "--params-file",
            str(path),
        ]


@dataclass(frozen=True)
class Assignment:
    """Trials of the one planner of an experiment, by name, and where their bags go."""

    experiment: RunConfig
    trials: tuple[str, ...]
    worlds: tuple[int, ...]
    out: str
    robot: str  # name or file, for the simulator node
    look_first: bool = False  # nothing else has been started: the evaluator has it started once nobody is in the way
    apart: bool = False  # the planner cannot signal the suite's processes

    @property
    def store(self) -> BagStore:
        """Where bags go."""
        return BagStore(Path(self.out), self.experiment.bags)

    def specs(self) -> list[TrialSpec]:
        """Return the trials; WorldError if a world cannot be read."""
        return [
            spec
            for spec in self.experiment.trials(self.worlds)
            if spec.trial_id in self.trials
        ]


def simulator(setup: RosConfig, line: int, robot: str) -> NodeProcess:
    """Return the simulator of a robot, by name or file; world, start and seed come from the evaluator."""
    shared = [
        "lockstep",
        "command_type",
        "real_time_factor",
        "command_wait_s",
        "ground_truth",
    ]
    frames = ("map_frame", "odom_frame", "base_frame", "lidar_frame")
    parameters = {
        "robot": robot,
        "start_paused": True,
        "evaluator_fd": line,
        **_values(setup, *shared, *frames),
    }
    return _node("simulator", "barn_sim.ros.simulator:main", parameters, setup)


def robot_of_simulator(config: SimulatorConfig, folder: Path) -> str:
    """Return the name of the robot that is simulated, or a file for it in the folder where no name says the same."""
    name = config.chassis.name
    if name in ROBOTS and ROBOTS[name].chassis == config.chassis:
        return name
    path = folder / "robot.yaml"
    write_durably(path, robot_text(robot_of(config)).encode())
    return str(path.resolve())


def planner(choice: PlannerChoice, experiment: RunConfig) -> NodeProcess:
    """Return the planner under test: the user's command as it is, or a node of the suite."""
    setup = experiment.ros
    if choice.command:
        return NodeProcess(
            "planner", tuple(split_command(choice.command)), {}, foreign=True
        )
    planner_setup = experiment.resolve_planner(choice)
    parameters: dict[str, Any] = {
        "planner": choice.name,
        "preset": planner_setup.preset,
        "use_map": experiment.protocol.map_given,
        "use_sim_time": True,
        "command_type": "twist_stamped"
        if setup.command_type == "twist_stamped"
        else "twist",
        **_values(setup, "map_frame", "odom_frame", "base_frame"),
        **planner_setup.overrides,
    }
    return _node("planner", "barn_planners.ros.planner:main", parameters, setup)


def evaluator(
    assignment: Path, setup: RosConfig, supervisor: int, simulator: int
) -> NodeProcess:
    """Return the evaluator, which reads from a file what it is to do."""
    shared = {field.name for field in fields(PlannerLink)}
    parameters = {key: value for key, value in as_dict(setup).items() if key in shared}
    parameters |= {
        "assignment": str(assignment),
        "supervisor_fd": supervisor,
        "simulator_fd": simulator,
    }
    return _node("evaluator", "barn_eval.ros.evaluator:main", parameters, setup)


def environment(inherited: Mapping[str, str], domain: int) -> dict[str, str]:
    """Return the environment of all processes, in which what the user has set stands.

    Their own domain, the loopback interface only, one thread each for their kernels.
    """
    set_here = _transport(inherited) | {"ROS_DOMAIN_ID": str(domain)}
    return dict.fromkeys((*_BUFFERS, *_THREADS), "1") | dict(inherited) | set_here


def _transport(inherited: Mapping[str, str]) -> dict[str, str]:
    """Return what keeps messages on this host, unless the user has asked for more.

    The range LOCALHOST alone has Fast DDS listen on all interfaces and use shared memory, whatever transports are asked
    for: through that a process started in place of one that was killed may hear nothing for seconds (up to 3 s, by UDP
    0.15 s), and each kill leaves segments behind. So it is a profile that says the same and more.
    """
    asked = inherited.get(_RANGE, "LOCALHOST")
    fast = inherited.get("RMW_IMPLEMENTATION", "rmw_fastrtps_cpp").startswith(
        "rmw_fastrtps"
    )
    if asked == "LOCALHOST" and fast and not inherited.keys() & _PROFILES:
        return {_RANGE: "SYSTEM_DEFAULT", _PROFILE: str(_LOOPBACK)}
    return {_RANGE: asked, _TRANSPORTS: inherited.get(_TRANSPORTS, "UDPv4")}


def reach() -> str:
    """Return how far this process looks for others, in the words of ROS.

    The profile may be that of another installation of the package, from which the process was started.
    """
    if Path(os.environ.get(_PROFILE, "")).parts[-3:] == _LOOPBACK.parts[-3:]:
        return "LOCALHOST"
    return os.environ.get(_RANGE, "SUBNET")


def foreign_environment(ours: Mapping[str, str]) -> dict[str, str]:
    """Return the environment of all processes without what the ROS wheels of this Python have added to it.

    They put their libraries into LD_LIBRARY_PATH and leave a mark that this has been done, upon which the wheels of
    another virtual environment would leave it so and load ours.
    """
    prefix, libraries = (
        Path(sys.prefix).resolve(),
        ours.get("LD_LIBRARY_PATH", "").split(os.pathsep),
    )
    kept = [
        part
        for part in libraries
        if part and not Path(part).resolve().is_relative_to(prefix)
    ]
    theirs = {
        name: value
        for name, value in ours.items()
        if name not in (_WHEELS_MARK, "LD_LIBRARY_PATH")
    }
    return theirs | ({"LD_LIBRARY_PATH": os.pathsep.join(kept)} if kept else {})


def _values(setup: RosConfig, *names: str) -> dict[str, Any]:
    return {name: getattr(setup, name) for name in names}


def _node(
    name: str, entry: str, parameters: Mapping[str, Any], setup: RosConfig
) -> NodeProcess:
    namespace = (
        [f"__ns:=/{setup.namespace.strip('/')}"] if setup.namespace.strip("/") else []
    )
    names = tuple(part for rule in (*namespace, *setup.remap) for part in ("-r", rule))
    return NodeProcess(name, (sys.executable, start.__file__, entry), parameters, names)
