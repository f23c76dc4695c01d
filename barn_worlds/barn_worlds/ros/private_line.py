"""The private line between a simulator and its evaluator: readings, requests and answers that nobody else can send.

It is a pair of connected sockets whose ends the supervisor hands down to the two processes. Unlike a topic or a ROS
domain it has no name on the host or on the network, so that nobody can join it. A packet is either a reading (a
serialised message with its topic and the time at which it was sent) or an object of JSON.
"""

import json
import select
import socket
import struct
import time
from collections.abc import Callable
from typing import Any, NamedTuple

_READING = b"R"  # first byte of a packet; JSON begins with a brace
_HEAD = struct.Struct("<cqB")  # that, time of sending in ns, length of the topic's name
_LARGEST = 1 << 20
_WAIT_S = 0.05
# Of packets that nobody has read yet, the sender's own accounting included: some 20 instants. A simulator that is not
# listened to waits, so that nothing is lost while its evaluator is suspended.
_BUFFER = 64 * 1024


class Reading(NamedTuple):
    """A serialised message, the name of its topic without a namespace, and the wall-clock time when it was sent."""

    topic: str
    data: bytes
    sent_ns: int


def create_ends() -> tuple[socket.socket, socket.socket]:
    """Return the two ends of a new line, that of the simulator first."""
    ends = socket.socketpair(socket.AF_UNIX, socket.SOCK_SEQPACKET)
    for end in ends:
        end.setsockopt(socket.SOL_SOCKET, socket.SO_SNDBUF, _BUFFER)
    return ends


class PrivateLine:
    """One end of the line. Sending waits for the other end to read as long as `waits` holds, and then drops."""

    def __init__(
        self, descriptor: int, waits: Callable[[], bool] = lambda: True
    ) -> None:
        self._socket = socket.socket(fileno=descriptor)
        self._waits = waits

    def publish(self, topic: str, data: bytes) -> None:
        """Send a reading."""
        name = topic.encode()
        self._send(_HEAD.pack(_READING, time.time_ns(), len(name)) + name + data)

    def send(self, **content: object) -> None:
        """Send an object of JSON."""
        self._send(json.dumps(content).encode())

    def receive(self, *, wait: bool = False) -> Reading | dict[str, Any] | None:
        """Return the next packet; None if there is none now, or, with `wait`, once the other end is gone."""
        try:
            packet = self._socket.recv(_LARGEST, 0 if wait else socket.MSG_DONTWAIT)
        except BlockingIOError:
            return None
        if packet[:1] == _READING:
            _, sent_ns, length = _HEAD.unpack_from(packet)
            end = _HEAD.size + length
            return Reading(packet[_HEAD.size : end].decode(), packet[end:], sent_ns)
        content: dict[str, Any] | None = json.loads(packet) if packet else None
        return content

    def _send(self, packet: bytes) -> None:
        while self._waits():
            try:
                self._socket.send(packet, socket.MSG_DONTWAIT)
            except BlockingIOError:
                select.select([], [self._socket], [], _WAIT_S)
                continue
            except (BrokenPipeError, ConnectionResetError):
                pass  # the supervisor, which keeps both ends open, is gone, and this process is about to be ended
            return
