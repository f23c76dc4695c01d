"""The simulator as the evaluator leads it: by the private line or by services."""

import json
import math
import time
from collections import deque
from collections.abc import Callable, Mapping
from contextlib import suppress
from pathlib import Path
from typing import Any

from barn_eval.ros.evaluator_loop import EvaluatorLoop, TrialEnded
from barn_eval.ros.readiness import PARTICIPANT_BYTES
from barn_eval.ros.remote_node import (
    SET_PARAMETERS,
    RemoteNode,
    ServiceRefused,
    ServiceTimeout,
)
from barn_eval.ros.sequencer import Message
from barn_eval.trials.result import PLANNER, SIMULATOR, Outcome
from barn_eval.trials.ros_config import EvaluatorConfig
from barn_eval.trials.spec import TrialSpec
from barn_worlds.base.config import fields_of
from barn_worlds.base.errors import BarnError
from barn_worlds.base.types import seconds
from barn_worlds.ros.private_line import PrivateLine, Reading

_CHECK_PERIOD_S = 0.02  # between two looks at the simulator's connections
_STATUS_VERSION = 1


class SimulatorChannel:
    """The evaluator's end of the private line to the simulator.

    `barn_sim.ros.leader` is at the other end and documents the messages. Nobody but
    the simulator can send on it.
    """

    def __init__(
        self, loop: EvaluatorLoop, line: PrivateLine, topic_names: Mapping[str, str]
    ):
        """Take over the line: from now on every spin of the loop reads it.

        Args:
            loop: Spends the time of waits.
            line: Private line to the simulator.
            topic_names: Resolved names of the readings' topics, by the names that the
                simulator uses.
        """
        # Beginning of the identities of the simulator's endpoints, once known.
        self.participant = b""
        # Requests of other nodes that the simulator refused.
        self.interference: list[str] = []
        # How the robot has tipped over since the reset, if it has.
        self.tip = ""
        # Since the reset, of a planner with a rate of its own: stamps of the readings
        # that it has answered, and what its processes have computed for each.
        self.answered_ns: set[int] = set()
        self.processor_times_s: list[float] = []
        self._loop = loop
        self._line = line
        self._topic_names = topic_names
        self._readings: deque[Message] = deque()
        self._drops_readings = False
        self._answers: dict[int, dict[str, Any]] = {}
        loop.poll = self._receive

    def read(self, take: Callable[[Message], None]) -> None:
        """Hand all readings that have arrived to `take`, oldest first, once each."""
        self._receive()
        while self._readings:
            take(self._readings.popleft())

    def acknowledge(self, stamp_ns: int) -> None:
        """Tell the simulator up to which simulated time (ns) DDS has brought topics."""
        self._line.send(heard=stamp_ns)

    def ignore(self) -> None:
        """Drop readings until a reset; have the simulator await no acknowledgment."""
        self._drops_readings = True
        self._line.send(heard=None)

    def ask(self, action: str, limit_s: float, **content: object) -> str:
        """Send a request; return the answer's text or raise. "reset" clears old data.

        An answer to "introduce" also sets `participant`.

        Args:
            action: "introduce", "set_parameters", "pause" or "reset".
            limit_s: Longest wait for the answer.
            **content: Fields of the request.

        Returns:
            The text of the answer.

        Raises:
            ServiceRefused: If the simulator does not do it.
            ServiceTimeout: If no answer comes.
        """
        if action == "reset":
            # Before the request, since the first readings of a trial come before the
            # answer to it.
            self._drops_readings = False
            self.tip = ""
            self.answered_ns.clear()
            self.processor_times_s.clear()

        # A number from the clock tells answers to an earlier evaluator apart.
        number = time.monotonic_ns()
        self._line.send(number=number, do=action, **content)
        answer = self._loop.wait(
            lambda: self._answers.pop(number, None), limit_s, SIMULATOR
        )
        if answer is None:
            raise ServiceTimeout(
                f"no answer from the simulator to {action} within {limit_s:g} s"
            )
        if not answer["ok"]:
            raise ServiceRefused(answer["text"])

        if action == "introduce":
            self.participant = bytes.fromhex(answer["text"])[:PARTICIPANT_BYTES]
        return str(answer["text"])

    def _receive(self) -> None:
        """Store whatever has come on the line where its reader looks; do not wait."""
        while (packet := self._line.receive()) is not None:
            match packet:
                case Reading(topic, data, sent_ns):
                    if not self._drops_readings:
                        name = self._topic_names[topic]
                        self._readings.append(Message(name, data, sent_ns))
                case {"answer": number}:
                    self._answers[number] = packet
                case {"tipped": text}:
                    self.tip = text
                case {"answered": stamp_ns, "processor_ns": processor_ns}:
                    self.answered_ns.add(stamp_ns)
                    if processor_ns is not None:
                        self.processor_times_s.append(seconds(processor_ns))
                case {"interference": text}:
                    self.interference.append(text)


