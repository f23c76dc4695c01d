"""Raw subscriptions that are read when the evaluator wants to, all at once, and the queue of a trial's messages.

A trial in lockstep brings some thousand messages a second. Taking them in bulk costs a quarter of what the executor's
callbacks would, and the processor time is the simulator's and the planner's.
"""

from collections import Counter
from collections.abc import Callable
from contextlib import suppress
from dataclasses import dataclass, replace
from typing import Any

from rclpy.callback_groups import CallbackGroup
from rclpy.node import Node
from rclpy.subscription import Subscription

from barn_eval.ros.adapter import TrialTopics
from barn_eval.ros.sequencer import Message, Tick, TickSequencer
from barn_eval.ros.session import TrialEnded
from barn_eval.ros.simulator import SimulatorChannel
from barn_eval.trials.outcome import Outcome
from barn_worlds.base.errors import MessageError
from barn_worlds.base.types import seconds
from barn_worlds.messages import decode
from barn_worlds.messages.topics import LATCHED, RELIABLE, Qos
from barn_worlds.ros.topics import find_message_class, qos_profile

_TOLD_EVERY = 2  # ticks
# Messages of a topic that may wait to be read, several seconds in lockstep; of one that is only recorded.
_DEPTH, _DEPTH_RECORDED = 2000, 256
# Bytes that are read at a time, that wait for their tick to be complete, and that are taken in all in a trial; and how
# often in a row there may be more to read than that. What is beyond is more than can be looked at or kept.
_TURN_BYTES, _WAITING_BYTES, _TRIAL_BYTES = 32 << 20, 512 << 20, 4 << 30
_FULL_TURNS = 20
_LATE_NS = (
    1_000_000_000  # that a command of the trial before may need on a busy machine
)


class PolledGroup(CallbackGroup):
    """A group whose entities no executor touches: they are read by hand."""

    def can_execute(self, *_: object) -> bool:
        """Return False."""
        return False


@dataclass
class _HeardTopic:
    """A topic: its subscription, None where its messages come from elsewhere; of a latched one, the last message."""

    type_name: str
    qos: Qos = RELIABLE
    subscription: Subscription | None = None
    last: Message | None = None


class Subscriber:
    """All topics that are judged or recorded; latched messages, sent only once, are kept, for every bag needs them."""

    def __init__(self, node: Node) -> None:
        self.full_turns = 0  # how often in a row not all could be read at once
        self._node = node
        self._group = PolledGroup()
        self._topics: dict[str, _HeardTopic] = {}

    def subscribe(
        self, topic: str, type_name: str, qos: Qos = RELIABLE, *, judged: bool = True
    ) -> bool:
        """Subscribe to a topic, or anew if its type or reliability has changed; False for a type not installed."""
        known = self._topics.get(topic)
        if known is not None and (known.type_name, known.qos.reliability) == (
            type_name,
            qos.reliability,
        ):
            return True
        if (kind := find_message_class(type_name)) is None:
            return False
        if known is not None and known.subscription is not None:
            self._node.destroy_subscription(known.subscription)
        asked = qos_profile(replace(qos, depth=_DEPTH if judged else _DEPTH_RECORDED))
        how: dict[str, Any] = {"raw": True, "callback_group": self._group}
        made = self._node.create_subscription(kind, topic, lambda _: None, asked, **how)
        self._topics[topic] = _HeardTopic(type_name, qos, made)
        return True

    def provide(self, topic: str, type_name: str) -> None:
        """Note a topic whose messages come from elsewhere, so that it is not subscribed to for the bag."""
        self._topics[topic] = _HeardTopic(type_name)

    def topics(self) -> dict[str, str]:
        """Return the topics subscribed to and their types."""
        return {topic: known.type_name for topic, known in self._topics.items()}

    def unmatched(self, publishers: dict[str, int]) -> list[str]:
        """Return the topics on which fewer publishers are connected than the graph has, given their numbers."""
        known = {
            topic: self._topics[topic].subscription
            for topic in publishers
            if topic in self._topics
        }
        return [
            topic
            for topic, one in known.items()
            if one and one.get_publisher_count() < publishers[topic]
        ]

    def read(self, take: Callable[[Message], None]) -> None:
        """Hand over the messages that have arrived, topic by topic, those subscribed to first if they are too many."""
        left = _TURN_BYTES
        for topic, known in self._topics.items():
            if known.subscription is None:
                continue
            with (handle := known.subscription.handle):
                # What an executor and rclpy.wait_for_message call, too. rclpy has no public way without an executor,
                # which takes one message a turn.
                while (
                    left > 0
                    and (
                        taken := handle.take_message(known.subscription.msg_type, True)
                    )
                    is not None
                ):
                    data, about = taken
                    left -= len(data)
                    # stamps are the sender's, whose clock may say what it likes
                    message = Message(
                        topic,
                        data,
                        min(about["source_timestamp"], about["received_timestamp"]),
                    )
                    if known.qos.durability == LATCHED.durability:
                        known.last = message
                    take(message)
        self.full_turns = self.full_turns + 1 if left <= 0 else 0

    def latched(self) -> list[Message]:
        """Return the last message of each latched topic."""
        return [known.last for known in self._topics.values() if known.last is not None]


