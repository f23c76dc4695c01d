"""A command of a run as the supervisor sees it, and events between the processes.

Events are JSON objects, one per line, over a socket. NAME is "planner" or "simulator".

The supervisor sends to the evaluator:
    {"event": "exited", "name": NAME, "how": TEXT, "culprit": WHO}: a process has ended;
        WHO is empty where that process is to blame

The evaluator sends to the supervisor:
    {"event": "trial", "id": TRIAL_ID}: an attempt at a trial begins
    {"event": "released"}: its robot drives
    {"event": "repeated", "reason": TEXT}: it is repeated after it was released
    {"event": "result", "row": LINE, "track": LINE, "commands": LINE}: for
        results.jsonl, tracks.jsonl and commands.jsonl
    {"event": "stop", "name": NAME}, {"event": "start", "name": NAME}
    {"event": "note", "text": TEXT}: for the user
    {"event": "parameters", "text": JSON}: parameters of the planner's nodes
    {"event": "refused", "reason": TEXT}: the run is not possible
    {"event": "done"}

A launcher sends to the supervisor {"event": "ended", "how": TEXT}. What the evaluator
is to do comes as a file, the `Assignment`: it is more than parameters can hold.
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

from barn_eval.ros.supervision import launcher
from barn_worlds.base.errors import BarnError, ConfigError, convert_os_errors

# Isolated from the packages of the user: a launcher needs the standard library only.
LAUNCHER = (sys.executable, "-I", "-S", launcher.__file__)
_MARK = "BARN_LAUNCHER"
# A log of all starts; a larger one begins anew, and the one before it is kept.
_FULL_LOG_BYTES = 10_000_000
_MAX_LINE = 300  # characters of a line that a message quotes
# Only a launcher that hangs takes longer: it may wait for the processor, and for the
# disk that takes what was printed.
_STOP_LIMIT_S = sum(patience_s for _, patience_s in launcher.PATIENCE_S) + 60.0


class EventChannel:
    """One end of a socket for events."""

    def __init__(self, connection: socket.socket):
        """Take over a connected stream socket as this end."""
        self.socket = connection
        # Whether the other end is gone.
        self.closed = False
        self._received = b""

    def fileno(self) -> int:
        """Return the socket's file descriptor, to wait on for events."""
        return self.socket.fileno()

    def send(self, event: str, **content: str) -> None:
        """Send an event as a JSON line; nothing happens if the other end is gone.

        Args:
            event: Name of the event.
            **content: Its fields.
        """
        line = json.dumps({"event": event, **content}).encode() + b"\n"
        with suppress(OSError):
            self.socket.sendall(line)

    def receive(self) -> list[dict[str, str]]:
        """Return events that have arrived in full; set `closed` if the sender is gone.

        It does not wait for any.
        """
        while not self.closed:
            try:
                data = self.socket.recv(65536, socket.MSG_DONTWAIT)
            except BlockingIOError:
                break
            except OSError:
                # A connection that was reset is as good as closed.
                data = b""
            self.closed = not data
            self._received += data
        # The last piece is an event of which only a part has come, or empty.
        *lines, self._received = self._received.split(b"\n")
        return [json.loads(line) for line in lines]

    def close(self) -> None:
        """Close the socket of this end; what has not been received is lost."""
        self.closed = True
        self.socket.close()


class ProcessError(BarnError):
    """A process of a run that cannot be started or does not stay up."""


