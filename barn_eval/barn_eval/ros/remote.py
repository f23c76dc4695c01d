"""Talking to another node by standard services: parameters, triggers, switches, states."""

import time
from collections.abc import Mapping, Sequence
from typing import Any

from lifecycle_msgs.srv import GetState
from rcl_interfaces.srv import GetParameters, SetParametersAtomically
from rclpy.client import Client
from rclpy.parameter import Parameter, parameter_value_to_python
from std_srvs.srv import SetBool, Trigger

from barn_eval.ros.graph import resolve_node_name
from barn_eval.ros.session import PLANNER, Session, TrialEnded
from barn_eval.trials.outcome import Outcome

SET_PARAMETERS = "set_parameters_atomically"
_AGAIN_S = 1.0  # between two equal calls while there is no answer
_SERVICE_LOOK_S = 0.005  # between two looks for services
_LOOK_S, _ANSWER_S = 0.25, 2.0  # between two rounds of questions to managed nodes, and for an answer to one


class ServiceTimeout(Exception):
    """A service did not answer in time, or is not there."""


class ServiceRefused(Exception):
    """A service answered that it does not do what was asked of it, for the reason given."""


class RemoteNode:
    """Another node by its full name. Clients are made once; `watched` is the process whose end ends any wait.

    A call that changes nothing when it is made twice is made again every second until it is answered: the service that
    the graph shows may be that of a process that was killed, whose successor is about to come.
    """

    def __init__(self, session: Session, name: str, watched: str) -> None:
        self.name = name
        self._session = session
        self._watched = watched
        self._clients: dict[str, Client] = {}

    def offers(self, service: str) -> bool:
        """Tell whether the node has a service, by its name under the node's, now."""
        wanted = f"{self.name}/{service}"
        return any(name == wanted for name, _ in self._session.node.get_service_names_and_types())

    def await_services(self, names: tuple[str, ...], limit_s: float) -> None:
        """Wait for services of the node; ServiceTimeout if one is not there within the limit."""

        def missing() -> str:
            return ", ".join(f"{self.name}/{name}" for name in names if not self.offers(name))

        if left := self._session.wait_for("the service ", missing, _SERVICE_LOOK_S, limit_s, self._watched):
            raise ServiceTimeout(f"no service {left} within {limit_s:g} s")

    def trigger_once(self, service: str, limit_s: float) -> str:
        """Do as `trigger`, for what changes something each time: without calling again."""
        return self.trigger(service, limit_s, limit_s)

    def trigger(self, service: str, limit_s: float, again_s: float = _AGAIN_S) -> str:
        """Call a Trigger and return its message; ServiceRefused with that message, or ServiceTimeout."""
        answer = self.call(service, Trigger, Trigger.Request(), limit_s, again_s)
        if not answer.success:
            raise ServiceRefused(answer.message)
        return str(answer.message)

    def switch(self, service: str, on: bool, limit_s: float) -> str:
        """Call a SetBool and return its message; ServiceRefused with that message, or ServiceTimeout."""
        answer = self.call(service, SetBool, SetBool.Request(data=on), limit_s)
        if not answer.success:
            raise ServiceRefused(answer.message)
        return str(answer.message)

    def set_parameters(self, values: Mapping[str, Any], limit_s: float) -> None:
        """Set parameters, all of them or none; ServiceRefused with the node's reason, or ServiceTimeout."""
        request = SetParametersAtomically.Request(
            parameters=[Parameter(name, value=value).to_parameter_msg() for name, value in values.items()]
        )
        answer = self.call(SET_PARAMETERS, SetParametersAtomically, request, limit_s)
        if not answer.result.successful:
            raise ServiceRefused(f"{self.name}: {answer.result.reason or 'parameters refused'}")

    def get_parameter(self, name: str, limit_s: float) -> object:
        """Return the value of a parameter, None if the node does not have it; ServiceTimeout."""
        answer = self.call("get_parameters", GetParameters, GetParameters.Request(names=[name]), limit_s)
        return parameter_value_to_python(answer.values[0]) if answer.values else None

    def call(self, service: str, kind: type[Any], request: object, limit_s: float, again_s: float = _AGAIN_S) -> Any:
        """Call a service of the node and return its answer, calling again every `again_s`; ServiceTimeout."""
        client = self._clients.get(service)
        if client is None:
            client = self._session.node.create_client(kind, f"{self.name}/{service}")
            self._clients[service] = client
        deadline = time.monotonic() + limit_s
        if not self._session.wait(client.service_is_ready, limit_s, self._watched):
            raise ServiceTimeout(f"no service {self.name}/{service} within {limit_s:g} s")
        while (left_s := deadline - time.monotonic()) > 0.0:
            answer = self._session.call(client, request, min(left_s, again_s), self._watched)
            if answer is not None:
                return answer
        raise ServiceTimeout(f"no answer from {self.name}/{service} within {limit_s:g} s")


class LifecycleNodes:
    """Managed (lifecycle) nodes of others, which are asked for their state before the first trial."""

    def __init__(self, session: Session, names: Sequence[str]) -> None:
        self._session = session
        self._nodes = [RemoteNode(session, resolve_node_name(session.node, name), PLANNER) for name in names]
        self._perhaps: RemoteNode | None = None

    def add(self, node: RemoteNode) -> None:
        """Wait for another node as well, from when it shows that it is managed: services are seen after their node."""
        if node.name not in {known.name for known in self._nodes}:
            self._perhaps = node

    def waiting_for(self) -> str:
        """Return which nodes are not active now, in words; TrialEnded if the planner's process ends meanwhile."""
        if self._perhaps is not None and self._perhaps.offers("get_state"):
            self._nodes.append(self._perhaps)
            self._perhaps = None
        return "; ".join(filter(None, map(_missing, self._nodes)))

    def await_active(self, limit_s: float) -> None:
        """Return once all nodes are active; TrialEnded, naming those that are not, after the limit."""
        if left := self._session.wait_for("managed nodes: ", self.waiting_for, _LOOK_S, limit_s, PLANNER):
            raise TrialEnded(Outcome.PLANNER_NOT_READY, f"{left} (waited {limit_s:g} s)")


def _missing(node: RemoteNode) -> str:
    if not node.offers("get_state"):
        return f"the lifecycle node {node.name} is not there"
    try:
        state = node.call("get_state", GetState, GetState.Request(), _ANSWER_S).current_state.label
    except ServiceTimeout:
        return f"the lifecycle node {node.name} does not answer"
    return "" if state == "active" else f"the lifecycle node {node.name} is {state or 'in no state'}"
