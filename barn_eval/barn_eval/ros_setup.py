"""How the trials of a plan are run over ROS."""

from __future__ import annotations

from dataclasses import dataclass, field

from barn_eval.evaluator_config import BAGS, INPUTS, RESTARTS, EvaluatorConfig
from barn_eval.gate import COMMAND_TYPES
from barn_eval.patience import Patience
from barn_worlds.config import Checked, quantity

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
    planner_node: str = quantity(_DEFAULTS.planner_node, "full name of the planner node; empty: the sender of commands")
    required_inputs: tuple[str, ...] = quantity(
        _DEFAULTS.required_inputs, "topics that the planner must subscribe to", choices=INPUTS
    )
    bags: str = quantity(_DEFAULTS.bags, "which trials keep a bag", choices=BAGS)
    restart_planner: str = quantity(
        _DEFAULTS.restart_planner, "when the planner is started afresh for the next trial", choices=RESTARTS
    )
    patience: Patience = field(default_factory=Patience)
