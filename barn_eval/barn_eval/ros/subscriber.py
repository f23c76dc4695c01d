"""Raw subscriptions that are read in bulk, and the queue of a trial's messages.

A trial in lockstep brings some thousand messages a second. Reading them in bulk costs a
quarter of what the executor's callbacks would, and that processor time belongs to the
simulator and the planner.
"""

import math
from collections import Counter
from collections.abc import Callable, Collection
from contextlib import suppress
from dataclasses import dataclass, replace
from typing import Any

from rclpy.callback_groups import CallbackGroup
from rclpy.node import Node
from rclpy.subscription import Subscription

from barn_eval.ros.adapter import TrialTopics
from barn_eval.ros.evaluator_loop import TrialEnded
from barn_eval.ros.sequencer import Message, Tick, TickSequencer
from barn_eval.ros.simulator import SimulatorChannel
from barn_eval.trials.result import Outcome
from barn_worlds.base.errors import MessageError
from barn_worlds.base.types import seconds
from barn_worlds.messages import decode
from barn_worlds.messages.topics import LATCHED, RELIABLE, Qos
from barn_worlds.ros.topics import find_message_class, qos_profile

_TICKS_PER_ACKNOWLEDGMENT = 2
# Messages of a topic that may wait to be read: several seconds in lockstep for topics
# that are judged, fewer for topics that are only recorded.
_JUDGED_DEPTH = 2000
_RECORDED_DEPTH = 256
# Messages beyond these limits are more than can be read or kept: bytes read at a time,
# bytes that wait for their tick to be complete, bytes of a whole trial, and the number
# of consecutive reads that end at the first limit.
_READ_BYTES = 32 << 20
_WAITING_BYTES = 512 << 20
_TRIAL_BYTES = 4 << 30
_MAX_FULL_READS = 20
# Delay of a command of the trial before, on a busy machine.
_LATE_NS = 1_000_000_000


class PolledGroup(CallbackGroup):
    """A group whose entities no executor touches: the evaluator reads them."""

    def can_execute(self, *_: object) -> bool:
        """Return False, so that no executor takes messages of the group."""
        return False


@dataclass
class _Topic:
    """A topic that is judged or recorded."""

    type_name: str
    qos: Qos = RELIABLE
    # None where its messages come from elsewhere.
    subscription: Subscription | None = None
    # The last message of a latched topic.
    last: Message | None = None


