"""A client of the live view.

Foxglove's protocol over a WebSocket, as far as a test needs it.
"""

import json
import struct

import pytest


class LiveClient:
    """A connection that subscribes to topics and receives messages.

    Use as a context manager.
    """

    def __init__(self, url):
        reason = "Tornado, which comes with nbclient, is not installed"
        websocket = pytest.importorskip("tornado.websocket", reason=reason)
        self._loop = pytest.importorskip("tornado.ioloop", reason=reason).IOLoop(
            make_current=False
        )
        self._connection = self._do(
            lambda: websocket.websocket_connect(url, subprotocols=["foxglove.sdk.v1"])
        )

    def __enter__(self):
        return self

    def __exit__(self, *_):
        self._connection.close()
        while self._do(self._connection.read_message) is not None:
            pass
        self._loop.close()

    def _do(self, begin):
        """Begin something, and wait for what it gives."""
        return self._loop.run_sync(begin, timeout=600.0)

    def receive(self):
        """The next message.

        What JSON holds, or (subscription, log time in ns, payload).
        """
        data = self._do(self._connection.read_message)
        return (
            json.loads(data)
            if isinstance(data, str)
            else (*struct.unpack_from("<IQ", data, 1), data[13:])
        )

    def channels(self, count):
        """Wait until so many channels have been advertised; return them by topic."""
        by_topic = {}
        while len(by_topic) < count:
            message = self.receive()
            if isinstance(message, dict) and message["op"] == "advertise":
                by_topic |= {
                    channel["topic"]: channel for channel in message["channels"]
                }
        return by_topic

    def subscribe(self, channels):
        """Subscribe to channels.

        The number of a subscription is that of its channel.
        """
        requests = [
            {"id": channel["id"], "channelId": channel["id"]} for channel in channels
        ]
        content = json.dumps({"op": "subscribe", "subscriptions": requests})
        self._do(lambda: self._connection.write_message(content))

    def messages(self, count):
        """Receive so many messages."""
        received = []
        while len(received) < count:
            message = self.receive()
            received += [message] if isinstance(message, tuple) else []
        return received
