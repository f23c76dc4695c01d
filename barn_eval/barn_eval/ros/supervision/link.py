"""The line between the supervisor and the evaluator that it started: one JSON object per line, over a socket.

Supervisor to evaluator, with NAME planner or simulator: {"event": "exited", "name": NAME, "how": TEXT}.
Evaluator to supervisor: {"event": "trial", "id": TRIAL_ID}, {"event": "result", "row": LINE, "track": LINE} (lines of
results.jsonl and tracks.jsonl), {"event": "stop", "name": NAME}, {"event": "start", "name": NAME},
{"event": "note", "text": TEXT}, {"event": "refused", "reason": TEXT}, {"event": "done"}.
"""

import json
import socket


class Lines:
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


class Link(Lines):
    """One end of the line between supervisor and evaluator."""

    def send(self, event: str, **content: str) -> None:
        """Send an event; nothing happens if the other end is gone."""
        try:
            self.socket.sendall(json.dumps({"event": event, **content}).encode() + b"\n")
        except OSError:
            self.closed = True

    def receive(self) -> list[dict[str, str]]:
        """Return the events that have come, without waiting."""
        return [json.loads(line) for line in self.read()]
