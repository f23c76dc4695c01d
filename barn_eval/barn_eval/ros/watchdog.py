"""Tells when the evaluator has waited long enough during a trial. Times are passed in: nothing here reads a clock."""

from barn_eval.experiments.ros_config import Patience
from barn_eval.trials.outcome import Outcome

_WINDOW_S = 60.0  # over which the pace of a planner is judged


class Watchdog:
    """Tell when patience is at an end during a trial, before which so many commands had come."""

    def __init__(self, patience: Patience, now_s: float, commands: int = 0) -> None:
        self._patience = patience
        self._began_s = self._ticked_s = self._commanded_s = self._publisher_s = now_s
        self._ticks, self._commands, self._commands_before = 0, commands, commands
        self._window = (now_s, 0.0, 0.0)

    def hear(self, now_s: float, ticks: int, commands: int) -> None:
        """Note how many ticks of the simulated time, and how many commands, have come so far."""
        if ticks > self._ticks:
            self._ticks, self._ticked_s = ticks, now_s
        if commands > self._commands:
            self._commands, self._commanded_s = commands, now_s

    def publisher_seen(self, now_s: float) -> None:
        """Note that the planner's publisher of commands is on the graph."""
        self._publisher_s = now_s

    def judge(
        self, now_s: float, *, moved: bool, simulated_s: float = 0.0, waited_s: float = 0.0
    ) -> tuple[Outcome, str] | None:
        """Return what has gone wrong, if anything has.

        moved: whether the robot has made its first motion. simulated_s: so far; waited_s: wall-clock time in which the
        planner owed an answer to a scan, so far.
        """
        patience = self._patience
        if now_s - self._ticked_s > patience.clock_s:
            return Outcome.SIMULATOR_DIED, f"no tick of /clock for {patience.clock_s:g} s"
        if now_s - self._publisher_s > patience.vanished_s:
            return Outcome.PLANNER_DIED, "its publisher of commands has vanished from the graph"
        # a planner owes nothing until time goes on after its last command: it may be the simulator that is stuck
        if self._ticked_s > self._commanded_s and now_s - self._commanded_s > patience.command_s:
            waited = f"no command for {patience.command_s:g} s of wall-clock time"
            since = "" if self._commands > self._commands_before else ", none since the trial began"
            return (Outcome.PLANNER_STALLED, waited) if moved else (Outcome.NO_FIRST_MOTION, waited + since)
        slow = self._slowness(now_s, simulated_s, waited_s)
        if now_s - self._began_s > patience.trial_s:
            slow = f"no verdict after {patience.trial_s:g} s of wall-clock time"
        return (Outcome.PLANNER_STALLED, slow) if slow else None

    def _slowness(self, now_s: float, simulated_s: float, waited_s: float) -> str:
        """Return how slow the planner was in the last minute, empty if it was fast enough or that is not over."""
        began_s, before_s, owed_s = self._window
        lasted_s, progress_s = now_s - began_s, simulated_s - before_s
        if lasted_s < _WINDOW_S:
            return ""
        self._window = (now_s, simulated_s, waited_s)
        if progress_s * self._patience.slowness > lasted_s or waited_s - owed_s < 0.5 * lasted_s:
            return ""
        most = f"more than {self._patience.slowness:g} s per simulated second"
        return f"{lasted_s:.0f} s of wall-clock time for {progress_s:.2f} simulated seconds: {most}"
