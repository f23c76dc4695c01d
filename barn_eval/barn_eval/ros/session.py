"""The evaluator's session: its executor, the channel to the supervisor, and what it knows of the other processes."""

import time
from collections.abc import Callable
from typing import TypeVar

from rclpy.executors import ExternalShutdownException, SingleThreadedExecutor
from rclpy.node import Node

from barn_eval.ros.supervision.channel import EventChannel
from barn_eval.trials.outcome import Outcome

T = TypeVar("T")

PLANNER, SIMULATOR = "planner", "simulator"
_DIED = {PLANNER: Outcome.PLANNER_DIED, SIMULATOR: Outcome.SIMULATOR_DIED}
_SPIN_S = 0.005  # longest time between two looks at conditions
_LOOK_S = 0.05  # between two looks at what is missing
_TELL_S = 5.0  # between two notes on what is waited for
_TURN_S = 0.02  # most that counts of the time between two spins


class TrialEnded(Exception):
    """Something happened that ends the trial with an outcome of its own; `blamed` as in `Verdict`."""

    def __init__(self, outcome: Outcome, detail: str, blamed: str = "") -> None:
        super().__init__(f"{outcome.value}: {detail}")
        self.outcome, self.detail, self.blamed = outcome, detail, blamed


class Abandoned(Exception):
    """Whoever started the evaluator wants it to end."""


class Session:
    """Runs the node's callbacks while waiting; the only place where the evaluator spends time.

    on_exit: called with the name of a supervised process that has ended, before it is started afresh. poll: called at
    each spin. now_s: the time by which all limits count. It stands still while this process is suspended, and hardly
    passes while it waits for a processor, so that no limit is exceeded only because the machine has other work.
    """

    def __init__(self, node: Node, supervisor: EventChannel | None, on_exit: Callable[[str], None]) -> None:
        self.node = node
        self.supervisor = supervisor
        self.poll: Callable[[], None] = lambda: None
        self._on_exit = on_exit
        self._executor = SingleThreadedExecutor(context=node.context)
        self._executor.add_node(node)
        self._ends: dict[str, dict[str, str]] = {}
        self.now_s = 0.0
        self._spun_s = time.monotonic()

    def begin_trial(self) -> None:
        """Forget what ended before: from here on, the end of a process is the end of the trial."""
        self._ends.clear()

    def spin(self) -> None:
        """Run what callbacks are due, waiting for the first one for a moment."""
        try:
            self._executor.spin_once(timeout_sec=_SPIN_S)
        except ExternalShutdownException:
            raise Abandoned from None
        if not self.node.context.ok():
            raise Abandoned
        self.poll()
        self._listen()
        before_s, self._spun_s = self._spun_s, time.monotonic()
        self.now_s += min(_TURN_S, self._spun_s - before_s)

    def _listen(self) -> None:
        if self.supervisor is None:
            return
        for end in self.supervisor.receive():  # nothing else is sent
            self._ends[end["name"]] = end
            self._on_exit(end["name"])
            self.tell("start", name=end["name"])
        if self.supervisor.closed:
            raise Abandoned

    def check(self, *names: str) -> None:
        """Raise TrialEnded if one of the supervised processes has ended since the trial began."""
        for name in names:
            if end := self._ends.get(name):
                raise TrialEnded(_DIED[name], f"the {name} {end['how']}", end["blamed"])

    def wait(self, condition: Callable[[], T], limit_s: float, *watched: str) -> T | None:
        """Wait for a condition to hold and return its value, None after the limit; TrialEnded as `check` has it."""
        deadline_s = self.now_s + limit_s
        while not (value := condition()):
            if self.now_s > deadline_s:
                return None
            self.spin()
            self.check(*watched)
        return value

    def sleep(self, limit_s: float, *watched: str) -> None:
        """Let time pass; TrialEnded as `check` has it."""
        self.wait(lambda: False, limit_s, *watched)

    def wait_for(self, what: str, missing: Callable[[], str], limit_s: float, *watched: str) -> str:
        """Wait until nothing is `missing`, telling the user every 5 s; return what still is after the limit."""
        began_s = told_s = self.now_s
        while (text := missing()) and self.now_s - began_s <= limit_s:
            if self.now_s > told_s + _TELL_S:
                told_s = self.now_s
                self.note(f"waiting for {what}{text}")
            self.sleep(_LOOK_S, *watched)
        return text

    def restart(self, name: str, limit_s: float) -> None:
        """Have the supervisor end a process that has not ended by itself; it comes back as one that did would."""
        if self.supervisor is not None and name not in self._ends:
            self.supervisor.send("stop", name=name)
            self.wait(lambda: name in self._ends, limit_s)

    def tell(self, event: str, **content: str) -> None:
        """Tell the supervisor something, if there is one."""
        if self.supervisor is not None:
            self.supervisor.send(event, **content)

    def note(self, text: str) -> None:
        """Let the user know something, in the log and through the supervisor."""
        self.node.get_logger().info(text)
        self.tell("note", text=text)
