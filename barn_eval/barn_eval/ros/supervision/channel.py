"""The channel between the supervisor and the evaluator that it started: one JSON object per line, over a socket.

What the evaluator is to do comes as a file, the `Assignment`: it is more than parameters can hold.
Supervisor to evaluator, with NAME planner or simulator and WHOM empty where that is to blame itself:
{"event": "exited", "name": NAME, "how": TEXT, "blamed": WHOM}.
Evaluator to supervisor: {"event": "trial", "id": TRIAL_ID}, {"event": "result", "row": LINE, "track": LINE} (lines of
results.jsonl and tracks.jsonl), {"event": "stop", "name": NAME}, {"event": "start", "name": NAME},
{"event": "note", "text": TEXT}, {"event": "refused", "reason": TEXT}, {"event": "done"}.
"""

from __future__ import annotations

import json
import socket
from collections.abc import Sequence
from dataclasses import dataclass, replace
from pathlib import Path

from barn_eval.experiments.experiment import Experiment
from barn_eval.experiments.store import Store
from barn_eval.trials.spec import TrialSpec
from barn_worlds.base.config import as_dict, from_dict
from barn_worlds.base.files import write_whole
from barn_worlds.base.text_files import read_json


class LineReader:
    """A socket that is read line by line, without waiting; `closed` once the other end is gone."""

    def __init__(self, connection: socket.socket) -> None:
        self.socket = connection
        self.socket.setblocking(False)
        self.closed = False
        self._received = b""

    def fileno(self) -> int:
        """Return what to wait on for lines."""
        return self.socket.fileno()

    def read(self) -> list[bytes]:
        """Return the whole lines that have come."""
        while not self.closed:
            try:
                data = self.socket.recv(65536)
            except BlockingIOError:
                break
            except OSError:
                data = b""
            self.closed = not data
            self._received += data
        *lines, self._received = self._received.split(b"\n")
        return lines

    def close(self) -> None:
        """Close this end."""
        self.closed = True
        self.socket.close()


class EventChannel(LineReader):
    """One end of the channel between supervisor and evaluator."""

    def send(self, event: str, **content: str) -> None:
        """Send an event; nothing happens if the other end is gone."""
        try:
            self.socket.sendall(json.dumps({"event": event, **content}).encode() + b"\n")
        except OSError:
            self.closed = True

    def receive(self) -> list[dict[str, str]]:
        """Return the events that have come, without waiting."""
        return [json.loads(line) for line in self.read()]


@dataclass(frozen=True)
class Assignment:
    """Trials of one planner, by name, and where their bags and pictures go.

    robot: name or file of the robot, for the simulator node. look_first: nothing else has been started; the evaluator
    has it started once it has seen that nobody is in the way.
    """

    experiment: Experiment
    planner: str
    trials: tuple[str, ...]
    worlds: tuple[int, ...]
    out: str
    pictures: bool
    robot: str
    look_first: bool = False

    @classmethod
    def of(
        cls,
        experiment: Experiment,
        trials: Sequence[TrialSpec],
        store: Store,
        robot: str,
        *,
        look_first: bool = False,
    ) -> Assignment:
        """Return the assignment of an experiment's trials, all of one planner."""
        return cls(
            experiment,
            trials[0].planner,
            tuple(spec.trial_id for spec in trials),
            tuple(dict.fromkeys(spec.index for spec in trials)),
            str(store.folder),
            store.pictures,
            robot,
            look_first,
        )

    @classmethod
    def read(cls, path: Path) -> Assignment:
        """Return what a file says; ConfigError if it is none."""
        return from_dict(cls, read_json(path), str(path))

    def write(self, path: Path) -> None:
        """Write the file; StoreError if it cannot be written."""
        write_whole(path, json.dumps(as_dict(self)).encode())

    @property
    def store(self) -> Store:
        """Where bags and pictures go."""
        return Store(Path(self.out), self.experiment.bags, self.pictures)

    def specs(self) -> list[TrialSpec]:
        """Return the trials; WorldError if a world cannot be read."""
        alone = tuple(one for one in self.experiment.planners if one.name == self.planner)
        made = replace(self.experiment, planners=alone).trials(self.worlds)
        return [spec for spec in made if spec.trial_id in set(self.trials)]
