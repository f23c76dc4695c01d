"""Tells when the evaluator has waited long enough during a trial. Times are passed in: nothing here reads a clock."""

from __future__ import annotations

from barn_eval.experiments.patience import Patience
from barn_eval.trials.outcome import Outcome


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