class Subscriber:
    """All topics that are judged or recorded.

    It keeps latched messages: they are sent only once, and every bag needs them.
    """

    def __init__(self, node: Node):
        """Begin without topics; `node` makes the subscriptions."""
        # Consecutive reads that could not take all messages.
        self.full_reads = 0
        # Whether messages count from their arrival here, as where a system has clocks
        # of its own, and not from when they were sent.
        self.by_arrival = False
        self._node = node
        self._group = PolledGroup()
        self._topics: dict[str, _Topic] = {}

    def subscribe(
        self, name: str, type_name: str, qos: Qos = RELIABLE, *, judged: bool = True
    ) -> bool:
        """Subscribe, replacing another type or reliability; False if not installed.

        Args:
            name: Resolved name of the topic.
            type_name: ROS type of its messages.
            qos: Profile of its publishers.
            judged: Whether a trial is judged by it; other topics are only recorded.

        Returns:
            False if the type is not installed.
        """
        topic = self._topics.get(name)
        if topic is not None:
            same_type = topic.type_name == type_name
            if same_type and topic.qos.reliability == qos.reliability:
                return True
        message_type = find_message_class(type_name)
        if message_type is None:
            return False

        if topic is not None and topic.subscription is not None:
            self._node.destroy_subscription(topic.subscription)
        # What is only recorded may be large, such as costmaps, so fewer messages wait.
        depth = _JUDGED_DEPTH if judged else _RECORDED_DEPTH
        # rclpy's stubs do not know raw subscriptions.
        options: dict[str, Any] = {"raw": True, "callback_group": self._group}
        subscription = self._node.create_subscription(
            message_type,
            name,
            # Never called: no executor touches the group, and `read` takes messages.
            lambda _: None,
            qos_profile(replace(qos, depth=depth)),
            **options,
        )
        self._topics[name] = _Topic(type_name, qos, subscription)
        return True

    def provide(self, name: str, type_name: str) -> None:
        """Note a topic that comes by the private line; do not subscribe to it.

        Args:
            name: Resolved name of the topic.
            type_name: ROS type of its messages.
        """
        self._topics[name] = _Topic(type_name)

    def topics(self) -> dict[str, str]:
        """Return ROS types by resolved names of subscribed and provided topics."""
        return {name: topic.type_name for name, topic in self._topics.items()}

    def count_publishers(self, name: str) -> float:
        """Return how many publishers are connected; inf if it is not subscribed to."""
        topic = self._topics.get(name)
        if topic is None or topic.subscription is None:
            return math.inf
        return float(topic.subscription.get_publisher_count())

    def read(self, take: Callable[[Message], None]) -> None:
        """Take arrived messages, up to 32 MiB, and hand them to `take`, topic by topic.

        If there are too many, topics that were subscribed to first are read.
        """
        remaining_bytes = _READ_BYTES
        for name, topic in self._topics.items():
            if topic.subscription is None:
                continue
            handle = topic.subscription.handle
            message_type = topic.subscription.msg_type
            with handle:
                while remaining_bytes > 0:
                    # An executor and rclpy.wait_for_message call this, too. rclpy has
                    # no public way without an executor, which takes one message a turn.
                    sample = handle.take_message(message_type, True)
                    if sample is None:
                        break
                    data, info = sample
                    remaining_bytes -= len(data)
                    # The source stamp is the sender's, whose clock may be forged.
                    sent_ns = info["received_timestamp"]
                    if not self.by_arrival:
                        sent_ns = min(info["source_timestamp"], sent_ns)
                    message = Message(name, data, sent_ns)
                    if topic.qos.durability == LATCHED.durability:
                        topic.last = message
                    take(message)
        if remaining_bytes > 0:
            self.full_reads = 0
        else:
            self.full_reads += 1

    def read_latched(self) -> list[Message]:
        """Return the last message that `read` took of each latched topic."""
        topics = self._topics.values()
        return [topic.last for topic in topics if topic.last is not None]