class SimulatorServices(RemoteNode):
    """The services of a simulator that was started by hand, in place of a channel."""

    def ask(
        self,
        action: str,
        limit_s: float,
        *,
        values: Mapping[str, Any] | None = None,
        on: bool = False,
    ) -> str:
        """Act by ROS services; return the text of pause or reset, else ""; or raise.

        Args:
            action: "introduce", "set_parameters", "pause" or "reset".
            limit_s: Longest wait for the answer.
            values: Parameters, for "set_parameters".
            on: Whether time stops, for "pause".

        Returns:
            The message of the answer to "pause" or "reset", otherwise empty.

        Raises:
            ServiceRefused: If the simulator does not do it.
            ServiceTimeout: If no answer comes.
        """
        # Calls that may be repeated are repeated; a reset must not be, because it begins
        # a trial.
        if action == "pause":
            return self.switch("pause", on, limit_s)
        if action == "reset":
            return self.trigger("reset", limit_s, call_period_s=limit_s)
        if action == "introduce":
            self.await_services((SET_PARAMETERS, "reset", "pause"), limit_s)
        else:
            self.set_parameters(values or {}, limit_s)
        return ""


class SimulatorClient:
    """Sets up, resets, pauses and releases the simulator.

    All methods raise TrialEnded if it does not answer, and BarnError if it refuses.
    """

    def __init__(
        self, loop: EvaluatorLoop, request: Callable[..., str], config: EvaluatorConfig
    ):
        """Prepare requests; ask the simulator for nothing yet.

        Args:
            loop: Spends the time of waits.
            request: Asks the simulator, as `SimulatorChannel.ask` does.
            config: Limits of waits, and robot and data set of all trials.
        """
        self._loop = loop
        self._request = request
        self._patience = config.patience
        self._robot = config.robot
        # The simulator may run in another working directory.
        dataset = Path(config.dataset)
        self._dataset = str(dataset.resolve() if dataset.exists() else dataset)

    def prepare(self, spec: TrialSpec, start_limit_s: float) -> int:
        """Pause, set up and reset the simulator; return wall-clock ns before the reset.

        Args:
            spec: The trial.
            start_limit_s: Longest wait for the simulator to be there.

        Returns:
            Wall-clock time in ns just before the reset was requested.
        """
        # The simulator has the world only: where the robot begins follows from the
        # protocol.
        start = spec.course.start
        values: dict[str, Any] = {
            name: value for name, _, value in fields_of(spec.simulator)
        }
        for name, _, value in fields_of(spec.compute):
            values[f"compute.{name}"] = value
        values |= {
            "robot": self._robot,
            "dataset": self._dataset,
            "world": spec.world_number,
            "seed": spec.simulator_seed,
            "compute_seed": spec.planner_seed,
            "start_x_m": start.x,
            "start_y_m": start.y,
            "start_yaw_rad": start.yaw,
        }

        limit_s = self._patience.simulator_s
        self._ask("introduce", start_limit_s)
        # Time stops first, so that none passes between the reset and the release.
        if not _read_status(self._ask("pause", limit_s, on=True)):
            raise BarnError(
                "simulator: its ~/pause does not answer like the suite's simulator; describe"
                " yours in a file, for barn run --system or the parameter system"
            )
        self._ask("set_parameters", limit_s, values=values)
        # Messages that were sent before this time are not of the trial.
        reset_ns = time.time_ns()
        self._ask("reset", limit_s)
        return reset_ns

    def await_connections(
        self, scan_subscriptions: int, command_publishers: int
    ) -> bool:
        """Pause and wait for connections; False after the limit, True if unknown.

        An endpoint on the graph need not be connected yet, and the first scan of a
        trial must not be lost.

        Args:
            scan_subscriptions: Number of subscriptions to the scan on the graph.
            command_publishers: Number of publishers of commands on the graph.

        Returns:
            False if the connections are not there within the limit; True for a
            simulator that does not tell its connections.
        """
        deadline_s = self._loop.now_s + self._patience.connection_s
        while True:
            # To pause once more changes nothing, and the answer tells the connections.
            status = self.pause()
            scans = status.get("scan_subscriptions", math.inf)
            commands = status.get("command_publishers", math.inf)
            if scans >= scan_subscriptions and commands >= command_publishers:
                return True
            if self._loop.now_s > deadline_s:
                return False
            self._loop.sleep(_CHECK_PERIOD_S, PLANNER, SIMULATOR)

    def release(self) -> None:
        """Unpause the simulator: simulated time runs from now on."""
        self.pause(on=False)

    def pause(self, *, on: bool = True) -> dict[str, int]:
        """Pause or unpause the simulator; return numbers of its status by name, or {}.

        Args:
            on: Whether time stops.
        """
        return _read_status(self._ask("pause", self._patience.service_s, on=on))

    def _ask(self, action: str, limit_s: float, **content: object) -> str:
        """Make a request; TrialEnded if no answer comes, BarnError if it is refused."""
        try:
            return self._request(action, limit_s, **content)
        except ServiceTimeout as error:
            raise TrialEnded(Outcome.SIMULATOR_DIED, str(error)) from None
        except ServiceRefused as error:
            raise BarnError(f"simulator: {error}") from None


def _read_status(text: str) -> dict[str, int]:
    """Return numbers and flags by name in the suite's simulator's status, else {}."""
    with suppress(ValueError):
        status = json.loads(text)
        if isinstance(status, dict) and status.get("version") == _STATUS_VERSION:
            return {
                name: number
                for name, number in status.items()
                if isinstance(number, int)
            }
    return {}
