"""Configuration of the evaluator node: the run, whom it talks to, and how patient it is."""

from __future__ import annotations

from dataclasses import dataclass, field

from barn_eval.gate import COMMAND_TYPES
from barn_eval.patience import Patience
from barn_worlds.config import Checked, quantity

BAGS = ("all", "failed", "none")
INPUTS = ("scan", "odom", "goal_pose", "map", "amcl_pose", "tf")
RESTARTS = ("on_fault", "each_trial", "never")
GOAL_WAYS = ("topic", "action")


@dataclass(frozen=True)
class EvaluatorConfig(Checked):
    """Parameters of the evaluator. Topics are renamed by remapping, as those of any node.

    Supervised, the evaluator was started by `barn run`, which also starts the other nodes: the plan then comes from
    OUT/run.json and the first group of parameters is not looked at.
    """

    dataset: str = quantity("barn300", "data set: a name, folder or file")
    worlds: str = quantity("0", "which of its worlds, such as 0, 0-49 or 0:300:6")
    planner: str = quantity("planner", "name that the planner has in the results")
    protocol: str = quantity("challenge", "name of the protocol, or a YAML file")
    seed: int = quantity(0, "seed of the run", minimum=0, maximum=2**62)
    repetitions: int = quantity(1, "trials per world", minimum=1, maximum=99)
    out: str = quantity("barn_out", "folder of the results; an equal run that was begun there is continued")
    simulator_node: str = quantity("simulator", "name of the simulator node; relative names are of this namespace")
    planner_node: str = quantity(
        "",
        "name of the node whose ~/ready, ~/reset and seed are used if it has them; empty: the sender of commands",
    )
    command_type: str = quantity("auto", "type of the commands on cmd_vel", choices=tuple(COMMAND_TYPES))
    required_inputs: tuple[str, ...] = quantity(
        ("scan", "odom", "goal_pose"), "topics that the planner must subscribe to", choices=INPUTS
    )
    goal_by: str = quantity("topic", "how the planner gets its goal", choices=GOAL_WAYS)
    goal_action: str = quantity("navigate_to_pose", "name of the action that takes the goal, with goal_by action")
    goal_action_type: str = quantity(
        "nav2_msgs/action/NavigateToPose", "its type; the goal must have a field pose of type PoseStamped"
    )
    lifecycle_nodes: tuple[str, ...] = quantity(
        (), "names of managed nodes that must be active before a trial, such as bt_navigator"
    )
    map_frame: str = quantity("map", "frame of the map, and of the goal where the planner is given a map")
    odom_frame: str = quantity("odom", "frame of the odometry, and of the goal where it is not")
    publish_map: bool = quantity(True, "publish the map, where the protocol gives one; a map server may do it instead")
    bags: str = quantity("all", "which trials keep a bag", choices=BAGS)
    bag_exclude: tuple[str, ...] = quantity(("/parameter_events",), "topics that are not recorded")
    restart_planner: str = quantity(
        "on_fault", "when a supervised planner is started afresh for the next trial", choices=RESTARTS
    )
    supervisor_fd: int = quantity(-1, "socket to the supervisor, -1 for none", minimum=-1, maximum=1_000_000)
    patience: Patience = field(default_factory=Patience)
