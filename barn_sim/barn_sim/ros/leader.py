"""Obeys the evaluator at the other end of a private line, and nobody else.

Requests are objects {"number": n, "do": NAME, ...}; the answer to each is
{"answer": n, "ok": BOOL, "text": TEXT}:
    introduce: the text is the identity (GID) of an endpoint of the node, in hexadecimal
    set_parameters, with "values": all of them or none, for the next reset; the text
        tells why they are not allowed
    pause, with "on"; reset: as the services of the node
{"heard": STAMP} tells up to which stamp of /clock, in ns, the evaluator has heard by
DDS, and {"heard": null} that it need not hear anything before the next reset; neither
has an answer.
Requests of others to the node are refused and reported as {"interference": TEXT}. What
the evaluator sets is no parameter of ROS: anybody could read there which world it is.
"""

import threading
from collections.abc import Callable
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
    ) -> None:
        """Listen to the line in a thread, and refuse changes of parameters.

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

    def _listen(self) -> None:
        """Receive from the line until it ends; queue requests in the executor."""
        while (request := self._line.receive(wait=True)) is not None:
            if isinstance(request, Reading):
                # An evaluator has no readings to send.
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
        """Carry out a request and send its answer over the line."""
        ok, text = self._answer(request)
        self._line.send(answer=request["number"], ok=ok, text=text)

    def _answer(self, request: dict[str, Any]) -> Answer:
        """Do introduce, pause, reset or set_parameters; return success and text."""
        match request["do"]:
            case "introduce":
                return True, self._identity
            case "pause":
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
