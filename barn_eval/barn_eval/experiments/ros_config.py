"""How trials are run over ROS: how the planner under test is reached, and how simulator and nodes are set up."""

import re
from dataclasses import dataclass, field

from barn_eval.experiments.patience import Patience
from barn_worlds.config import Checked, quantity
from barn_worlds.errors import ConfigError

MODES = ("direct", "ros")
ENGINES = ("local", "ray", "inline")
BAGS = ("all", "failed", "none")
INPUTS = ("scan", "odom", "goal_pose", "map", "amcl_pose", "tf")
RESTARTS = ("on_fault", "each_trial", "never")
GOAL_WAYS = ("topic", "action")
COMMAND_TYPES = ("auto", "twist", "twist_stamped")

_NAME = r"[A-Za-z_]\w*"
_NAMESPACE = re.compile(rf"/?{_NAME}(/{_NAME})*")
_REMAP = re.compile(rf"[/~]*{_NAME}(/{_NAME})*:=[/~]*{_NAME}(/{_NAME})*")


@dataclass(frozen=True)
class PlannerLink(Checked):
    """How the planner under test is reached over ROS; shared by the evaluator's parameters and `RosSetup`."""

    command_type: str = quantity("auto", "type of the commands on cmd_vel", choices=COMMAND_TYPES)
    planner_node: str = quantity(
        "", "name of the node whose ~/ready, ~/reset and seed are used if it has them; empty: the sender of commands"
    )
    goal_by: str = quantity("topic", "how the planner gets its goal", choices=GOAL_WAYS)
    goal_action: str = quantity("navigate_to_pose", "name of the action that takes the goal, with goal_by action")
    goal_action_type: str = quantity(
        "nav2_msgs/action/NavigateToPose", "its type; the goal must have a field pose of type PoseStamped"
    )
    lifecycle_nodes: tuple[str, ...] = quantity(
        (), "names of managed nodes that must be active before a trial, such as bt_navigator"
    )
    required_inputs: tuple[str, ...] = quantity(
        ("scan", "odom", "goal_pose"), "topics that the planner must subscribe to", choices=INPUTS
    )
    map_frame: str = quantity("map", "frame of the map, and of the goal where the planner is given a map")
    odom_frame: str = quantity("odom", "frame of the odometry, and of the goal where it is not")
    restart_planner: str = quantity(
        "on_fault", "when a supervised planner is started afresh for the next trial", choices=RESTARTS
    )
    patience: Patience = field(default_factory=Patience)


@dataclass(frozen=True)
class RosSetup(PlannerLink):
    """What a run over ROS needs to know beyond its trials."""

    lockstep: bool = quantity(True, "the simulator waits for a command after each scan")
    command_wait_s: float = quantity(
        5.0, "how long it waits, by the machine's clock", "s", minimum=0.001, maximum=3600.0
    )
    real_time_factor: float = quantity(
        1.0, "simulated by real time without lockstep, 0 for as fast as it can", minimum=0.0, maximum=1000.0
    )
    namespace: str = quantity("", "namespace of simulator and evaluator, and of our planners; such as robot1")
    remap: tuple[str, ...] = quantity((), "topics that go by another name in simulator and evaluator, as FROM:=TO")
    base_frame: str = quantity("base_link", "frame of the robot")
    lidar_frame: str = quantity("lidar_link", "frame of the scans")

    def __post_init__(self) -> None:
        super().__post_init__()
        for rule in self.remap:
            if not _REMAP.fullmatch(rule):
                raise ConfigError(f"remap must be of the form FROM:=TO, got {rule!r}")
        if self.namespace and not _NAMESPACE.fullmatch(self.namespace):
            raise ConfigError(f"namespace must be names joined by '/', got {self.namespace!r}")
