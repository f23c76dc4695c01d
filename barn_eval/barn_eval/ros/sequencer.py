"""Putting messages of several topics, received in any order, into the order in which they were published.

DDS keeps order within a topic only, and some messages of a robot carry no stamp (commands, contacts). But each comes
with the time at which it was sent, by the clock of the one host that everything runs on, and the simulator publishes
/clock before all else of one simulated time. So what was sent between two ticks of /clock belongs to the first of them.
"""

import math
from bisect import bisect_right, insort_left, insort_right
from collections import deque
from collections.abc import Iterator
from dataclasses import dataclass, field
from itertools import islice, pairwise
from operator import attrgetter


@dataclass(frozen=True, slots=True)
class Message:
    """A serialised message; `sent_ns` is the wall-clock time at which it was sent."""

    topic: str
    data: bytes
    sent_ns: int


@dataclass(frozen=True, slots=True)
class Tick:
    """What was published at one simulated time, in the order of sending."""

    stamp_ns: int
    sent_ns: int
    messages: list[Message] = field(default_factory=list)


class TickSequencer:
    """Sort messages by the ticks of /clock; those that were sent before the first tick belong to that.

    A tick is complete when the tick after the next scan's has begun: a command is handed to the simulator and to the
    recorder one after the other, so that ticks may overtake it, but in lockstep none beyond the next scan, which the
    planner has to answer before. There is none while a planner is charged for its computing.

    scan: the topic. fenced: ticks come by a faster way than other messages, so that a later tick shows only what is
    complete once it has been heard by theirs as well.
    """

    def __init__(self, scan: str, *, fenced: bool = False) -> None:
        self._scan, self._fenced = scan, fenced
        self._heard_ns = -math.inf
        self._open: deque[Tick] = deque()
        self._early: list[Message] = []

    @property
    def latest_ns(self) -> int | None:
        """The simulated time now, None before the first tick."""
        return self._open[-1].stamp_ns if self._open else None

    def tick(self, stamp_ns: int, sent_ns: int) -> bool:
        """Take a message of /clock and tell whether it begins a tick: one that repeats the time does not."""
        if stamp_ns == self.latest_ns:
            return False
        self._open.append(Tick(stamp_ns, sent_ns))
        while self._early:
            self.add(self._early.pop(0))
        return True

    def hear(self, stamp_ns: int) -> None:
        """Note a tick that came by the way of the other messages; one that is yet to come counts as the last."""
        if self._open:
            self._heard_ns = min(stamp_ns, self._open[-1].stamp_ns)

    def add(self, message: Message) -> None:
        """Take any other message."""
        if not self._open:
            self._early.append(message)
            return
        index = bisect_right(self._open, message.sent_ns, key=attrgetter("sent_ns"))
        # A message on the last open tick may belong to one that has not arrived: _settle looks again.
        insort_right(
            self._open[max(index - 1, 0)].messages, message, key=attrgetter("sent_ns")
        )

    def complete(self) -> Iterator[Tick]:
        """Yield the ticks to which nothing can come any more, oldest first."""
        self._settle()
        while (shows := self._after_scan()) and (
            not self._fenced or shows.stamp_ns <= self._heard_ns
        ):
            yield self._open.popleft()

    def rest(self) -> Iterator[Tick]:
        """Yield all ticks that are left, the last of which may lack something."""
        self._settle()
        while self._open:
            yield self._open.popleft()

    def _after_scan(self) -> Tick | None:
        """Return the tick after the first later one with a scan."""
        later = pairwise(islice(self._open, 1, None))
        return next(
            (
                after
                for tick, after in later
                if any(one.topic == self._scan for one in tick.messages)
            ),
            None,
        )

    def _settle(self) -> None:
        """Move messages on that were taken before the tick that they belong to, in order."""
        for earlier, later in zip(list(self._open), list(self._open)[1:], strict=False):
            while earlier.messages and earlier.messages[-1].sent_ns >= later.sent_ns:
                insort_left(
                    later.messages, earlier.messages.pop(), key=attrgetter("sent_ns")
                )
