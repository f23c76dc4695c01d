"""The private line between a simulator and its evaluator.

It carries readings, requests and answers as packets. A packet is a reading (a
serialized message with its topic and the time at which it was sent) or an object of
JSON.

The line is a pair of connected sockets. The supervisor hands their ends to the two
processes. Unlike a topic or a ROS domain, it has no name on the host or the network,
so nobody else can send on it.
"""

import json
import select
import socket
import struct
import time
from collections.abc import Callable
from typing import Any, NamedTuple

_READING = b"R"  # first byte of a reading; JSON begins with a brace
_HEAD = struct.Struct("<cqB")  # first byte, time of sending in ns, length of the topic
_LARGEST_PACKET = 1 << 20
_WAIT_S = 0.05
# Of packets that nobody has read yet, some 20 instants. A simulator waits while its
# evaluator does not read, so nothing is lost while the evaluator is suspended.
_BUFFER_BYTES = 64 * 1024


class Reading(NamedTuple):
    """A serialized message."""

    topic: str
    """Name without a namespace."""

    data: bytes

    sent_ns: int
    """Wall-clock time when it was sent."""


def create_ends() -> tuple[socket.socket, socket.socket]:
    """Return the two connected sockets of a new line, the simulator's first."""
    ends = socket.socketpair(socket.AF_UNIX, socket.SOCK_SEQPACKET)
    for end in ends:
        end.setsockopt(socket.SOL_SOCKET, socket.SO_SNDBUF, _BUFFER_BYTES)
    return ends


class PrivateLine:
    """One end of the line."""

    def __init__(self, descriptor: int, waits: Callable[[], bool] = lambda: True):
        """Take over the socket of one end by its file descriptor.

        Args:
            descriptor: File descriptor of the socket.
            waits: Tells whether to wait for a reader at the other end. While it returns
                False, every packet is dropped, even if there is room for it.
        """
        self._socket = socket.socket(fileno=descriptor)
        self._waits = waits

    def publish(self, topic: str, data: bytes) -> None:
        """Send a serialized message, its topic and the time now; wait while full.

        Args:
            topic: Name without a namespace.
            data: Serialized message.
        """
        name = topic.encode()
        self._send(_HEAD.pack(_READING, time.time_ns(), len(name)) + name + data)

    def send(self, **content: object) -> None:
        """Send keyword arguments as one JSON packet; waits while the line is full."""
        self._send(json.dumps(content).encode())

    def receive(self, *, wait: bool = False) -> Reading | dict[str, Any] | None:
        """Take the next packet; None if the line ended or, without `wait`, is empty.

        Args:
            wait: Wait for a packet; then None means that the other end is gone.
        """
        try:
            flags = 0 if wait else socket.MSG_DONTWAIT
            packet = self._socket.recv(_LARGEST_PACKET, flags)
        except BlockingIOError:
            return None
        if packet[:1] == _READING:
            _, sent_ns, length = _HEAD.unpack_from(packet)
            end = _HEAD.size + length
            return Reading(packet[_HEAD.size : end].decode(), packet[end:], sent_ns)
        return json.loads(packet) if packet else None

    def _send(self, packet: bytes) -> None:
        """Send a packet; wait while full, drop it if not `waits` or the line broke."""
        while self._waits():
            try:
                self._socket.send(packet, socket.MSG_DONTWAIT)
                return
            except BlockingIOError:
                select.select([], [self._socket], [], _WAIT_S)
            except (BrokenPipeError, ConnectionResetError):
                # The supervisor keeps both ends open. If it is gone, this process is
                # about to be ended.
                return
