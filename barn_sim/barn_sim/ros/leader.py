"""Leads the simulator node for the evaluator at the other end of a private line, and for nobody else.

Requests are objects {"number": n, "do": NAME, ...} and are answered by {"answer": n, "ok": BOOL, "text": TEXT}:
    introduce: the text is the identity (GID) of an endpoint of the node, in hexadecimal
    set_parameters, with "values": all of them or none, for the next reset; the text says why not
    pause, with "on"; reset: as the services of the node
{"heard": STAMP} says up to which stamp of /clock, in ns, the evaluator has heard by DDS, {"heard": null} that it need
not hear anything before the next reset; neither is answered.
What others ask of the node is refused and reported as {"interference": TEXT}. What the evaluator sets is no parameter
of ROS: anybody could read there which world it is.
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

Done = tuple[bool, str]  # whether, and why not


class Leader:
    """Serves the requests of a line in the executor of the node, one after the other.

    reset, pause: what it has the node do. config: for the next reset. heard_ns: how far the evaluator has heard, None
    while it need not; awaited: whether the executor waits for that.
    """

    def __init__(
        self,
        node: Node,
        config: RunConfig,
        line: PrivateLine,
        executor: SingleThreadedExecutor,
        *,
        reset: Callable[[], Done],
        pause: Callable[[bool], Done],
    ) -> None:
        self.config = config
        self.heard_ns: int | None = 0
        self.awaited = False
        self._name: str = node.get_name()
        self._reset, self._pause = reset, pause
        self._line, self._executor = line, executor
        self._identity = read_endpoint_identity(node).hex()
        node.add_on_set_parameters_callback(self._judge_change)
        threading.Thread(target=self._listen, daemon=True).start()

    def refuse(self, deed: str) -> str:
        """Report what somebody else has asked for, and return the reason why it is not done."""
        self._line.send(interference=deed)
        return "this simulator is led by an evaluator"

    def _listen(self) -> None:
        while (request := self._line.receive(wait=True)) is not None:
            if isinstance(request, Reading):
                continue  # an evaluator has none to send
            if "heard" not in request:
                self._executor.create_task(self._serve, request)
                continue
            self.heard_ns = request["heard"]
            if self.awaited:  # a task is a turn of the executor, which takes as long as an instant's messages
                self._executor.create_task(lambda: None)

    def _serve(self, request: dict[str, Any]) -> None:
        ok, text = self._do(request["do"], request)
        self._line.send(answer=request["number"], ok=ok, text=text)

    def _do(self, what: str, request: dict[str, Any]) -> Done:
        if what == "introduce":
            return True, self._identity
        if what == "pause":
            return self._pause(request["on"])
        if what == "reset":
            self.heard_ns = 0
            return self._reset()
        try:
            self.config = replace_dotted(self.config, request["values"], "parameter")
        except BarnError as error:
            return False, str(error)
        return True, ""

    def _judge_change(self, parameters: list[Parameter]) -> SetParametersResult:
        names = ", ".join(sorted(parameter.name for parameter in parameters))
        return SetParametersResult(
            successful=False, reason=self.refuse(f"set {names} of {self._name}")
        )
