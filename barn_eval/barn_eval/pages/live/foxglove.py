"""The Foxglove stream of trials: a server that reads the bag that is being written.

The trial itself does not know about it, so viewers do not slow it down. Nothing is read
while nobody watches.
"""

import threading
from contextlib import suppress
from importlib.util import find_spec
from pathlib import Path
from secrets import randbelow
from typing import Any

from barn_eval.pages import LIVE_PORT
from barn_eval.pages.live.gate import Gate
from barn_eval.results.bags.bagfile import RawMessage, TrialFollower
from barn_eval.results.bags.messages import TRUE_TOPICS
from barn_eval.results.run_file import RunFile
from barn_worlds.base.errors import BarnError, ConfigError
from barn_worlds.messages import topics
from barn_worlds.messages.cdr import jazzy_types
from barn_worlds.messages.topics import LATCHED, Topic

MISSING = (
    "the live view needs foxglove-sdk, which is not installed: pip install foxglove-sdk"
)
_PERIOD_S = 0.1
_CATALOG = [topic for topic in vars(topics).values() if isinstance(topic, Topic)]
# One for each path: some are in the catalog twice, and the first entry counts.
_TOPICS = {topic.path: topic for topic in reversed(_CATALOG)}
_LATCHED_PATHS = {
    topic.path for topic in _CATALOG if topic.qos.durability == LATCHED.durability
}
# A planner in a process of its own can be a viewer, too: it must not get these.
_TRUE_PATHS = {
    topic.path for topic in (topics.GROUND_TRUTH, topics.COLLISION, *TRUE_TOPICS)
}


def require_sdk() -> None:
    """Raise ConfigError if the package foxglove-sdk is not installed."""
    if find_spec("foxglove") is None:
        raise ConfigError(MISSING)


class FoxgloveStream:
    """Follows the trials of a results folder and serves them until it is closed."""

    def __init__(self, folder: Path, *, host: str, port: int = LIVE_PORT):
        """Start threads that serve viewers and follow bags; ConfigError if that fails.

        Args:
            folder: Folder of the bags.
            host: An address of this machine.
            port: A port of it.

        Raises:
            ConfigError: The SDK is not installed, or the address is not available.
        """
        require_sdk()
        import foxglove  # noqa: PLC0415 (an optional extra)

        self._folder = folder
        self._sdk: Any = foxglove
        self._context = foxglove.Context()
        self._types = jazzy_types()
        self._channels: dict[tuple[str, str], Any] = {}
        self._latched: dict[tuple[str, str], RawMessage] = {}
        self._new_channel_ids: set[int] = set()
        self._shows_truth = False
        self._stop = threading.Event()
        try:
            # The SDK lets any page connect, so only the gate is where one may look.
            inner = ".".join(["127", *(str(1 + randbelow(254)) for _ in range(3))])
            self._server = foxglove.start_server(
                name="barn",
                host=inner,
                port=0,
                context=self._context,
                server_listener=_Listener(self._new_channel_ids),
            )
            self._gate = Gate((host, port), (inner, self._server.port))
        # The SDK has classes of its own for an address that is in use.
        except Exception as error:
            raise ConfigError(
                f"host {host!r}, live port {port}: cannot be served: {error}"
            ) from None
        # Viewers list topics when they connect, before any message has come.
        for topic in _TOPICS.values():
            self._channel(topic.path, topic.type_name)
        self.url = f"ws://{host}:{self._gate.server_address[1]}"
        self._thread = threading.Thread(target=self._follow, daemon=True)
        self._thread.start()

    def close(self) -> None:
        """Stop following bags and serving viewers, and wait until both have ended."""
        self._stop.set()
        self._thread.join()
        self._gate.close()
        self._server.stop()

    def _follow(self) -> None:
        """Read the bag that is being written and send its messages until closed."""
        follower = TrialFollower(self._folder)
        while not self._stop.wait(_PERIOD_S):
            # Nobody watches: the disk is left to the trials.
            if not any(channel.has_sinks() for channel in self._channels.values()):
                follower.close()
                # A new follower gives the next viewer the trial from its beginning.
                follower = TrialFollower(self._folder)
                continue
            try:
                is_new_trial, messages = follower.read()
            except (BarnError, OSError):
                # The bag is damaged or gone; the next trial has another one.
                follower.close()
                continue
            if is_new_trial:
                self._start_session()
            self._send(messages)
        follower.close()

    def _start_session(self) -> None:
        """Forget the previous trial, clear displays, and choose what viewers may see."""
        self._latched.clear()
        self._new_channel_ids.clear()
        self._server.clear_session()
        # Without a readable run file, the truth stays hidden.
        with suppress(BarnError):
            run = RunFile.read(self._folder).run_config()
            self._shows_truth = run.mode == "direct" or run.ros.ground_truth

    def _send(self, messages: list[RawMessage]) -> None:
        """Send new messages; send latched ones to viewers that just subscribed."""
        # The server's thread adds to the set meanwhile, so it cannot be iterated.
        new_ids = self._new_channel_ids.copy()
        self._new_channel_ids -= new_ids
        for key, message in self._latched.items():
            if self._channels[key].id() in new_ids:
                self._channels[key].log(message.data, log_time=message.stamp_ns)

        for message in messages:
            if message.topic in _TRUE_PATHS and not self._shows_truth:
                continue
            key = (message.topic, message.type_name)
            self._channel(*key).log(message.data, log_time=message.stamp_ns)
            if message.topic in _LATCHED_PATHS:
                self._latched[key] = message

    def _channel(self, topic: str, type_name: str) -> Any:
        """Return the channel of a topic and message type, made at first use."""
        key = (topic, type_name)
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
    """Collects the channels that viewers subscribe to, for their latched messages."""

    def __init__(self, new_channel_ids: set[int]):
        """Keep the set to which the IDs of subscribed channels are added."""
        self._new_channel_ids = new_channel_ids

    def __getattr__(self, name: str) -> Any:
        """Return the handler of an event; only that of subscriptions does anything."""
        if not name.startswith("on_"):
            raise AttributeError(name)
        return self._add_channel if name == "on_subscribe" else _ignore_event

    def _add_channel(self, _: Any, channel: Any) -> None:
        """Keep the ID of a channel that a viewer has subscribed to."""
        self._new_channel_ids.add(channel.id)


def _ignore_event(*_: Any) -> None:
    """Do nothing; this handles all events of the server but subscriptions."""
