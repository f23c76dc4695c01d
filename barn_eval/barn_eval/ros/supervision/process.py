"""A command under guard, as the supervisor sees it, and the events by which processes talk with the supervisor.

These are JSON objects, one per line, over a socket.
With NAME planner or simulator, and WHOM empty where that is to blame itself, the supervisor sends to the evaluator
{"event": "exited", "name": NAME, "how": TEXT, "blamed": WHOM}, and the evaluator to the supervisor
{"event": "trial", "id": TRIAL_ID}, {"event": "released"} of that trial, {"event": "repeated", "reason": TEXT} where it
is begun again after that, {"event": "result", "row": LINE, "track": LINE} (lines of results.jsonl and tracks.jsonl),
{"event": "stop", "name": NAME}, {"event": "start", "name": NAME}, {"event": "note", "text": TEXT}, {"event":
"parameters", "text": JSON} of the planner's nodes, {"event": "refused", "reason": TEXT}, {"event": "done"}. A guard
sends {"event": "ended", "how": TEXT}.
What the evaluator is to do comes as a file, the `Assignment`: it is more than parameters can hold.
"""

import json
import os
import signal
import socket
import subprocess
import sys
import time
import uuid
from collections.abc import Mapping, Sequence
from contextlib import suppress
from pathlib import Path

from barn_eval.ros.supervision import guard
from barn_worlds.base.errors import BarnError, ConfigError, convert_os_errors

_MARK = "BARN_GUARD"
_FULL_LOG_BYTES = (
    10_000_000  # of all starts: then it begins anew, and one before it is kept
)
_LINE = 300  # characters of a line that a message quotes
# Only a guard that hangs takes longer: it may wait for the processor, and for the disk that takes what was printed.
_GRACE_S = sum(patience_s for _, patience_s in guard.PATIENCE_S) + 60.0


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
            self.socket.sendall(
                json.dumps({"event": event, **content}).encode() + b"\n"
            )

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


class ProcessError(BarnError):
    """A process of a run that cannot be started or does not stay up."""


class GuardedProcess:
    """One start of a command under guard; ConfigError where its log cannot be written.

    handed: sockets that the command inherits under the same numbers. kind: what the guard is told that it guards.
    """

    def __init__(
        self,
        name: str,
        command: Sequence[str],
        environment: Mapping[str, str],
        log: Path,
        handed: Sequence[socket.socket] = (),
        kind: str = guard.SUITE,
    ) -> None:
        self.name, self.log = name, log
        self.end: str | None = None  # in words, once it is known
        self.lost = False  # whether it ended because its guard did
        self.asked = False  # to stop
        self._mark = uuid.uuid4().hex
        ours, theirs = socket.socketpair()
        self._news = EventChannel(ours)
        with theirs, convert_os_errors(ConfigError, log):
            if log.exists() and log.stat().st_size > _FULL_LOG_BYTES:
                log.replace(log.with_name(f"{log.name}.1"))
            with log.open("ab") as output:
                self._guard = subprocess.Popen(  # noqa: S603
                    [
                        sys.executable,
                        "-I",
                        "-S",
                        guard.__file__,
                        str(theirs.fileno()),
                        kind,
                        "--",
                        *command,
                    ],
                    env=dict(environment) | {_MARK: self._mark},
                    stdin=subprocess.DEVNULL,
                    stdout=output,
                    stderr=subprocess.STDOUT,
                    pass_fds=[one.fileno() for one in (theirs, *handed)],
                    start_new_session=True,
                )

    def fileno(self) -> int:
        """Return what to wait on for news of the process."""
        return self._news.fileno()

    @property
    def ended(self) -> bool:
        """Whether the process, and all that it started, has ended, as far as news of it have been read."""
        return self.end is not None

    def read(self) -> None:
        """Take in the news that have come."""
        if not self.ended:
            for event in self._news.receive():
                self.end = event["how"]
            if self._news.closed and not self.ended:
                self._lost()

    def ask_to_stop(self) -> None:
        """Begin to end the process; asking again changes nothing."""
        if not self.asked:
            self.asked = True
            self.stop_now()

    def stop_now(self) -> None:
        """Leave a process that was asked to stop no more time."""
        self._news.send("stop")

    def stop(self) -> None:
        """End the process and all that it started, and return when it has ended."""
        self.ask_to_stop()
        self.wait(_GRACE_S)
        if not self.ended:
            self._guard.kill()
            self._lost()
        self._news.close()
        self._guard.wait()

    def wait(self, limit_s: float) -> None:
        """Return when the process has ended, or after that time."""
        deadline = time.monotonic() + limit_s
        self.read()
        while not self.ended and time.monotonic() < deadline:
            time.sleep(0.005)
            self.read()

    def _lost(self) -> None:
        """End what a guard has left that was killed: its command dies with it, what that has started has its mark."""
        self._guard.wait()
        while left := _carrying(self._mark):
            for pid in left:
                with suppress(ProcessLookupError):
                    os.kill(pid, signal.SIGKILL)
            time.sleep(0.01)
        self.end, self.lost = "was lost with its guard", True


def _carrying(mark: str) -> list[int]:
    """Return the living processes of this user that have a mark in the environment that they were started with."""
    found, entry_text = [], f"{_MARK}={mark}".encode()
    for entry in Path("/proc").iterdir():
        with suppress(OSError):
            if entry.name.isdigit() and entry_text in (
                entry / "environ"
            ).read_bytes().split(b"\0"):
                found.append(
                    int(entry.name)
                )  # of a process that has ended, the environment is empty
    return found


def last_lines(log: Path, count: int = 10) -> str:
    """Return the end of a log, introduced by its name."""
    try:
        with log.open("rb") as file:
            file.seek(max(0, os.fstat(file.fileno()).st_size - 16384))
            lines = file.read().decode("utf-8", "replace").splitlines()
    except OSError as error:
        lines = [f"({error.strerror or error})"]
    return "\n  ".join(
        [f"the end of {log}:", *(line[:_LINE] for line in lines[-count:])]
    )
