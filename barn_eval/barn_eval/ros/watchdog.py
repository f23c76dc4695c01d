"""Tells when the evaluator has waited long enough during a trial. Times are passed in: nothing here reads a clock."""

from barn_eval.experiments.ros_config import Patience
from barn_eval.trials.outcome import Outcome
from barn_worlds.base.types import nanoseconds, seconds

# Of a stamp: a planner may stamp what is to come, and a slow one what is long past.
_TOLERANCE_NS = nanoseconds(60.0)
_WINDOW_S = 60.0  # over which the pace of a planner is judged


class Watchdog:
    """Tell when patience is at an end during a trial."""

    def __init__(self, patience: Patience, now_s: float) -> None:
        self._patience = patience
        self._began_s = self._ticked_s = self._commanded_s = self._publisher_s = now_s
        self._commands = 0
        self._window = (now_s, 0.0, 0.0)

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
            if not moved:
                since = "" if self._commands else ", none since the trial began"
                return Outcome.NO_FIRST_MOTION, waited + since
            return Outcome.PLANNER_STALLED, waited
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


class StampCheck:
    """Look at the first stamped message of each topic of a planner, for one that does not take the time from /clock.

    A stamp of 0 says nothing: many planners leave it out.
    """

    def __init__(self) -> None:
        self._seen: set[str] = set()
        self._fault = ""

    def wants(self, topic: str) -> bool:
        """Tell whether no message of a topic has been looked at yet."""
        return topic not in self._seen

    def take(self, topic: str, stamp_ns: int, now_ns: int) -> None:
        """Look at a stamp, the simulated time being `now_ns`."""
        self._seen.add(topic)
        if stamp_ns and abs(stamp_ns - now_ns) > _TOLERANCE_NS and not self._fault:
            stamp, now = seconds(stamp_ns), seconds(now_ns)
            self._fault = f"{topic} is stamped {stamp:.1f} s while /clock shows {now:.1f} s: use_sim_time is off"

    def text(self) -> str:
        """Return what is wrong in one line, an empty text where nothing is."""
        return self._fault