class TrialQueue:
    """Sorts messages by the ticks of /clock, from the reset of the simulator on."""

    def __init__(
        self,
        subscriber: Subscriber,
        topics: TrialTopics,
        reset_ns: int,
        channel: SimulatorChannel | None,
    ):
        """Prepare for the first message after a reset.

        Args:
            subscriber: Brings the messages of topics.
            topics: Names of the topics that the trial is judged by.
            reset_ns: Wall-clock time just before the reset was requested.
            channel: Brings the simulator's readings; None where they come by topics.
        """
        # Simulated time at which the trial begins, once it is known: a reset leaves
        # the clock there until the release.
        self.origin_ns: int | None = None
        # The simulated time, and how many ticks and commands came since the reset.
        self.now_ns = 0
        self.ticks = 0
        self.commands = 0
        self._subscriber = subscriber
        self._topics = topics
        self._channel = channel
        self._reset_ns = reset_ns
        self._released = False
        answered_ns: Collection[int] = ()
        if channel is not None:
            answered_ns = channel.answered_ns
        self._sequencer = TickSequencer(
            topics.scan,
            fenced=channel is not None,
            command_topic=topics.command,
            answered_ns=answered_ns,
        )
        # Latest tick that came by DDS, and the last acknowledgment to the simulator.
        self._dds_tick_ns = 0
        self._acknowledged_ns = 0
        self._acknowledged_ticks = 0
        # Bytes by topic, and how many of them wait to be handed over.
        self._topic_bytes: Counter[str] = Counter()
        self._waiting_bytes = 0
        # How far, at least, the clock that stamped a command is behind.
        self._clock_lag_ns = 0

    def require_bounded(self) -> None:
        """Raise TrialEnded for floods of messages or commands whose clock is behind."""
        is_flooded = (
            self._waiting_bytes > _WAITING_BYTES
            or self._topic_bytes.total() > _TRIAL_BYTES
            or self._subscriber.full_reads > _MAX_FULL_READS
        )
        if is_flooded:
            topic, size = self._topic_bytes.most_common(1)[0]
            raise TrialEnded(
                Outcome.INTERFERENCE,
                f"{size / 1e6:.0f} MB on {topic}, more than the evaluator can read",
            )
        if self._clock_lag_ns:
            lag_s = seconds(self._clock_lag_ns)
            raise TrialEnded(
                Outcome.INTERFERENCE,
                f"commands are stamped by a clock at least {lag_s:.0f} s behind",
            )

    def read(self) -> None:
        """Take what has arrived; tell a simulator on the line how far DDS is.

        It is told every few ticks, or once it may be waiting for that.
        """
        if self._channel is None:
            self._subscriber.read(self._take)
            return

        ticks_before = self.ticks
        self._channel.read(self._take)
        self._subscriber.read(self._take_from_dds)

        # Anybody can publish ticks of the future.
        dds_tick_ns = min(self._dds_tick_ns, self.now_ns)
        if dds_tick_ns <= self._acknowledged_ns:
            return
        # Without new ticks the simulator may be waiting for the acknowledgment.
        is_idle = self.ticks == ticks_before
        new_ticks = self.ticks - self._acknowledged_ticks
        if is_idle or new_ticks >= _TICKS_PER_ACKNOWLEDGMENT:
            self._acknowledged_ns = dds_tick_ns
            self._acknowledged_ticks = self.ticks
            self._channel.acknowledge(dds_tick_ns)

    def release(self) -> None:
        """Read what waits, and begin the trial at the latest tick, if there is one.

        The simulator itself is not released.
        """
        self.read()
        # What waits until here was sent before simulated time ran.
        self._released = True
        self.origin_ns = self._sequencer.latest_ns

    def hand_over(
        self, take: Callable[[Tick], None], *, incomplete: bool = False
    ) -> None:
        """Pass complete ticks of the trial to `take` in order; none before `release`.

        Args:
            take: Receives the ticks since the trial's beginning.
            incomplete: Hand on all ticks, the last of which may lack something.
        """
        if not self._released:
            return
        sequencer = self._sequencer
        pop = sequencer.pop_all if incomplete else sequencer.pop_complete
        for tick in pop():
            self._waiting_bytes -= sum(len(message.data) for message in tick.messages)
            if self.origin_ns is not None and tick.stamp_ns >= self.origin_ns:
                take(tick)

    def _take(self, message: Message) -> None:
        """Sort a message into its tick; /clock sets the time; drop early ones."""
        if message.sent_ns < self._reset_ns:
            self._take_early(message)
            return

        self._topic_bytes[message.topic] += len(message.data)
        self._waiting_bytes += len(message.data)
        if message.topic != self._topics.clock:
            if message.topic == self._topics.command:
                self.commands += 1
            self._sequencer.add(message)
            return

        self.now_ns = self._read_time(message)
        self.ticks += 1
        if self._sequencer.tick(self.now_ns, message.sent_ns):
            self._sequencer.add(message)
        # If no tick came between reset and release, the next one is the beginning.
        if self._released and self.origin_ns is None:
            self.origin_ns = self.now_ns

    def _read_time(self, message: Message) -> int:
        """Return the simulated time (ns) that a tick tells."""
        return decode.clock(message.data)

    def _take_early(self, message: Message) -> None:
        """Drop a message from before the reset; note a command's lag of over 1 s."""
        lag_ns = self._reset_ns - message.sent_ns
        is_command = message.topic == self._topics.command
        if self._released and is_command and lag_ns > _LATE_NS:
            self._clock_lag_ns = lag_ns

    def _take_from_dds(self, message: Message) -> None:
        """Take a message that came by DDS; of /clock, only note how far DDS is."""
        if message.topic != self._topics.clock:
            self._take(message)
            return
        # Anybody can publish there.
        with suppress(MessageError):
            stamp_ns = decode.clock(message.data)
            self._dds_tick_ns = max(self._dds_tick_ns, stamp_ns)
            self._sequencer.acknowledge(stamp_ns)
