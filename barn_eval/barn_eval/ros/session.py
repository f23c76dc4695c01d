"""The evaluator's session: its executor, the channel to the supervisor, and calls of other nodes' services."""

import hashlib
import time
from collections.abc import Callable, Mapping, Sequence
from typing import Any, TypeVar

from lifecycle_msgs.srv import GetState
from rcl_interfaces.msg import ParameterValue
from rcl_interfaces.srv import GetParameters, ListParameters, SetParametersAtomically
from rclpy.client import Client
from rclpy.executors import ExternalShutdownException, SingleThreadedExecutor
from rclpy.node import Node
from rclpy.parameter import Parameter, parameter_value_to_python
from std_srvs.srv import SetBool, Trigger

from barn_eval.ros.supervision.process import EventChannel
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
        self.outcome, self.detail, self.culprit = outcome, detail, blamed


class Abandoned(Exception):
    """Whoever started the evaluator wants it to end."""


class Session:
    """Runs the node's callbacks while waiting; the only place where the evaluator spends time.

    on_exit: called with the name of a supervised process that has ended, before it is started afresh. poll: called at
    each spin. now_s: the time by which all limits count. It stands still while this process is suspended, and hardly
    passes while it waits for a processor, so that no limit is exceeded only because the machine has other work.
    """

    def __init__(
        self,
        node: Node,
        supervisor: EventChannel | None,
        on_exit: Callable[[str], None],
    ) -> None:
        self.node = node
        self.supervisor = supervisor
        self.poll: Callable[[], None] = lambda: None
        self._on_exit = on_exit
        self._executor = SingleThreadedExecutor(context=node.context)
        self._executor.add_node(node)
        self._ends: dict[str, dict[str, str]] = {}
        self.now_s, self._spun_s = 0.0, time.monotonic()

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
        for end in (
            self.supervisor.receive() if self.supervisor is not None else ()
        ):  # nothing else is sent
            self._ends[end["name"]] = end
            self._on_exit(end["name"])
            self.tell("start", name=end["name"])
        if self.supervisor is not None and self.supervisor.closed:
            raise Abandoned
        before_s, self._spun_s = self._spun_s, time.monotonic()
        self.now_s += min(_TURN_S, self._spun_s - before_s)

    def check(self, *names: str) -> None:
        """Raise TrialEnded if one of the supervised processes has ended since the trial began."""
        for name in names:
            if end := self._ends.get(name):
                raise TrialEnded(_DIED[name], f"the {name} {end['how']}", end["blamed"])

    def wait(
        self, condition: Callable[[], T], limit_s: float, *watched: str
    ) -> T | None:
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

    def wait_for(
        self, what: str, missing: Callable[[], str], limit_s: float, *watched: str
    ) -> str:
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


SET_PARAMETERS = "set_parameters_atomically"
_AGAIN_S = 1.0  # between two equal calls while there is no answer
_STATE_S = 2.0  # for a managed node to tell its state
_MOST_PARAMETERS, _MOST_TEXT = (
    1000,
    100,
)  # of a node; characters of a name, and of the beginning of a value


class ServiceTimeout(Exception):
    """A service did not answer in time, or is not there."""


class ServiceRefused(Exception):
    """A service answered that it does not do what was asked of it, for the reason given."""


