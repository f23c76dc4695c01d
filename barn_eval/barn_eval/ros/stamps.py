"""Stamps far from the simulated time: the mark of a node that does not take the time from /clock."""

from __future__ import annotations

from barn_worlds.types import nanoseconds, seconds

TOLERANCE_S = 60.0  # a planner may stamp what is to come, and a slow one what is long past
_TOLERANCE_NS = nanoseconds(TOLERANCE_S)


class StampCheck:
    """Look at the first stamped message of each topic of a planner.

    A stamp of 0 says nothing: many planners leave it out.
    """

    def __init__(self) -> None:
        self._seen: set[str] = set()
        self._fault = ""

    def wants(self, topic: str) -> bool:
        """Tell whether no message of a topic has been looked at yet."""
        return topic not in self._seen

    def take(self, topic: str, stamp_ns: int, now_ns: int) -> None:
        """Look at a stamp, the simulated time being `now_ns`."""
        self._seen.add(topic)
        if stamp_ns and abs(stamp_ns - now_ns) > _TOLERANCE_NS and not self._fault:
            stamp, now = seconds(stamp_ns), seconds(now_ns)
            self._fault = f"{topic} is stamped {stamp:.1f} s while /clock shows {now:.1f} s: use_sim_time is off"

    def text(self) -> str:
        """Return what is wrong in one line, an empty text where nothing is."""
        return self._fault