class TrialQueue:
    """Sorts what arrives by the ticks of /clock, from the reset of the simulator on.

    channel: brings the simulator's readings; without one they come by DDS.
    """

    def __init__(
        self,
        subscriber: Subscriber,
        topics: TrialTopics,
        reset_ns: int,
        channel: SimulatorChannel | None,
    ) -> None:
        # simulated time at which the trial begins, once it is known: a reset leaves the clock there until the release
        self.origin_ns: int | None = None
        self.now_ns = self.ticks = self.commands = (
            0  # simulated time; how many have arrived since the reset
        )
        self._subscriber, self._topics, self._channel = subscriber, topics, channel
        self._reset_ns = reset_ns
        self._released = self._exceeded = False
        self._sequencer = TickSequencer(topics.scan, fenced=channel is not None)
        self._heard_ns = self._told_ns = self._told_ticks = 0
        self._bytes: Counter[str] = Counter()  # taken, by topic
        self._waiting = 0  # bytes of these that have not been handed over
        self._behind_ns = (
            0  # by how much, at least, the clock is that stamped a command
        )

    def require_bounded(self) -> None:
        """Raise TrialEnded, once, if more comes than can be read or kept, or commands by a clock that is behind."""
        total = self._bytes.total()
        exceeded = (
            self._waiting > _WAITING_BYTES
            or total > _TRIAL_BYTES
            or self._subscriber.full_turns > _FULL_TURNS
        )
        behind_s = seconds(self._behind_ns)
        if (exceeded or behind_s) and not self._exceeded:
            self._exceeded = True
            topic, most = self._bytes.most_common(1)[0]
            text = f"{most / 1e6:.0f} MB on {topic}, more than can be kept up with"
            behind = f"commands are stamped by a clock that is {behind_s:.0f} s or more behind"
            raise TrialEnded(Outcome.INTERFERENCE, text if exceeded else behind)

    def read(self) -> None:
        """Take in what has arrived, and let a simulator on the line know every few ticks how far DDS has caught up."""
        if self._channel is None:
            self._subscriber.read(self._take)
            return
        before = self.ticks
        self._channel.read(self._take)
        self._subscriber.read(self._take_heard)
        heard_ns = min(
            self._heard_ns, self.now_ns
        )  # anybody can publish ticks that are yet to come
        idle = self.ticks == before  # it may be waiting for that
        if heard_ns > self._told_ns and (
            idle or self.ticks - self._told_ticks >= _TOLD_EVERY
        ):
            self._told_ns, self._told_ticks = heard_ns, self.ticks
            self._channel.tell(heard_ns)

    def release(self) -> None:
        """Note that from now on the simulated time runs."""
        self.read()
        self._released = True
        self.origin_ns = self._sequencer.latest_ns

    def hand_over(
        self, take: Callable[[Tick], None], *, all_of_it: bool = False
    ) -> None:
        """Hand on the ticks that are complete, or all that there are; none before the release."""
        if not self._released:
            return
        for tick in self._sequencer.rest() if all_of_it else self._sequencer.complete():
            self._waiting -= sum(len(message.data) for message in tick.messages)
            if self.origin_ns is not None and tick.stamp_ns >= self.origin_ns:
                take(tick)

    def _take(self, message: Message) -> None:
        if message.sent_ns < self._reset_ns:
            behind_ns = self._reset_ns - message.sent_ns
            if (
                self._released
                and message.topic == self._topics.command
                and behind_ns > _LATE_NS
            ):
                self._behind_ns = behind_ns
            return
        self._bytes[message.topic] += len(message.data)
        self._waiting += len(message.data)
        if message.topic != self._topics.clock:
            self.commands += message.topic == self._topics.command
            self._sequencer.add(message)
            return
        self.now_ns = decode.clock(message.data)
        self.ticks += 1
        if self._sequencer.tick(self.now_ns, message.sent_ns):
            self._sequencer.add(message)
        if self._released and self.origin_ns is None:
            self.origin_ns = self.now_ns

    def _take_heard(self, message: Message) -> None:
        """Take a message that came by DDS while the readings come by the channel: a tick only shows how far DDS is."""
        if message.topic != self._topics.clock:
            self._take(message)
            return
        with suppress(MessageError):  # anybody can publish there
            stamp_ns = decode.clock(message.data)
            self._heard_ns = max(self._heard_ns, stamp_ns)
            self._sequencer.hear(stamp_ns)
