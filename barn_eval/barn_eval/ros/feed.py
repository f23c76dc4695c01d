"""The messages of one trial on their way from the inbox to the judge and the bag."""

from collections.abc import Callable, Mapping

from barn_eval.ros.inbox import Inbox
from barn_eval.ros.instants import Instant, Message, Timeline
from barn_eval.ros.watch import StampCheck
from barn_worlds.messages import decode
from barn_worlds.ros.topics import message_class


class Feed:
    """Puts what arrives into instants, from the reset of the simulator on.

    origin_ns: simulated time at which the trial begins, None until it is known: a reset moves the clock on and leaves
    it there until the release. now_ns: simulated time. ticks, commands: how many have arrived since the reset.
    stamps: what the planner's stamps tell of its idea of time.
    """

    def __init__(self, inbox: Inbox, clock_topic: str, command_topic: str, reset_ns: int) -> None:
        self.origin_ns: int | None = None
        self.now_ns = 0
        self.ticks = 0
        self.commands = 0
        self.stamps = StampCheck()
        self._stamped: set[str] = set()
        self._inbox = inbox
        self._clock_topic = clock_topic
        self._command_topic = command_topic
        self._reset_ns = reset_ns
        self._released = False
        self._timeline = Timeline()

    def read(self) -> None:
        """Take in what has arrived."""
        self._inbox.read(self._take)

    def check_stamps(self, topics: Mapping[str, str]) -> None:
        """Look at the stamps of topics, given by name and type, so far as their messages begin with a header."""
        for topic, type_name in topics.items():
            kind = message_class(type_name)
            if kind is not None and [*kind.get_fields_and_field_types().values()][:1] == ["std_msgs/Header"]:
                self._stamped.add(topic)

    def release(self) -> None:
        """Note that from now on the simulated time runs."""
        self.read()
        self._released = True
        self.origin_ns = self._timeline.latest_ns

    def hand_over(self, take: Callable[[Instant], None], *, all_of_it: bool = False) -> None:
        """Hand on the instants that are complete, or all that there are; none before the release."""
        if not self._released:
            return
        for instant in self._timeline.rest() if all_of_it else self._timeline.complete():
            if self.origin_ns is not None and instant.stamp_ns >= self.origin_ns:
                take(instant)

    def _take(self, message: Message) -> None:
        if message.sent_ns < self._reset_ns:
            return
        if message.topic == self._clock_topic:
            self._tick(message)
        else:
            self.commands += message.topic == self._command_topic
            self._timeline.add(message)
            if self._released and message.topic in self._stamped and self.stamps.wants(message.topic):
                self.stamps.take(message.topic, decode.header(message.data).stamp_ns, self.now_ns)

    def _tick(self, message: Message) -> None:
        self.now_ns = decode.clock(message.data)
        self.ticks += 1
        if self._timeline.tick(self.now_ns, message.sent_ns):
            self._timeline.add(message)
        if self._released and self.origin_ns is None:
            self.origin_ns = self.now_ns