class SupervisedProcess:
    """One start of a command by a launcher."""

    def __init__(
        self,
        name: str,
        command: Sequence[str],
        environment: Mapping[str, str],
        log: Path,
        sockets: Sequence[socket.socket] = (),
        kind: str = launcher.SUITE,
        text: str = "",
    ):
        """Start the command under a launcher; what it prints is added to the log.

        Args:
            name: "simulator", "planner" or "evaluator".
            command: Words of the command.
            environment: Its variables.
            log: File that receives what the command prints.
            sockets: Inherited by the command under the same numbers.
            kind: What the launcher is told about the command.
            text: Text for its standard input, which then stays open.

        Raises:
            ConfigError: If the log cannot be written.
        """
        self.name = name
        self.log = log
        # Where in the log begins what this start prints.
        self.log_begin = 0
        # How it ended in words, once that is known.
        self.end: str | None = None
        # Whether it ended because its launcher did.
        self.lost = False
        # Whether it was told to stop.
        self.stopping = False
        # Descendants carry it in their environment, by which they are found.
        self._mark = uuid.uuid4().hex
        supervisor_socket, launcher_socket = socket.socketpair()
        self._events = EventChannel(supervisor_socket)
        descriptor = launcher_socket.fileno()
        # A planner that asks for a second goal waits for it, as at a terminal.
        reader, writer = map(os.fdopen, os.pipe(), ("r", "w"))
        self._input = writer
        writer.write(text)
        writer.flush()
        with launcher_socket, reader, convert_os_errors(ConfigError, log):
            if log.exists() and log.stat().st_size > _FULL_LOG_BYTES:
                log.replace(log.with_name(f"{log.name}.1"))
            with log.open("ab") as output:
                self.log_begin = output.tell()
                self._launcher = subprocess.Popen(  # noqa: S603
                    [*LAUNCHER, str(descriptor), kind, "--", *command],
                    env=dict(environment) | {_MARK: self._mark},
                    stdin=reader if text else subprocess.DEVNULL,
                    stdout=output,
                    stderr=subprocess.STDOUT,
                    pass_fds=[descriptor, *(end.fileno() for end in sockets)],
                    # Ctrl-C reaches the supervisor alone, which ends its processes.
                    start_new_session=True,
                )

    def fileno(self) -> int:
        """Return the file descriptor that is readable once the launcher reports."""
        return self._events.fileno()

    @property
    def pid(self) -> int:
        """Process ID of the launcher, of which the command is a descendant."""
        return self._launcher.pid

    @property
    def ended(self) -> bool:
        """Whether `read` has seen the end of the process and all its descendants."""
        return self.end is not None

    def read(self) -> None:
        """Store an end that the launcher reports; if that died, kill the rest."""
        if self.ended:
            return
        for event in self._events.receive():
            self.end = event["how"]
        if self._events.closed and not self.ended:
            self._kill_leftovers()

    def ask_to_stop(self) -> None:
        """Order the launcher to end the process, once, without waiting."""
        if not self.stopping:
            self.stopping = True
            self.send_stop()

    def send_stop(self) -> None:
        """Order the launcher to stop, or at a second order to kill; do not wait."""
        self._events.send("stop")

    def stop(self) -> None:
        """End the process and its descendants, by force at last, and wait for it."""
        self.ask_to_stop()
        self.wait(_STOP_LIMIT_S)
        if not self.ended:
            self._launcher.kill()
            self._kill_leftovers()
        self._events.close()
        self._launcher.wait()
        self._input.close()

    def wait(self, limit_s: float) -> None:
        """Wait for the end of the process, at most `limit_s`; end nothing."""
        deadline_s = time.monotonic() + limit_s
        self.read()
        while not self.ended and time.monotonic() < deadline_s:
            time.sleep(0.005)
            self.read()

    def _kill_leftovers(self) -> None:
        """Reap a dead launcher, kill processes with its mark, set `end` and `lost`.

        Its command dies with it; what the command has started carries the mark.
        """
        self._launcher.wait()
        # A process may start another one between the look and the signal, so look
        # until there is none.
        while pids := _find_marked(self._mark):
            launcher.signal_all(pids, signal.SIGKILL)
            time.sleep(0.01)
        self.end = "was lost with its launcher"
        self.lost = True


def _find_marked(mark: str) -> list[int]:
    """Return PIDs of this user's processes with the mark in their environment."""
    pids = []
    variable = f"{_MARK}={mark}".encode()
    for entry in Path("/proc").glob("[0-9]*"):
        # The environment of a process that has ended is empty.
        with suppress(OSError):
            if variable in (entry / "environ").read_bytes().split(b"\0"):
                pids.append(int(entry.name))
    return pids


def last_lines(log: Path, count: int = 10, begin: int = 0) -> str:
    """Return a log's last lines, or why it is unreadable, indented below its name.

    Args:
        log: File of what a process has printed.
        count: Number of lines.
        begin: Number of bytes at its beginning to leave out.

    Returns:
        The lines, shortened, below one that names the file.
    """
    try:
        with log.open("rb") as file:
            file.seek(max(begin, os.fstat(file.fileno()).st_size - 16384))
            lines = file.read().decode("utf-8", "replace").splitlines()
    except OSError as error:
        lines = [f"({error.strerror or error})"]
    quoted = [line[:_MAX_LINE] for line in lines[-count:]]
    return "\n  ".join([f"the end of {log}:", *quoted])
