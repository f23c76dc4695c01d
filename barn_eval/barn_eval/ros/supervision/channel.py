"""Events between the supervisor and the processes that it started: one JSON object per line, over a socket.

With NAME planner or simulator, and WHOM empty where that is to blame itself, the supervisor sends to the evaluator
{"event": "exited", "name": NAME, "how": TEXT, "blamed": WHOM}, and the evaluator to the supervisor
{"event": "trial", "id": TRIAL_ID}, {"event": "released"} of that trial, {"event": "repeated", "reason": TEXT} where it
is begun again after that, {"event": "result", "row": LINE, "track": LINE} (lines of results.jsonl and tracks.jsonl),
{"event": "stop", "name": NAME}, {"event": "start", "name": NAME}, {"event": "note", "text": TEXT},
{"event": "refused", "reason": TEXT}, {"event": "done"}. A guard sends {"event": "ended", "how": TEXT}.
What the evaluator is to do comes as a file, the `Assignment`: it is more than parameters can hold.
"""

import json
import socket
from contextlib import suppress
from dataclasses import dataclass
from pathlib import Path

from barn_eval.experiments.experiment import Experiment
from barn_eval.experiments.store import Store
from barn_eval.trials.spec import TrialSpec

NOT_TOLD = "nothing tells that from the planner's doing"


class EventChannel:
    """One end of such a socket, which is read without waiting; `closed` once the other end is gone."""

    def __init__(self, connection: socket.socket) -> None:
        self.socket = connection
        self.closed = False
        self._received = b""

    def fileno(self) -> int:
        """Return what to wait on for events."""
        return self.socket.fileno()

    def send(self, event: str, **content: str) -> None:
        """Send an event; nothing happens if the other end is gone."""
        with suppress(OSError):
            self.socket.sendall(json.dumps({"event": event, **content}).encode() + b"\n")

    def receive(self) -> list[dict[str, str]]:
        """Return the events that have come."""
        while not self.closed:
            try:
                data = self.socket.recv(65536, socket.MSG_DONTWAIT)
            except BlockingIOError:
                break
            except OSError:
                data = b""
            self.closed = not data
            self._received += data
        *lines, self._received = self._received.split(b"\n")
        return [json.loads(line) for line in lines]

    def close(self) -> None:
        """Close this end."""
        self.closed = True
        self.socket.close()


@dataclass(frozen=True)
class Assignment:
    """Trials of the one planner of an experiment, by name, and where their bags and pictures go.

    robot: name or file of the robot, for the simulator node. look_first: nothing else has been started; the evaluator
    has it started once it has seen that nobody is in the way. apart: the planner cannot signal the suite's processes.
    """

    experiment: Experiment
    trials: tuple[str, ...]
    worlds: tuple[int, ...]
    out: str
    pictures: bool
    robot: str
    look_first: bool = False
    apart: bool = False

    @property
    def store(self) -> Store:
        """Where bags and pictures go."""
        return Store(Path(self.out), self.experiment.bags, self.pictures)

    def specs(self) -> list[TrialSpec]:
        """Return the trials; WorldError if a world cannot be read."""
        return [spec for spec in self.experiment.trials(self.worlds) if spec.trial_id in set(self.trials)]
