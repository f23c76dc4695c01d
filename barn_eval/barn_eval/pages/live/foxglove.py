"""The live view of trials: a server for Foxglove, which reads the bag that is being written.

The trial itself has no part in it: whoever runs it is not slowed down, and nothing is read while nobody watches.
"""

import threading
from contextlib import AbstractContextManager
from importlib.util import find_spec
from pathlib import Path
from typing import Any

from barn_eval.pages import LIVE_PORT
from barn_eval.results.bags.bagfile import TrialFollower
from barn_eval.results.bags.mcap_file import RawMessage
from barn_worlds.base.errors import BarnError, ConfigError
from barn_worlds.messages import topics
from barn_worlds.messages.cdr import jazzy_types
from barn_worlds.messages.topics import LATCHED, Topic

MISSING = (
    "the live view needs foxglove-sdk, which is not installed: pip install foxglove-sdk"
)
_PERIOD_S = 0.1
_TOPICS = {one.path: one for one in vars(topics).values() if isinstance(one, Topic)}
_LATCHED = {
    path for path, one in _TOPICS.items() if one.qos.durability == LATCHED.durability
}


def require_sdk() -> None:
    """Raise ConfigError if Foxglove's SDK is not installed."""
    if find_spec("foxglove") is None:
        raise ConfigError(MISSING)


class LiveView(AbstractContextManager["LiveView"]):
    """A server that Foxglove connects to, following the trials of a folder until it is closed; a context manager.

    ConfigError where the SDK is not installed, or the address cannot be had.
    """

    def __init__(self, folder: Path, *, host: str, port: int = LIVE_PORT) -> None:
        require_sdk()
        import foxglove  # noqa: PLC0415 (an optional extra)

        self._folder = folder
        self._sdk: Any = foxglove
        self._context = foxglove.Context()
        self._types = jazzy_types()
        self._channels: dict[tuple[str, str], Any] = {}
        self._latched: dict[tuple[str, str], RawMessage] = {}
        self._asked: set[int] = set()
        self._over = threading.Event()
        try:
            self._server = foxglove.start_server(
                name="barn",
                host=host,
                port=port,
                context=self._context,
                server_listener=_Listener(self._asked),
            )
        except (
            Exception
        ) as error:  # the SDK says in classes of its own that an address is taken
            raise ConfigError(
                f"host {host!r}, live port {port}: cannot be served: {error}"
            ) from None
        for topic in _TOPICS.values():
            self._channel(topic.path, topic.type_name)
        self.url = f"ws://{host}:{self._server.port}"
        self._thread = threading.Thread(target=self._follow, daemon=True)
        self._thread.start()

    def __exit__(self, *_: object) -> None:
        """Close it."""
        self.close()

    def close(self) -> None:
        """Stop to serve."""
        self._over.set()
        self._thread.join()
        self._server.stop()

    def _follow(self) -> None:
        follower = TrialFollower(self._folder)
        while not self._over.wait(_PERIOD_S):
            if not any(channel.has_sinks() for channel in self._channels.values()):
                follower.close()
                follower = TrialFollower(self._folder)
                continue
            try:
                self._send(*follower.read())
            except (
                BarnError,
                OSError,
            ):  # a damaged or vanished bag: the next trial has another
                follower.close()
        follower.close()

    def _send(self, another: bool, heard: list[RawMessage]) -> None:
        if another:
            self._latched.clear()
            self._asked.clear()
            self._server.clear_session()
        asked = {self._asked.pop() for _ in range(len(self._asked))}
        for key, message in self._latched.items():
            if self._channels[key].id() in asked:
                self._channels[key].log(message.data, log_time=message.stamp_ns)
        for message in heard:
            key = message.topic, message.type_name
            self._channel(*key).log(message.data, log_time=message.stamp_ns)
            if message.topic in _LATCHED:
                self._latched[key] = message

    def _channel(self, topic: str, type_name: str) -> Any:
        key = topic, type_name
        if key not in self._channels:
            definition, _ = self._types.generate_msgdef(type_name, ros_version=2)
            schema = self._sdk.Schema(
                name=type_name, encoding="ros2msg", data=definition.encode()
            )
            self._channels[key] = self._sdk.Channel(
                topic, schema=schema, message_encoding="cdr", context=self._context
            )
        return self._channels[key]


class _Listener:
    """Notes which topics somebody has begun to listen to, so that they get what was said once."""

    def __init__(self, asked: set[int]) -> None:
        self._asked = asked

    def __getattr__(self, name: str) -> Any:
        """Return what takes in that a client has subscribed to a channel, or ignores any other event."""
        if not name.startswith("on_"):
            raise AttributeError(name)
        return lambda *about: (
            self._asked.add(about[1].id) if name == "on_subscribe" else None
        )
