"""A client of the live view: Foxglove's protocol over a WebSocket, as far as a test needs it."""

import base64
import json
import os
import socket
import struct


class LiveClient:
    """A connection that subscribes to topics and receives messages. Use as a context manager."""

    def __init__(self, url):
        host, port = url.removeprefix("ws://").rstrip("/").split(":")
        self._socket = socket.create_connection((host, int(port)), timeout=600)
        key = base64.b64encode(os.urandom(16)).decode()
        self._socket.sendall(
            f"GET / HTTP/1.1\r\nHost: {host}:{port}\r\nUpgrade: websocket\r\nConnection: Upgrade\r\n"
            f"Sec-WebSocket-Key: {key}\r\nSec-WebSocket-Version: 13\r\n"
            "Sec-WebSocket-Protocol: foxglove.sdk.v1\r\n\r\n".encode()
        )
        self._stream = self._socket.makefile("rb")
        self.status = self._stream.readline().decode()
        while self._stream.readline() not in (b"\r\n", b""):
            pass

    def __enter__(self):
        return self

    def __exit__(self, *_):
        self._stream.close()
        self._socket.close()

    def send(self, content):
        data = json.dumps(content).encode()
        size = bytes([0x80 | len(data)]) if len(data) < 126 else b"\xfe" + struct.pack(">H", len(data))
        self._socket.sendall(b"\x81" + size + bytes(4) + data)  # masked, with a mask of zeros

    def receive(self):
        """The next message: what JSON holds, or (subscription, log time in ns, payload)."""
        kind, data = 0, b""
        while True:
            first, second = self._stream.read(2)
            size = second & 127
            if size > 125:
                size = int.from_bytes(self._stream.read(2 if size == 126 else 8), "big")
            part = self._stream.read(size)
            if first & 15 > 2:
                continue  # ping, pong
            kind, data = kind or first & 15, data + part
            if first & 128:
                break
        if kind == 1:
            return json.loads(data)
        number, stamp_ns = struct.unpack_from("<IQ", data, 1)
        return number, stamp_ns, data[13:]

    def channels(self, count):
        """Wait until so many channels have been advertised; return them by topic."""
        found = {}
        while len(found) < count:
            message = self.receive()
            if isinstance(message, dict) and message["op"] == "advertise":
                found |= {channel["topic"]: channel for channel in message["channels"]}
        return found

    def subscribe(self, channels):
        """Subscribe to channels; the number of a subscription is that of its channel."""
        self.send({"op": "subscribe", "subscriptions": [{"id": one["id"], "channelId": one["id"]} for one in channels]})

    def messages(self, count):
        """Receive so many messages."""
        found = []
        while len(found) < count:
            message = self.receive()
            found += [message] if isinstance(message, tuple) else []
        return found
