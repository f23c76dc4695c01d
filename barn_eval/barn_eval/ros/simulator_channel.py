"""The evaluator's end of the private line: what the simulator reads, and the simulator as a node that is led by it."""

import time
from collections import deque
from collections.abc import Callable, Mapping
from typing import Any

from barn_eval.ros.readiness import PARTICIPANT_BYTES
from barn_eval.ros.remote import ServiceRefused, ServiceTimeout
from barn_eval.ros.sequencer import Message
from barn_eval.ros.session import SIMULATOR, Session
from barn_worlds.ros.private_line import PrivateLine, Reading


class SimulatorChannel:
    """Readings, answers and reports of the simulator, which no other process can send.

    names: topics of readings after remapping, by the names that the simulator knows them by.
    participant: what the identities of the simulator's endpoints begin with, empty until it has introduced itself, and
    once it has ended.
    interference: what others have asked of the simulator in vain, since they were cleared.
    It can stand in for the `RemoteNode` of the simulator.
    """

    def __init__(self, session: Session, line: PrivateLine, names: Mapping[str, str]) -> None:
        self.participant = b""
        self.interference: list[str] = []
        self._session = session
        self._line = line
        self._names = names
        self._readings: deque[Message] = deque()
        self._ignored = False  # whether readings are dropped
        self._answers: dict[int, dict[str, Any]] = {}
        session.poll = self._drain

    def read(self, take: Callable[[Message], None]) -> None:
        """Hand over all readings that have arrived."""
        self._drain()
        while self._readings:
            take(self._readings.popleft())

    def tell(self, heard_ns: int) -> None:
        """Let the simulator know up to which stamp of /clock DDS has brought what it publishes."""
        self._line.send(heard=heard_ns)

    def ignore(self) -> None:
        """Drop what the simulator reads until its next reset, and have it go on without waiting to be heard."""
        self._ignored = True
        self._line.send(heard=None)

    def await_services(self, _names: tuple[str, ...], limit_s: float) -> None:
        """Wait until the simulator has introduced itself; ServiceTimeout if it has not within the limit."""
        self.participant = bytes.fromhex(self._ask("introduce", limit_s))[:PARTICIPANT_BYTES]

    def set_parameters(self, values: Mapping[str, Any], limit_s: float) -> None:
        """Set parameters, all of them or none; ServiceRefused with the simulator's reason, or ServiceTimeout."""
        self._ask("set_parameters", limit_s, values=dict(values))

    def switch(self, service: str, on: bool, limit_s: float) -> str:
        """Pause or resume and return what the simulator says; ServiceRefused, or ServiceTimeout."""
        return self._ask(service, limit_s, on=on)

    def trigger_once(self, service: str, limit_s: float) -> str:
        """Have something done and return what the simulator says; ServiceRefused, or ServiceTimeout."""
        self._ignored = self._ignored and service != "reset"
        return self._ask(service, limit_s)

    def _ask(self, what: str, limit_s: float, **content: object) -> str:
        number = time.monotonic_ns()  # an answer to an evaluator before this one is not taken for one to this
        self._line.send(number=number, do=what, **content)
        answer = self._session.wait(lambda: self._answers.pop(number, None), limit_s, SIMULATOR)
        if answer is None:
            raise ServiceTimeout(f"no answer from the simulator to {what} within {limit_s:g} s")
        if not answer["ok"]:
            raise ServiceRefused(answer["text"])
        return str(answer["text"])

    def _drain(self) -> None:
        while (packet := self._line.receive()) is not None:
            if isinstance(packet, Reading):
                if not self._ignored:
                    self._readings.append(Message(self._names[packet.topic], packet.data, packet.sent_ns))
            elif "answer" in packet:
                self._answers[packet["answer"]] = packet
            else:
                self.interference.append(packet["interference"])
