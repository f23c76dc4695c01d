"""Obeys the evaluator at the other end of a private line, and nobody else.

Requests are objects {"number": n, "do": NAME, ...}; the answer to each is
{"answer": n, "ok": BOOL, "text": TEXT}:
    introduce: the text is the identity (GID) of an endpoint of the node, in hexadecimal
    set_parameters, with "values": all of them or none, for the next reset; the text
        tells why they are not allowed
    pause, with "on"; reset: as the services of the node
{"heard": STAMP} tells up to which stamp of /clock, in ns, the evaluator has heard by
DDS, and {"heard": null} that it need not hear anything before the next reset; neither
has an answer. {"planner": PID} names the process, with its descendants, that the
planner runs in. {"answered": STAMP, "processor_ns": N} follows where a planner with a
rate of its own has answered the readings of that stamp, for which these processes have
computed so long; N is null if they are not known. {"tipped": TEXT} says that the robot
has tipped over.
Requests of others to the node are refused and reported as {"interference": TEXT}. What
the evaluator sets is no parameter of ROS: anybody could read there which world it is.
"""

import threading
import time
from collections.abc import Callable, Iterator
from contextlib import suppress
from pathlib import Path
from typing import Any

from rcl_interfaces.msg import SetParametersResult
from rclpy.executors import SingleThreadedExecutor
from rclpy.node import Node
from rclpy.parameter import Parameter

from barn_sim.config import RunConfig
from barn_worlds.base.config import replace_dotted
from barn_worlds.base.errors import BarnError
from barn_worlds.ros.private_line import PrivateLine, Reading
from barn_worlds.ros.topics import read_endpoint_identity

# Whether a request succeeded, and its result or why it failed.
Answer = tuple[bool, str]


class Leader:
    """Serves the requests of a line one after the other, in the node's executor."""

    config: RunConfig
    """Configuration for the next reset."""

    heard_ns: int | None
    """Up to which stamp the evaluator has heard; None while it need not."""

    is_awaited: bool
    """Whether the executor waits for the evaluator to hear more."""

    def __init__(
        self,
        node: Node,
        config: RunConfig,
        line: PrivateLine,
        executor: SingleThreadedExecutor,
        *,
        reset: Callable[[], Answer],
        pause: Callable[[bool], Answer],
    ):
        """Start a thread that listens to the line; refuse changes of parameters.

        Args:
            node: Node that is led.
            config: Configuration for the next reset, until the evaluator changes it.
            line: Private line to the evaluator.
            executor: Executor in which requests are served.
            reset: Resets the node.
            pause: Pauses or resumes the node.
        """
        self.config = config
        self.heard_ns = 0
        self.is_awaited = False
        self._planner_pid = 0
        self._planner_pids: list[int] = []
        self._reading_processor_ns = 0
        self._name: str = node.get_name()
        self._reset = reset
        self._pause = pause
        self._line = line
        self._executor = executor
        self._identity = read_endpoint_identity(node).hex()
        node.add_on_set_parameters_callback(self._refuse_parameters)
        threading.Thread(target=self._listen, daemon=True).start()

    def refuse(self, deed: str) -> str:
        """Report a stranger's request to the evaluator; return the refusal's text."""
        self._line.send(interference=deed)
        return "this simulator is led by an evaluator"

    def report_tip(self, text: str) -> None:
        """Tell the evaluator that the robot has tipped over."""
        self._line.send(tipped=text)

    def begin_reading(self) -> None:
        """Start measuring the planner's processor time for a reading."""
        self._reading_processor_ns = self._processor_time_ns()

    def report_answer(self, stamp_ns: int) -> None:
        """Send the evaluator an answered stamp and the processor time, if known."""
        computed_ns = None
        if self._planner_pids:
            computed_ns = self._processor_time_ns() - self._reading_processor_ns
            # The time of a process that has ended is missing.
            computed_ns = max(0, computed_ns)
        self._line.send(answered=stamp_ns, processor_ns=computed_ns)

    def is_planner_busy(self) -> bool:
        """Tell whether the main thread of a planner process runs or is ready to run."""
        for pid in self._planner_pids:
            with suppress(OSError):
                text = Path(f"/proc/{pid}/stat").read_text("utf-8", "replace")
                # The name before the state, in parentheses, may hold anything.
                if text.rpartition(")")[2].split()[0] == "R":
                    return True
        return False

    def _processor_time_ns(self) -> int:
        """Return the processor time in ns so far of the planner's living processes."""
        total_ns = 0
        for pid in self._planner_pids:
            with suppress(OSError):
                # On Linux, the identity of a process's clock follows from the PID.
                total_ns += time.clock_gettime_ns(~pid << 3 | 2)
        return total_ns

    def _listen(self) -> None:
        """Receive until the line ends: note planner and heard stamp; queue the rest."""
        while (request := self._line.receive(wait=True)) is not None:
            if isinstance(request, Reading):
                # An evaluator has no readings to send.
                continue
            if "planner" in request:
                self._planner_pid = request["planner"]
                continue
            if "heard" not in request:
                self._executor.create_task(self._serve, request)
                continue
            self.heard_ns = request["heard"]
            if self.is_awaited:
                # An empty task wakes the executor. It takes a turn as long as an
                # instant's messages do, so it is added only while somebody waits.
                self._executor.create_task(lambda: None)

    def _serve(self, request: dict[str, Any]) -> None:
        """Execute a request and send its answer over the line."""
        ok, text = self._answer(request)
        self._line.send(answer=request["number"], ok=ok, text=text)

    def _answer(self, request: dict[str, Any]) -> Answer:
        """Execute a request (such as "pause") and return success and an answer."""
        match request["do"]:
            case "introduce":
                return True, self._identity
            case "pause":
                # By the end of a pause all processes of the planner have started.
                if not request["on"] and self._planner_pid:
                    self._planner_pids = list(_family(self._planner_pid))
                return self._pause(request["on"])
            case "reset":
                self.heard_ns = 0
                return self._reset()
        try:
            self.config = replace_dotted(self.config, request["values"], "parameter")
        except BarnError as error:
            return False, str(error)
        return True, ""

    def _refuse_parameters(self, parameters: list[Parameter]) -> SetParametersResult:
        """Refuse any change of ROS parameters and report it as interference."""
        names = ", ".join(sorted(parameter.name for parameter in parameters))
        reason = self.refuse(f"set {names} of {self._name}")
        return SetParametersResult(successful=False, reason=reason)


def _family(pid: int) -> Iterator[int]:
    """Yield the PIDs of a process and of all its descendants."""
    yield pid
    for file in Path(f"/proc/{pid}/task").glob("*/children"):
        children: list[str] = []
        with suppress(OSError):
            children = file.read_text("ascii").split()
        for child in children:
            yield from _family(int(child))
