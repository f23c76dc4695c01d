"""How long the evaluator waits for the others, in seconds of the machine's clock.

Only these limits let the machine's speed have a part in an outcome.
"""

from dataclasses import dataclass

from barn_worlds.config import Checked, quantity


@dataclass(frozen=True)
class Patience(Checked):
    """Limits in seconds of the machine's clock."""

    start_s: float = quantity(
        180.0,
        "in place of the next two before the first trial, when kernels may be compiled",
        "s",
        minimum=0.1,
        maximum=3600.0,
    )
    simulator_s: float = quantity(30.0, "until the simulator is there and reset", "s", minimum=0.1, maximum=3600.0)
    gate_s: float = quantity(30.0, "until the planner is there and ready", "s", minimum=0.1, maximum=3600.0)
    lifecycle_s: float = quantity(
        60.0, "until all managed nodes that are waited for are active", "s", minimum=0.1, maximum=3600.0
    )
    mismatch_s: float = quantity(
        2.0, "how long publishers of a wrong type are given to be replaced", "s", minimum=0.0, maximum=3600.0
    )
    settle_s: float = quantity(
        0.3,
        "how long the graph must have been complete, for the others to see it as well",
        "s",
        minimum=0.0,
        maximum=60.0,
    )
    connection_s: float = quantity(
        3.0, "for simulator and planner to be connected once they are on the graph", "s", minimum=0.0, maximum=60.0
    )
    service_s: float = quantity(10.0, "for the answer to a service call", "s", minimum=0.1, maximum=3600.0)
    command_s: float = quantity(15.0, "without a command, during a trial", "s", minimum=0.1, maximum=3600.0)
    clock_s: float = quantity(15.0, "without a tick of /clock, during a trial", "s", minimum=0.1, maximum=3600.0)
    vanished_s: float = quantity(
        1.0, "for which a planner may have no publisher on the graph, during a trial", "s", minimum=0.0, maximum=3600.0
    )
    trial_s: float = quantity(3600.0, "for a whole trial", "s", minimum=0.1, maximum=1e6)
