"""How long the evaluator waits for the others, by the machine's clock, and what it concludes when it has waited enough.

Only these limits let the machine's speed have a part in an outcome. Times are passed in: nothing here reads a clock.
"""

from __future__ import annotations

from dataclasses import dataclass

from barn_eval.outcome import Outcome
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


class Watch:
    """Tell when patience is at an end during a trial."""

    def __init__(self, patience: Patience, now_s: float) -> None:
        self._patience = patience
        self._began_s = self._ticked_s = self._commanded_s = self._publisher_s = now_s
        self._commands = 0

    def tick(self, now_s: float) -> None:
        """Note that the simulated time has moved on."""
        self._ticked_s = now_s

    def command(self, now_s: float) -> None:
        """Note a command."""
        self._commanded_s = now_s
        self._commands += 1

    def publisher_seen(self, now_s: float) -> None:
        """Note that the planner's publisher of commands is on the graph."""
        self._publisher_s = now_s

    def judge(self, now_s: float, *, moved: bool) -> tuple[Outcome, str] | None:
        """Return what has gone wrong, if anything has; `moved`: whether the robot has made its first motion."""
        patience = self._patience
        if now_s - self._ticked_s > patience.clock_s:
            return Outcome.SIMULATOR_DIED, f"no tick of /clock for {patience.clock_s:g} s"
        if now_s - self._publisher_s > patience.vanished_s:
            return Outcome.PLANNER_DIED, "its publisher of commands has vanished from the graph"
        if now_s - self._commanded_s > patience.command_s:
            waited = f"no command for {patience.command_s:g} s of the machine's clock"
            if not moved:
                since = "" if self._commands else ", none since the trial began"
                return Outcome.NO_FIRST_MOTION, waited + since
            return Outcome.PLANNER_STALLED, waited
        if now_s - self._began_s > patience.trial_s:
            return Outcome.PLANNER_STALLED, f"no verdict after {patience.trial_s:g} s of the machine's clock"
        return None
