"""How trials run over ROS: how the planner is reached, and what nodes wait for."""

import re
from dataclasses import dataclass, field

from barn_worlds.base.config import Checked, quantity
from barn_worlds.base.errors import ConfigError

MODES = ("direct", "ros")
ENGINES = ("local", "ray", "inline")
BAGS = ("all", "failed", "none")
INPUTS = ("scan", "odom", "goal_pose", "map", "amcl_pose", "tf")
RESTARTS = ("on_fault", "each_trial", "never")
GOAL_METHODS = ("topic", "action")
COMMAND_TYPES = ("auto", "twist", "twist_stamped")

_NAME = r"[A-Za-z_]\w*"
_NAMESPACE = re.compile(rf"/?{_NAME}(/{_NAME})*")
_REMAP = re.compile(rf"[/~]*{_NAME}(/{_NAME})*:=[/~]*{_NAME}(/{_NAME})*")


def _limit(
    default_s: float,
    description: str,
    minimum_s: float = 0.1,
    maximum_s: float = 3600.0,
) -> float:
    """Return a dataclass field for a time in s: default, help text and range."""
    return quantity(default_s, description, "s", minimum_s, maximum_s)


@dataclass(frozen=True)
class WaitLimits(Checked):
    """How long the evaluator waits for other nodes.

    Time counts by the evaluator's own turns: what it spends suspended or waiting for a
    processor does not count. Only through these limits can a slow machine change an
    outcome.
    """

    start_s: float = _limit(
        180.0,
        "replaces simulator_s and gate_s before the first trial, as kernels may compile",
    )
    simulator_s: float = _limit(30.0, "until the simulator is running and reset")
    gate_s: float = _limit(30.0, "until the planner is running and ready")
    lifecycle_s: float = _limit(60.0, "until all nodes of lifecycle_nodes are active")
    mismatch_s: float = _limit(
        2.0, "time for publishers of a wrong type to be replaced", 0.0
    )
    settle_s: float = _limit(
        0.3,
        "time for which the graph must stay complete, so that all nodes see it",
        0.0,
        60.0,
    )
    connection_s: float = _limit(
        3.0,
        "for simulator and planner to connect once they are on the graph",
        0.0,
        60.0,
    )
    service_s: float = _limit(10.0, "for the answer to a service call")
    command_s: float = _limit(15.0, "without a command, during a trial")
    clock_s: float = _limit(15.0, "without a tick of /clock, during a trial")
    vanished_s: float = _limit(
        1.0,
        "for which the planner may lack a publisher on the graph, during a trial",
        0.0,
    )
    slowness: float = quantity(
        50.0,
        "limit per simulated second, over a minute in which the planner owes answers",
        "s",
        1.0,
        1e6,
    )
    trial_s: float = _limit(3600.0, "for a whole trial", maximum_s=1e6)


@dataclass(frozen=True)
class PlannerLink(Checked):
    """How the planner under test is reached over ROS.

    The evaluator's parameters and `RosConfig` share it.
    """

    command_type: str = quantity(
        "auto", "type of the commands on cmd_vel", choices=COMMAND_TYPES
    )
    planner_node: str = quantity(
        "",
        "name of a node to wait for, whose ~/ready, ~/reset and seed are used if"
        " offered; empty: the node that sends commands",
    )
    goal_by: str = quantity(
        "topic", "how the planner gets its goal", choices=GOAL_METHODS
    )
    goal_action: str = quantity(
        "navigate_to_pose",
        "name of the action that takes the goal if goal_by is action",
    )
    goal_action_type: str = quantity(
        "nav2_msgs/action/NavigateToPose",
        "type of goal_action, whose goal must have a field pose of type PoseStamped",
    )
    lifecycle_nodes: tuple[str, ...] = quantity(
        (),
        "names of managed nodes that must be active before a trial, such as"
        " bt_navigator",
    )
    required_inputs: tuple[str, ...] = quantity(
        ("scan", "odom", "goal_pose"),
        "topics that the planner must subscribe to",
        choices=INPUTS,
    )
    map_frame: str = quantity(
        "map", "frame of the map, and of the goal if the planner is given a map"
    )
    odom_frame: str = quantity(
        "odom", "frame of the odometry, and of the goal if the planner is given no map"
    )
    planner_rate_hz: float = quantity(
        0.0,
        "rate at which the planner sends commands, which are all that lockstep waits for;"
        " 0: one per scan, or the rate that is found",
        "Hz",
        0.0,
        1000.0,
    )
    restart_planner: str = quantity(
        "on_fault",
        "when a supervised planner is restarted for the next trial",
        choices=RESTARTS,
    )
    patience: WaitLimits = field(default_factory=WaitLimits)