class RemoteNode:
    """Another node by its full name. Clients are made once; `watched` is the process whose end ends any wait.

    All calls raise ServiceTimeout or, with the node's reason, ServiceRefused. One that changes nothing when made twice
    is made again every second until it is answered: the service that the graph shows may be that of a process that was
    killed, whose successor is about to come.
    """

    def __init__(self, session: Session, name: str, watched: str) -> None:
        self.name = name
        self._session, self._watched = session, watched
        self._clients: dict[str, Client] = {}

    def offers(self, service: str) -> bool:
        """Tell whether the node has a service, by its name under the node's, now."""
        wanted = f"{self.name}/{service}"
        return any(
            name == wanted
            for name, _ in self._session.node.get_service_names_and_types()
        )

    def await_services(self, names: Sequence[str], limit_s: float) -> None:
        """Wait for services of the node."""

        def missing() -> str:
            return ", ".join(
                f"{self.name}/{name}" for name in names if not self.offers(name)
            )

        if left := self._session.wait_for(
            "the service ", missing, limit_s, self._watched
        ):
            raise ServiceTimeout(f"no service {left} within {limit_s:g} s")

    def trigger(self, service: str, limit_s: float, again_s: float = _AGAIN_S) -> str:
        """Call a Trigger and return its message; again_s: not less than the limit for what changes something."""
        return self._granted(
            self.call(service, Trigger, Trigger.Request(), limit_s, again_s)
        )

    def switch(self, service: str, on: bool, limit_s: float) -> str:
        """Call a SetBool and return its message."""
        return self._granted(
            self.call(service, SetBool, SetBool.Request(data=on), limit_s)
        )

    def set_parameters(self, values: Mapping[str, Any], limit_s: float) -> None:
        """Set parameters, all of them or none."""
        given = [
            Parameter(name, value=value).to_parameter_msg()
            for name, value in values.items()
        ]
        request = SetParametersAtomically.Request(parameters=given)
        result = self.call(
            SET_PARAMETERS, SetParametersAtomically, request, limit_s
        ).result
        if not result.successful:
            raise ServiceRefused(
                f"{self.name}: {result.reason or 'parameters refused'}"
            )

    def parameters(self, limit_s: float) -> dict[str, str]:
        """Return its first 1,000 parameters as texts; of a long one the beginning and the SHA-256."""
        listed = self.call(
            "list_parameters", ListParameters, ListParameters.Request(), limit_s
        ).result.names
        names = sorted(listed)[:_MOST_PARAMETERS]
        values = self.call(
            "get_parameters", GetParameters, GetParameters.Request(names=names), limit_s
        ).values
        return {
            name[:_MOST_TEXT]: _text(value)
            for name, value in zip(names, values, strict=False)
        }

    def fault_of_state(self) -> str:
        """Return in words why a managed node is not active, an empty text if it is."""
        if not self.offers("get_state"):
            return f"the lifecycle node {self.name} is not there"
        try:
            state = self.call(
                "get_state", GetState, GetState.Request(), _STATE_S
            ).current_state.label
        except ServiceTimeout:
            return f"the lifecycle node {self.name} does not answer"
        return (
            ""
            if state == "active"
            else f"the lifecycle node {self.name} is {state or 'in no state'}"
        )

    def call(
        self,
        service: str,
        kind: type[Any],
        request: object,
        limit_s: float,
        again_s: float = _AGAIN_S,
    ) -> Any:
        """Call a service of the node and return its answer, calling again every `again_s`."""
        if service not in self._clients:
            self._clients[service] = self._session.node.create_client(
                kind, f"{self.name}/{service}"
            )
        client, deadline_s = self._clients[service], self._session.now_s + limit_s
        if not self._session.wait(client.service_is_ready, limit_s, self._watched):
            raise ServiceTimeout(
                f"no service {self.name}/{service} within {limit_s:g} s"
            )
        while (left_s := deadline_s - self._session.now_s) > 0.0:
            future = client.call_async(request)
            if self._session.wait(future.done, min(left_s, again_s), self._watched):
                return future.result()
            client.remove_pending_request(future)
        raise ServiceTimeout(
            f"no answer from {self.name}/{service} within {limit_s:g} s"
        )

    def close(self) -> None:
        """Do without its clients from now on: each makes every spin longer."""
        while self._clients:
            self._session.node.destroy_client(self._clients.popitem()[1])

    @staticmethod
    def _granted(answer: Any) -> str:
        if not answer.success:
            raise ServiceRefused(answer.message)
        return str(answer.message)


def _text(value: ParameterValue) -> str:
    text = str(parameter_value_to_python(value))
    digest = hashlib.sha256(text.encode("utf-8", "replace")).hexdigest()
    return (
        text if len(text) <= _MOST_TEXT else f"{text[:_MOST_TEXT]}... (sha256 {digest})"
    )
