"""Talking to another node by standard services: parameters, triggers, switches, states."""

from collections.abc import Mapping, Sequence
from typing import Any

from lifecycle_msgs.srv import GetState
from rcl_interfaces.srv import GetParameters, SetParametersAtomically
from rclpy.client import Client
from rclpy.parameter import Parameter, parameter_value_to_python
from std_srvs.srv import SetBool, Trigger

from barn_eval.ros.session import Session

SET_PARAMETERS = "set_parameters_atomically"
_AGAIN_S = 1.0  # between two equal calls while there is no answer
_STATE_S = 2.0  # for a managed node to tell its state


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
        return any(name == wanted for name, _ in self._session.node.get_service_names_and_types())

    def await_services(self, names: Sequence[str], limit_s: float) -> None:
        """Wait for services of the node."""

        def missing() -> str:
            return ", ".join(f"{self.name}/{name}" for name in names if not self.offers(name))

        if left := self._session.wait_for("the service ", missing, limit_s, self._watched):
            raise ServiceTimeout(f"no service {left} within {limit_s:g} s")

    def trigger(self, service: str, limit_s: float, again_s: float = _AGAIN_S) -> str:
        """Call a Trigger and return its message; again_s: not less than the limit for what changes something."""
        return _granted(self.call(service, Trigger, Trigger.Request(), limit_s, again_s))

    def switch(self, service: str, on: bool, limit_s: float) -> str:
        """Call a SetBool and return its message."""
        return _granted(self.call(service, SetBool, SetBool.Request(data=on), limit_s))

    def set_parameters(self, values: Mapping[str, Any], limit_s: float) -> None:
        """Set parameters, all of them or none."""
        request = SetParametersAtomically.Request(
            parameters=[Parameter(name, value=value).to_parameter_msg() for name, value in values.items()]
        )
        answer = self.call(SET_PARAMETERS, SetParametersAtomically, request, limit_s)
        if not answer.result.successful:
            raise ServiceRefused(f"{self.name}: {answer.result.reason or 'parameters refused'}")

    def get_parameter(self, name: str, limit_s: float) -> object:
        """Return the value of a parameter, None if the node does not have it."""
        answer = self.call("get_parameters", GetParameters, GetParameters.Request(names=[name]), limit_s)
        return parameter_value_to_python(answer.values[0]) if answer.values else None

    def fault_of_state(self) -> str:
        """Return in words why a managed node is not active, an empty text if it is."""
        if not self.offers("get_state"):
            return f"the lifecycle node {self.name} is not there"
        try:
            state = self.call("get_state", GetState, GetState.Request(), _STATE_S).current_state.label
        except ServiceTimeout:
            return f"the lifecycle node {self.name} does not answer"
        return "" if state == "active" else f"the lifecycle node {self.name} is {state or 'in no state'}"

    def call(self, service: str, kind: type[Any], request: object, limit_s: float, again_s: float = _AGAIN_S) -> Any:
        """Call a service of the node and return its answer, calling again every `again_s`."""
        if service not in self._clients:
            self._clients[service] = self._session.node.create_client(kind, f"{self.name}/{service}")
        client, deadline_s = self._clients[service], self._session.now_s + limit_s
        if not self._session.wait(client.service_is_ready, limit_s, self._watched):
            raise ServiceTimeout(f"no service {self.name}/{service} within {limit_s:g} s")
        while (left_s := deadline_s - self._session.now_s) > 0.0:
            future = client.call_async(request)
            if self._session.wait(future.done, min(left_s, again_s), self._watched):
                return future.result()
            client.remove_pending_request(future)
        raise ServiceTimeout(f"no answer from {self.name}/{service} within {limit_s:g} s")


def _granted(answer: Any) -> str:
    if not answer.success:
        raise ServiceRefused(answer.message)
    return str(answer.message)
