"""How the trials of a plan are run over ROS."""

from __future__ import annotations

import re
from dataclasses import dataclass, field

from barn_eval.evaluator_config import BAGS, GOAL_WAYS, INPUTS, RESTARTS, EvaluatorConfig
from barn_eval.gate import COMMAND_TYPES
from barn_eval.patience import Patience
from barn_worlds.config import Checked, quantity
from barn_worlds.errors import ConfigError

_NAME = r"[A-Za-z_]\w*"
_NAMESPACE = re.compile(rf"/?{_NAME}(/{_NAME})*")
_REMAP = re.compile(rf"[/~]*{_NAME}(/{_NAME})*:=[/~]*{_NAME}(/{_NAME})*")
_DEFAULTS = EvaluatorConfig()


@dataclass(frozen=True)
class RosSetup(Checked):
    """What a run over ROS needs to know beyond its trials."""

    lockstep: bool = quantity(True, "the simulator waits for a command after each scan")
    command_wait_s: float = quantity(
        5.0, "how long it waits, by the machine's clock", "s", minimum=0.001, maximum=3600.0
    )
    real_time_factor: float = quantity(
        1.0, "simulated by real time without lockstep, 0 for as fast as it can", minimum=0.0, maximum=1000.0
    )
    command_type: str = quantity("auto", "type of the commands on cmd_vel", choices=tuple(COMMAND_TYPES))
    namespace: str = quantity("", "namespace of simulator and evaluator, and of our planners; such as robot1")
    remap: tuple[str, ...] = quantity((), "topics that go by another name in simulator and evaluator, as FROM:=TO")
    map_frame: str = quantity(_DEFAULTS.map_frame, "frame of the map")
    odom_frame: str = quantity(_DEFAULTS.odom_frame, "frame of the odometry")
    base_frame: str = quantity("base_link", "frame of the robot")
    lidar_frame: str = quantity("lidar_link", "frame of the scans")
    planner_node: str = quantity(_DEFAULTS.planner_node, "name of the planner node; empty: the sender of commands")
    goal_by: str = quantity(_DEFAULTS.goal_by, "how the planner gets its goal", choices=GOAL_WAYS)
    goal_action: str = quantity(_DEFAULTS.goal_action, "name of the action that takes the goal, with goal_by action")
    goal_action_type: str = quantity(_DEFAULTS.goal_action_type, "type of that action")
    lifecycle_nodes: tuple[str, ...] = quantity(
        _DEFAULTS.lifecycle_nodes, "names of managed nodes that must be active before a trial"
    )
    required_inputs: tuple[str, ...] = quantity(
        _DEFAULTS.required_inputs, "topics that the planner must subscribe to", choices=INPUTS
    )
    bags: str = quantity(_DEFAULTS.bags, "which trials keep a bag", choices=BAGS)
    restart_planner: str = quantity(
        _DEFAULTS.restart_planner, "when the planner is started afresh for the next trial", choices=RESTARTS
    )
    patience: Patience = field(default_factory=Patience)

    def __post_init__(self) -> None:
        super().__post_init__()
        for rule in self.remap:
            if not _REMAP.fullmatch(rule):
                raise ConfigError(f"RosSetup.remap must be of the form FROM:=TO, got {rule!r}")
        if self.namespace and not _NAMESPACE.fullmatch(self.namespace):
            raise ConfigError(f"RosSetup.namespace must be names joined by '/', got {self.namespace!r}")
