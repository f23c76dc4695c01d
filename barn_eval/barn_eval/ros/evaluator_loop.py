"""The loop of the evaluator, which runs callbacks and hears the supervisor."""

import time
from collections.abc import Callable
from typing import TypeVar

from rclpy.executors import ExternalShutdownException, SingleThreadedExecutor
from rclpy.node import Node

from barn_eval.ros.supervision.process import EventChannel
from barn_eval.trials.result import PLANNER, SIMULATOR, Outcome

T = TypeVar("T")

_OUTCOME_OF_END = {PLANNER: Outcome.PLANNER_DIED, SIMULATOR: Outcome.SIMULATOR_DIED}
_LONGEST_SPIN_S = 0.005  # between two looks at a condition
_CHECK_PERIOD_S = 0.05  # between two looks at what is missing
_NOTE_PERIOD_S = 5.0  # between two notes on what is waited for
_LONGEST_TURN_S = 0.02  # that counts of the time between two spins


class TrialEnded(Exception):
    """Something ends the trial with an outcome that the referee does not decide."""

    def __init__(self, outcome: Outcome, detail: str, culprit: str = ""):
        """Store outcome, detail and culprit of the trial's end.

        Args:
            outcome: Outcome of the trial.
            detail: What happened, in one line for the row.
            culprit: Who failed, as in `Verdict`; empty if the outcome says so.
        """
        super().__init__(f"{outcome.value}: {detail}")
        self.outcome = outcome
        self.detail = detail
        self.culprit = culprit


class PlannerNotReady(TrialEnded):
    """The planner has not done its part before the trial begins."""

    def __init__(self, detail: str):
        """Store outcome PLANNER_NOT_READY and `detail`, which is what is missing."""
        super().__init__(Outcome.PLANNER_NOT_READY, detail)


class StopRequested(Exception):
    """The process that started the evaluator wants it to end."""


class EvaluatorLoop:
    """Runs the node's callbacks; the only place where the evaluator spends time."""

    def __init__(
        self,
        node: Node,
        supervisor: EventChannel | None,
        on_exit: Callable[[str], None],
    ):
        """Add the node to an executor; `on_exit` gets the name of an ended process.

        Args:
            node: The evaluator node.
            supervisor: Channel to the process that started the other nodes; None
                where somebody starts them by hand.
            on_exit: Called with "planner" or "simulator" when that process has ended,
                before it starts again.
        """
        self.node = node
        self.supervisor = supervisor
        # Called at each spin.
        self.poll: Callable[[], None] = lambda: None
        # Time by which all limits count. It stands still while this process is
        # suspended and hardly passes while it waits for a processor, so that a busy
        # machine alone exceeds no limit.
        self.now_s = 0.0
        self._on_exit = on_exit
        self._executor = SingleThreadedExecutor(context=node.context)
        self._executor.add_node(node)
        self._exits: dict[str, dict[str, str]] = {}
        self._last_spin_s = time.monotonic()

    def begin_trial(self) -> None:
        """Forget earlier exits: from here on, the end of a process ends the trial."""
        # Processes that ended in between have been started again by now.
        self._exits.clear()

    def spin(self) -> None:
        """Run callbacks, have ended processes restarted, advance `now_s`; or stop.

        It waits 5 ms at most, and asks the supervisor to start ended processes again.

        Raises:
            StopRequested: If ROS shuts down or the supervisor is gone.
        """
        try:
            self._executor.spin_once(timeout_sec=_LONGEST_SPIN_S)
        except ExternalShutdownException:
            raise StopRequested from None
        if not self.node.context.ok():
            raise StopRequested

        self.poll()
        if self.supervisor is not None:
            # The supervisor sends nothing but the exits of processes.
            for event in self.supervisor.receive():
                name = event["name"]
                self._exits[name] = event
                self._on_exit(name)
                self.report("start", name=name)
            if self.supervisor.closed:
                raise StopRequested

        previous_s = self._last_spin_s
        self._last_spin_s = time.monotonic()
        self.now_s += min(_LONGEST_TURN_S, self._last_spin_s - previous_s)

    def require_alive(self, *processes: str) -> None:
        """Raise TrialEnded if one of the processes has ended since `begin_trial`."""
        for name in processes:
            if name in self._exits:
                event = self._exits[name]
                raise TrialEnded(
                    _OUTCOME_OF_END[name],
                    f"the {name} {event['how']}",
                    event["culprit"],
                )

    def wait(
        self, condition: Callable[[], T], limit_s: float, *processes: str
    ) -> T | None:
        """Spin until a condition is true; return its value, or None after the limit.

        Args:
            condition: Evaluated at each spin, until its value is true.
            limit_s: Longest wait, by `now_s`.
            *processes: Processes whose end ends the wait.

        Returns:
            The value of the condition, None after the limit.

        Raises:
            TrialEnded: If one of the processes ends.
        """
        deadline_s = self.now_s + limit_s
        while not (value := condition()):
            if self.now_s > deadline_s:
                return None
            self.spin()
            self.require_alive(*processes)
        return value

    def sleep(self, duration_s: float, *processes: str) -> None:
        """Spin for a time by `now_s`, unless the end of a process raises TrialEnded.

        Args:
            duration_s: How long, by `now_s`.
            *processes: Processes whose end raises TrialEnded.
        """
        self.wait(lambda: False, duration_s, *processes)

    def wait_for_missing(
        self,
        subject: str,
        describe_missing: Callable[[], str],
        limit_s: float,
        *processes: str,
    ) -> str:
        """Spin until nothing is missing or the limit is over; return what is missing.

        The user is told every 5 s what is waited for.

        Args:
            subject: Beginning of the note, such as "the planner: ".
            describe_missing: Returns what is missing, an empty string if nothing is.
            limit_s: Longest wait, by `now_s`.
            *processes: Processes whose end raises TrialEnded.

        Returns:
            What is still missing after the limit, empty if nothing is.
        """
        start_s = self.now_s
        last_note_s = start_s
        while (missing := describe_missing()) and self.now_s - start_s <= limit_s:
            if self.now_s > last_note_s + _NOTE_PERIOD_S:
                last_note_s = self.now_s
                self.note(f"waiting for {subject}{missing}")
            self.sleep(_CHECK_PERIOD_S, *processes)
        return missing

    def restart(self, process: str, limit_s: float) -> None:
        """Have the supervisor, if any, restart a process; wait for its end or limit.

        Args:
            process: "planner" or "simulator".
            limit_s: Longest wait for its end, by `now_s`.
        """
        # A process that has ended already is about to be started anyway.
        if self.supervisor is not None and process not in self._exits:
            self.supervisor.send("stop", name=process)
            self.wait(lambda: process in self._exits, limit_s)

    def report(self, event: str, **content: str) -> None:
        """Send an event to the supervisor, if there is one.

        Args:
            event: Name of the event, as `barn_eval.ros.supervision.process` lists them.
            **content: Fields of the event.
        """
        if self.supervisor is not None:
            self.supervisor.send(event, **content)

    def note(self, text: str) -> None:
        """Write a text to the node's log, and send it to the supervisor, if any."""
        self.node.get_logger().info(text)
        self.report("note", text=text)
