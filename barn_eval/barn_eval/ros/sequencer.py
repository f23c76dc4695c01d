"""Puts messages of several topics into the order of publication.

DDS keeps the order within a topic only, and some messages of a robot carry no stamp
(commands, contacts). But each comes with the time at which it was sent, by the clock of
the one host that everything runs on, and the simulator publishes /clock before all else
of a simulated time. So a message sent between two ticks of /clock belongs to the first.
"""

import math
from bisect import bisect_right, insort_left, insort_right
from collections import deque
from collections.abc import Collection, Iterator
from dataclasses import dataclass, field
from itertools import islice, pairwise
from operator import attrgetter

_SENT_NS = attrgetter("sent_ns")
# Ticks that wait for the command of the oldest one.
_MOST_OPEN_TICKS = 200


@dataclass(frozen=True, slots=True)
class Message:
    """A serialized message."""

    topic: str
    data: bytes
    # Wall-clock time of sending.
    sent_ns: int


@dataclass(frozen=True, slots=True)
class Tick:
    """The messages of one simulated time, in the order of sending."""

    # Simulated time.
    stamp_ns: int
    # Wall-clock time at which the tick of /clock was sent.
    sent_ns: int
    messages: list[Message] = field(default_factory=list)


class TickSequencer:
    """Sorts messages by the ticks of /clock; early ones belong to the first tick.

    A tick is complete when the tick after the next scan's has begun: a command is
    handed to the simulator and to the recorder one after the other, so ticks may
    overtake it. In lockstep none goes beyond the next scan, which the planner has to
    answer before. No scan comes while a planner is charged for its computing. A planner
    with a rate of its own does not answer each scan, so of its ticks those with an
    answer are known.
    """

    def __init__(
        self,
        scan_topic: str,
        *,
        fenced: bool = False,
        command_topic: str = "",
        answered_ns: Collection[int] = (),
    ):
        """Start without a tick.

        Args:
            scan_topic: Name of the topic of scans.
            fenced: Ticks arrive faster than other messages. A later tick then shows
                only that ticks up to `acknowledge` are complete.
            command_topic: Name of the topic of commands.
            answered_ns: Simulated times of ticks that need a command to be complete;
                it may grow.
        """
        self._scan_topic = scan_topic
        self._command_topic = command_topic
        self._answered_ns = answered_ns
        # Without a fence, every tick counts as acknowledged.
        self._acknowledged_ns = -math.inf if fenced else math.inf
        self._open: deque[Tick] = deque()
        self._early: list[Message] = []

    @property
    def latest_ns(self) -> int | None:
        """Simulated time (ns) of the newest tick still held, None if none is held."""
        if not self._open:
            return None
        return self._open[-1].stamp_ns

    def tick(self, stamp_ns: int, sent_ns: int) -> bool:
        """Begin a tick if its time is new, with early messages; return whether it is.

        Args:
            stamp_ns: The simulated time that the tick tells.
            sent_ns: Wall-clock time at which it was sent.

        Returns:
            Whether it begins a tick; one that repeats the time does not.
        """
        if stamp_ns == self.latest_ns:
            return False
        self._open.append(Tick(stamp_ns, sent_ns))
        while self._early:
            self.add(self._early.pop(0))
        return True

    def acknowledge(self, stamp_ns: int) -> None:
        """Store up to which simulated time (ns), at most the last tick's, DDS has come.

        Anybody can publish a tick of the future; it counts as the last one.
        """
        if self._open:
            self._acknowledged_ns = min(stamp_ns, self._open[-1].stamp_ns)

    def add(self, message: Message) -> None:
        """Put a message into the tick in which it was sent, or keep it for one."""
        if not self._open:
            self._early.append(message)
            return
        # A message on the last open tick may belong to one that has not arrived:
        # `_settle` moves it on.
        place = bisect_right(self._open, message.sent_ns, key=_SENT_NS)
        tick = self._open[max(place - 1, 0)]
        insort_right(tick.messages, message, key=_SENT_NS)

    def pop_complete(self) -> Iterator[Tick]:
        """Remove and yield the ticks that can get no more messages, oldest first."""
        self._settle()
        while self._first_is_complete():
            yield self._open.popleft()

    def pop_all(self) -> Iterator[Tick]:
        """Remove and yield all ticks, oldest first; the last may lack messages."""
        self._settle()
        while self._open:
            yield self._open.popleft()

    def _first_is_complete(self) -> bool:
        """Return whether later ticks show that the oldest can get no more messages."""
        if len(self._open) <= _MOST_OPEN_TICKS and self._lacks_command():
            return False
        for tick, next_tick in pairwise(islice(self._open, 1, None)):
            if any(message.topic == self._scan_topic for message in tick.messages):
                return next_tick.stamp_ns <= self._acknowledged_ns
        return False

    def _lacks_command(self) -> bool:
        """Return whether the oldest tick has an answer that has not arrived yet."""
        if not self._open or self._open[0].stamp_ns not in self._answered_ns:
            return False
        messages = self._open[0].messages
        return all(message.topic != self._command_topic for message in messages)

    def _settle(self) -> None:
        """Move messages that were sent after the next tick began on to that tick."""
        for tick, next_tick in pairwise(self._open):
            while tick.messages and tick.messages[-1].sent_ns >= next_tick.sent_ns:
                insort_left(next_tick.messages, tick.messages.pop(), key=_SENT_NS)
