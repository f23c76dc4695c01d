"""How trials run over ROS: how the planner is reached, and what nodes wait for."""

import re
from dataclasses import dataclass

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
        "time limit instead of simulator_s and gate_s before the first trial, when kernels may compile",
    )
    simulator_s: float = _limit(30.0, "time limit for the simulator to start and reset")
    gate_s: float = _limit(30.0, "time limit for the planner to start and become ready")
    lifecycle_s: float = _limit(
        60.0, "time limit for all lifecycle_nodes to become active"
    )
    mismatch_s: float = _limit(
        2.0, "time limit for replacing publishers of a wrong type", 0.0
    )
    settle_s: float = _limit(
        0.3,
        "time for which all nodes must stay on the ROS graph before a trial",
        0.0,
        60.0,
    )
    connection_s: float = _limit(
        3.0,
        "time limit for simulator and planner to connect after both are on the ROS graph",
        0.0,
        60.0,
    )
    service_s: float = _limit(10.0, "time limit for the answer to a service call")
    command_s: float = _limit(15.0, "time limit without a command during a trial")
    clock_s: float = _limit(15.0, "time limit without a tick of /clock during a trial")
    vanished_s: float = _limit(
        1.0,
        "time limit without a publisher of the planner on the ROS graph during a trial",
        0.0,
    )
    slowness: float = quantity(
        50.0,
        "limit of wall-clock time per simulated second, averaged over a minute in"
        " which lockstep waits for the planner",
        "s",
        1.0,
        1e6,
    )
    trial_s: float = _limit(3600.0, "time limit for a whole trial", maximum_s=1e6)


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
        "name of the planner's node to wait for; the evaluator uses its ~/ready,"
        " ~/reset and seed if they exist; empty: the node that sends commands",
    )
    goal_by: str = quantity(
        "topic", "interface by which the planner gets its goal", choices=GOAL_METHODS
    )
    goal_action: str = quantity(
        "navigate_to_pose",
        "name of the action that takes the goal if goal_by is action",
    )
    goal_action_type: str = quantity(
        "nav2_msgs/action/NavigateToPose",
        "type of goal_action; its goal must have a field pose of type PoseStamped",
    )
    lifecycle_nodes: tuple[str, ...] = quantity(
        (),
        "names of lifecycle nodes that must be active before a trial, such as bt_navigator",
    )
    required_inputs: tuple[str, ...] = quantity(
        ("scan", "odom", "goal_pose"),
        "topics that the planner must subscribe to",
        choices=INPUTS,
    )
    map_frame: str = quantity(
        "map", "frame of the map, and of the goal if the planner gets a map"
    )
    odom_frame: str = quantity(
        "odom", "frame of the odometry, and of the goal if the planner gets no map"
    )
    planner_rate_hz: float = quantity(
        0.0,
        "rate of the planner's commands that lockstep waits for; 0: one command per scan, or the measured rate",
        "Hz",
        0.0,
        1000.0,
    )
    restart_planner: str = quantity(
        "on_fault",
        "when the suite restarts a planner that it started",
        choices=RESTARTS,
    )
    patience: WaitLimits = WaitLimits()


@dataclass(frozen=True)
class RosConfig(PlannerLink):
    """What a run over ROS needs to know beyond its trials."""

    lockstep: bool = quantity(
        True, "whether the simulator waits for a command after each scan"
    )
    command_wait_s: float = _limit(
        5.0, "longest wait of the simulator for a command, in wall-clock time", 0.001
    )
    real_time_factor: float = quantity(
        1.0,
        "ratio of simulated time to real time without lockstep; 0: as fast as possible",
        "",
        0.0,
        1000.0,
    )
    namespace: str = quantity(
        "", "namespace of simulator, evaluator and the suite's planners, such as robot1"
    )
    remap: tuple[str, ...] = quantity(
        (),
        "topics to rename in simulator and evaluator, as FROM:=TO for several topics or remap.FROM=TO for one topic",
    )
    base_frame: str = quantity("base_link", "frame of the robot")
    lidar_frame: str = quantity("lidar_link", "frame of the scans")
    ground_truth: bool = quantity(
        False,
        "whether to publish the true pose and contacts; rows name the nodes that read them",
    )
    isolate: bool = quantity(
        True,
        "whether the planner's processes can see and signal only each other, if the kernel supports this",
    )

    def check_rules(self) -> None:
        """Raise ConfigError for a malformed remap or namespace, or a bad value."""
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
        "folder of the results; a run with the same configuration is resumed there",
    )
    bags: str = quantity("all", "which trials keep a bag", choices=BAGS)
    simulator_node: str = quantity(
        "simulator", "name of the simulator node; a relative name is in this namespace"
    )
    system: str = quantity(
        "",
        "YAML file of a simulator or robot that you run yourself; empty: the suite's simulator",
    )
    publish_map: bool = quantity(
        True,
        "whether to publish the map if the protocol gives a map; false: a map server publishes it",
    )
    bag_exclude: tuple[str, ...] = quantity(
        ("/parameter_events",), "topics that are not recorded"
    )
    assignment: str = quantity("", "file with the supervisor's instructions")
    supervisor_fd: int = quantity(
        -1, "socket to the supervisor; -1: none", "", -1, 1_000_000
    )
    simulator_fd: int = quantity(
        -1, "private socket to the simulator; -1: none", "", -1, 1_000_000
    )
