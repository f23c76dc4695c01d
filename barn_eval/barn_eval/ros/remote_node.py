"""Services and parameters of another node, called with a limit."""

import hashlib
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field
from typing import Any

from lifecycle_msgs.srv import GetState
from rcl_interfaces.msg import ParameterValue
from rcl_interfaces.srv import GetParameters, ListParameters, SetParametersAtomically
from rclpy.client import Client
from rclpy.parameter import Parameter, parameter_value_to_python
from std_srvs.srv import SetBool, Trigger

from barn_eval.ros.evaluator_loop import EvaluatorLoop

SET_PARAMETERS = "set_parameters_atomically"
_CALL_PERIOD_S = 1.0  # between two equal calls while there is no answer
_STATE_LIMIT_S = 2.0  # for a managed node to tell its state
_MAX_PARAMETERS = 1000  # that are read of a node
_MAX_CHARACTERS = 100  # of a parameter's name and of the beginning of its value


class ServiceTimeout(Exception):
    """A service did not answer in time, or does not exist."""


class ServiceRefused(Exception):
    """A service refused what it was asked, with a reason."""


@dataclass
class RemoteNode:
    """Another node, called by its full name.

    A call that changes nothing when it is repeated is made every second until it is
    answered: the service on the graph may be that of a process that was killed, whose
    successor is about to come.
    """

    # Spends the time of waits.
    loop: EvaluatorLoop

    # Full name of the node.
    name: str

    # Supervised process whose end ends any wait for the node.
    process: str

    # Clients are made once for each service.
    _clients: dict[str, Client] = field(init=False, default_factory=dict)

    def offers(self, service: str) -> bool:
        """Return whether the graph has the service NODE/SERVICE now; do not wait."""
        # The graph is asked each time: a node may offer services late.
        services = self.loop.node.get_service_names_and_types()
        return f"{self.name}/{service}" in (name for name, _ in services)

    def await_services(self, services: Sequence[str], limit_s: float) -> None:
        """Wait until all named services of the node are there, or raise ServiceTimeout.

        Args:
            services: Names under the node's own.
            limit_s: Longest wait.

        Raises:
            ServiceTimeout: If one is still missing after the limit.
        """

        def describe_missing() -> str:
            """Return the full names of missing services, joined by commas."""
            missing = [name for name in services if not self.offers(name)]
            return ", ".join(f"{self.name}/{name}" for name in missing)

        missing = self.loop.wait_for_missing(
            "the services ", describe_missing, limit_s, self.process
        )
        if missing:
            raise ServiceTimeout(f"no service {missing} within {limit_s:g} s")

    def trigger(
        self, service: str, limit_s: float, call_period_s: float = _CALL_PERIOD_S
    ) -> str:
        """Call a Trigger service until it answers; return its message or raise.

        Args:
            service: Name under the node's own.
            limit_s: Longest wait for the answer.
            call_period_s: Time between two calls; at least the limit for a service
                that must not be called twice.

        Returns:
            The message of the answer.

        Raises:
            ServiceRefused: If the answer is no success.
            ServiceTimeout: If no answer comes.
        """
        answer = self.call(service, Trigger, Trigger.Request(), limit_s, call_period_s)
        return _require_success(answer)

    def switch(self, service: str, on: bool, limit_s: float) -> str:
        """Call a SetBool service until it answers; return its message or raise.

        Args:
            service: Name under the node's own.
            on: The value to set.
            limit_s: Longest wait for the answer.

        Returns:
            The message of the answer.

        Raises:
            ServiceRefused: If the answer is no success.
            ServiceTimeout: If no answer comes.
        """
        return _require_success(
            self.call(service, SetBool, SetBool.Request(data=on), limit_s)
        )

    def set_parameters(self, values: Mapping[str, Any], limit_s: float) -> None:
        """Set all parameters in one call, or none and raise ServiceRefused.

        Args:
            values: Values by the names of parameters.
            limit_s: Longest wait for the answer.

        Raises:
            ServiceRefused: If the node rejects a value.
            ServiceTimeout: If no answer comes.
        """
        parameters = [
            Parameter(name, value=value).to_parameter_msg()
            for name, value in values.items()
        ]
        request = SetParametersAtomically.Request(parameters=parameters)
        answer = self.call(SET_PARAMETERS, SetParametersAtomically, request, limit_s)
        if not answer.result.successful:
            reason = answer.result.reason or "parameters refused"
            raise ServiceRefused(reason)

    def read_parameters(self, limit_s: float) -> dict[str, str]:
        """Return up to 1000 parameters by name as text, cut; or ServiceTimeout."""
        request = ListParameters.Request()
        answer = self.call("list_parameters", ListParameters, request, limit_s)
        # In a fixed order, so that two starts of a node report alike.
        names = sorted(answer.result.names)[:_MAX_PARAMETERS]

        request = GetParameters.Request(names=names)
        answer = self.call("get_parameters", GetParameters, request, limit_s)

        # A node may answer with fewer values than it was asked for.
        values = zip(names, answer.values, strict=False)
        return {name[:_MAX_CHARACTERS]: _value_text(value) for name, value in values}

    def lifecycle_problem(self) -> str:
        """Return in words why the lifecycle node is not active, empty if it is."""
        subject = f"the lifecycle node {self.name}"
        if not self.offers("get_state"):
            return f"{subject} is not there"
        try:
            answer = self.call(
                "get_state", GetState, GetState.Request(), _STATE_LIMIT_S
            )
        except ServiceTimeout:
            return f"{subject} does not answer"

        state = answer.current_state.label
        if state == "active":
            return ""
        return f"{subject} is {state or 'in no state'}"

    def call(
        self,
        service: str,
        service_type: type[Any],
        request: object,
        limit_s: float,
        call_period_s: float = _CALL_PERIOD_S,
    ) -> Any:
        """Call a service until it answers; return that or raise ServiceTimeout.

        Args:
            service: Name under the node's own.
            service_type: Class of the service.
            request: Message to send.
            limit_s: Longest wait for service and answer.
            call_period_s: Time after which the call is made again.

        Returns:
            The response, a message of the service's type.

        Raises:
            ServiceTimeout: If the service does not exist or does not answer.
        """
        path = f"{self.name}/{service}"
        if service not in self._clients:
            self._clients[service] = self.loop.node.create_client(service_type, path)
        client = self._clients[service]

        deadline_s = self.loop.now_s + limit_s
        if not self.loop.wait(client.service_is_ready, limit_s, self.process):
            raise ServiceTimeout(f"no service {path} within {limit_s:g} s")

        while (remaining_s := deadline_s - self.loop.now_s) > 0.0:
            future = client.call_async(request)
            period_s = min(remaining_s, call_period_s)
            if self.loop.wait(future.done, period_s, self.process):
                return future.result()
            # Otherwise the client would keep the call forever.
            client.remove_pending_request(future)
        raise ServiceTimeout(f"no answer from {path} within {limit_s:g} s")

    def close(self) -> None:
        """Destroy the clients of the node's services: each makes every spin longer."""
        for client in self._clients.values():
            self.loop.node.destroy_client(client)
        self._clients.clear()


def _require_success(answer: Any) -> str:
    """Return the message of a Trigger or SetBool answer; ServiceRefused if failed."""
    if not answer.success:
        raise ServiceRefused(answer.message)
    return str(answer.message)


def _value_text(value: ParameterValue) -> str:
    """Return a parameter's value as text; if over 100 characters, cut, with SHA-256."""
    text = str(parameter_value_to_python(value))
    if len(text) <= _MAX_CHARACTERS:
        return text
    digest = hashlib.sha256(text.encode("utf-8", "replace")).hexdigest()
    return f"{text[:_MAX_CHARACTERS]}... (sha256 {digest})"
