"""The simulator as the evaluator leads it: by its private line, or by its services where it was started by hand."""

import re
import time
from collections import deque
from collections.abc import Callable, Mapping
from pathlib import Path
from typing import Any

from barn_eval.ros.readiness import PARTICIPANT_BYTES
from barn_eval.ros.sequencer import Message
from barn_eval.ros.session import (
    PLANNER,
    SET_PARAMETERS,
    SIMULATOR,
    RemoteNode,
    ServiceRefused,
    ServiceTimeout,
    Session,
    TrialEnded,
)
from barn_eval.trials.outcome import Outcome
from barn_eval.trials.ros_config import WaitLimits
from barn_eval.trials.spec import TrialSpec
from barn_worlds.base.config import fields_of
from barn_worlds.base.errors import BarnError
from barn_worlds.ros.private_line import PrivateLine, Reading

_CONNECTED = re.compile(r"(\d+) scan subscriptions, (\d+) command publishers")
_LOOK_S = 0.02
_MISSED = re.compile(r"(\d+) missed commands")


class SimulatorChannel:
    """The evaluator's end of the private line: readings and answers of the simulator, which nobody else can send.

    names: topics of readings after remapping, by the names that the simulator knows them by.
    """

    def __init__(
        self, session: Session, line: PrivateLine, names: Mapping[str, str]
    ) -> None:
        self.participant = b""  # what the identities of the simulator's endpoints begin with, once known
        self.interference: list[
            str
        ] = []  # what others have asked of the simulator in vain
        self._session, self._line, self._names = session, line, names
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

    def ask(self, what: str, limit_s: float, **content: object) -> str:
        """Make a request of `barn_sim.ros.leader` and return the answer; ServiceRefused, or ServiceTimeout."""
        self._ignored = self._ignored and what != "reset"
        number = (
            time.monotonic_ns()
        )  # an answer to an evaluator before this one is not taken for one to this
        self._line.send(number=number, do=what, **content)
        answer = self._session.wait(
            lambda: self._answers.pop(number, None), limit_s, SIMULATOR
        )
        if answer is None:
            raise ServiceTimeout(
                f"no answer from the simulator to {what} within {limit_s:g} s"
            )
        if not answer["ok"]:
            raise ServiceRefused(answer["text"])
        if what == "introduce":
            self.participant = bytes.fromhex(answer["text"])[:PARTICIPANT_BYTES]
        return str(answer["text"])

    def _drain(self) -> None:
        while (packet := self._line.receive()) is not None:
            if isinstance(packet, Reading):
                if not self._ignored:
                    self._readings.append(
                        Message(self._names[packet.topic], packet.data, packet.sent_ns)
                    )
            elif "answer" in packet:
                self._answers[packet["answer"]] = packet
            else:
                self.interference.append(packet["interference"])


class SimulatorServices(RemoteNode):
    """The services of a simulator that was started by hand, as if they were a `SimulatorChannel`."""

    def ask(
        self,
        what: str,
        limit_s: float,
        *,
        values: Mapping[str, Any] | None = None,
        on: bool = False,
    ) -> str:
        """Do as `SimulatorChannel.ask`."""
        if what == "introduce":
            self.await_services((SET_PARAMETERS, "reset", "pause"), limit_s)
        elif what == "set_parameters":
            self.set_parameters(values or {}, limit_s)
        elif what == "pause":
            return self.switch("pause", on, limit_s)
        return (
            self.trigger("reset", limit_s, again_s=limit_s) if what == "reset" else ""
        )


class SimulatorClient:
    """Sets up, resets, pauses and releases the simulator, which it asks by `request`, as `SimulatorChannel.ask` does.

    dataset, robot: names, or paths, of what all trials are of. Raises TrialEnded if the simulator does not answer and
    BarnError if it cannot do what the trial needs.
    """

    def __init__(
        self,
        session: Session,
        request: Callable[..., str],
        patience: WaitLimits,
        dataset: str,
        robot: str,
    ) -> None:
        self._session, self._request, self._patience = session, request, patience
        self._given = {
            "robot": robot,
            "dataset": str(Path(dataset).resolve())
            if Path(dataset).exists()
            else dataset,
        }

    def prepare(self, spec: TrialSpec, start_limit_s: float) -> int:
        """Put the robot of a trial in its place, paused, and return the wall-clock time before that was asked for."""
        limit_s, start = self._patience.simulator_s, spec.course.start
        values = {
            name: value for name, _, value in fields_of(spec.simulator)
        } | self._given
        values |= {
            f"compute.{name}": value for name, _, value in fields_of(spec.compute)
        }
        values |= {
            "world": spec.world_number,
            "seed": spec.simulator_seed,
            "compute_seed": spec.planner_seed,
        }
        values |= {
            "start_x_m": start.x,
            "start_y_m": start.y,
            "start_yaw_rad": start.yaw,
        }
        self._ask("introduce", start_limit_s)
        self._ask("pause", limit_s, on=True)
        self._ask("set_parameters", limit_s, values=values)
        asked_ns = time.time_ns()
        self._ask("reset", limit_s)
        return asked_ns

    def await_connections(
        self, scan_subscriptions: int, command_publishers: int
    ) -> bool:
        """Wait until the simulator is connected with as many others; False if it is not within the limit."""
        # what is on the graph need not be connected yet, and the first scan of a trial must not be lost
        deadline_s = self._session.now_s + self._patience.connection_s
        while connected := _CONNECTED.search(
            self._pause(True)
        ):  # None of a simulator that does not say
            if (
                int(connected[1]) >= scan_subscriptions
                and int(connected[2]) >= command_publishers
            ):
                return True
            if self._session.now_s > deadline_s:
                return False
            self._session.sleep(_LOOK_S, PLANNER, SIMULATOR)
        return True

    def release(self) -> None:
        """Let the simulated time run."""
        self._pause(False)

    def pause(self) -> int:
        """Stop the simulated time and return in how many cycles the simulator has waited in vain for a command."""
        missed = _MISSED.search(self._pause(True))
        return int(missed[1]) if missed else 0

    def _pause(self, on: bool) -> str:
        return self._ask("pause", self._patience.service_s, on=on)

    def _ask(self, what: str, limit_s: float, **content: object) -> str:
        try:
            return self._request(what, limit_s, **content)
        except ServiceTimeout as error:
            raise TrialEnded(Outcome.SIMULATOR_DIED, str(error)) from None
        except ServiceRefused as error:
            raise BarnError(f"simulator: {error}") from None