@dataclass(frozen=True)
class RosConfig(PlannerLink):
    """What a run over ROS needs to know beyond its trials."""

    lockstep: bool = quantity(True, "the simulator waits for a command after each scan")
    command_wait_s: float = _limit(
        5.0, "longest wait of the simulator for a command, in wall-clock time", 0.001
    )
    real_time_factor: float = quantity(
        1.0,
        "simulated over real time without lockstep; 0: as fast as possible",
        "",
        0.0,
        1000.0,
    )
    namespace: str = quantity(
        "", "namespace of simulator, evaluator and the suite's planners, such as robot1"
    )
    remap: tuple[str, ...] = quantity(
        (),
        "topics that have another name in simulator and evaluator, as FROM:=TO, or"
        " one by one as remap.FROM=TO",
    )
    base_frame: str = quantity("base_link", "frame of the robot")
    lidar_frame: str = quantity("lidar_link", "frame of the scans")
    ground_truth: bool = quantity(
        False, "publish the true pose and contacts; rows name who reads them"
    )
    isolate: bool = quantity(
        True,
        "the planner's processes see and signal only each other, if the kernel supports"
        " that",
    )

    def __post_init__(self) -> None:
        """Raise ConfigError for a malformed remap or namespace, or a bad value."""
        super().__post_init__()
        for rule in self.remap:
            if not _REMAP.fullmatch(rule):
                raise ConfigError(f"remap must be of the form FROM:=TO, got {rule!r}")
        if self.namespace and not _NAMESPACE.fullmatch(self.namespace):
            raise ConfigError(
                f"namespace must be names joined by '/', got {self.namespace!r}"
            )


@dataclass(frozen=True)
class EvaluatorConfig(PlannerLink):
    """Parameters of the evaluator; topics are renamed by remapping.

    `barn` starts a supervised evaluator together with the other nodes. The file
    `assignment` then says what to do, and the first group of parameters is ignored.
    """

    dataset: str = quantity("barn300", "data set: a name, folder or file")
    worlds: str = quantity(
        "0", "worlds of the data set, such as 0, 0-49 or 0:300:6", is_selection=True
    )
    planner: str = quantity("planner", "name that the planner has in the results")
    protocol: str = quantity("challenge", "name of the protocol, or a YAML file")
    robot: str = quantity("jackal", "name of the robot, or a YAML file")
    seed: int = quantity(0, "seed of the run", "", 0, 2**62)
    repetitions: int = quantity(1, "trials per world", "", 1, 99)
    out: str = quantity(
        "barn_out",
        "folder of the results; an equal run that it holds is resumed",
    )
    bags: str = quantity("all", "which trials keep a bag", choices=BAGS)
    simulator_node: str = quantity(
        "simulator", "name of the simulator node; a relative name is in this namespace"
    )
    system: str = quantity(
        "",
        "YAML file of a simulator or robot that somebody else runs; empty: the suite's"
        " simulator",
    )
    publish_map: bool = quantity(
        True,
        "publish the map if the protocol gives one; a map server may do so instead",
    )
    bag_exclude: tuple[str, ...] = quantity(
        ("/parameter_events",), "topics that are not recorded"
    )
    assignment: str = quantity("", "file that says what to do, from the supervisor")
    supervisor_fd: int = quantity(
        -1, "socket to the supervisor, -1 for none", "", -1, 1_000_000
    )
    simulator_fd: int = quantity(
        -1, "private line to the simulator, -1 for none", "", -1, 1_000_000
    )
