"""Stamps of poses that others sent: isolated wrong ones, and clocks that were set."""

import numpy as np

from barn_worlds.base.arrays import Integers
from barn_worlds.base.types import NANOSECONDS_PER_SECOND

# A stamp may be this much ahead of its arrival. Stamps that do not fit for longer than
# that show that the clock was set.
_TOLERANCE_NS = NANOSECONDS_PER_SECOND
# Longest time without a pose. Whatever happened in it, such as a clock that was set on
# the computer that records, nothing shows it.
_LONGEST_GAP_NS = 15 * NANOSECONDS_PER_SECOND


class StampSeries:
    """Stamps of one clock, with the times at which they arrived by another one."""

    def __init__(self, stamp_ns: int, arrival_ns: int):
        """Begin with one stamp."""
        self._first_ns = self._last_ns = stamp_ns
        self._first_arrival_ns = self._last_arrival_ns = arrival_ns

    @property
    def shows_clock(self) -> bool:
        """Whether the stamps span too much time to be isolated wrong ones."""
        return self._last_ns - self._first_ns > _TOLERANCE_NS

    def extend(self, stamp_ns: int, arrival_ns: int) -> bool:
        """Add a stamp if it fits those before; return whether it does."""
        arrived_ns = self._last_arrival_ns - self._first_arrival_ns
        stamped_ns = self._last_ns - self._first_ns
        # A simulator may be faster than real time. Stamps may also arrive late.
        pace = max(1.0, stamped_ns / max(arrived_ns, NANOSECONDS_PER_SECOND))
        most_ns = _TOLERANCE_NS + 2.0 * pace * (arrival_ns - self._last_arrival_ns)
        step_ns = stamp_ns - self._last_ns
        if not 0 <= step_ns <= min(most_ns, _LONGEST_GAP_NS):
            return False
        self._last_ns = stamp_ns
        self._last_arrival_ns = arrival_ns
        return True


def split_by_clock(stamps_ns: Integers, arrivals_ns: Integers) -> list[list[int]]:
    """Return the indices of stamps, split where the clock was set.

    Isolated stamps that do not fit are left out. If the first ones do not fit, they are.

    Args:
        stamps_ns: Stamps (n,) in the order of arrival.
        arrivals_ns: Times (n,) of arrival by another clock, such as the log's.
    """
    # Each with the indices of its stamps.
    clocks: list[tuple[StampSeries, list[int]]] = []
    doubtful: tuple[StampSeries, list[int]] | None = None
    # A recorder may write messages out of order.
    arrivals_ns = np.maximum.accumulate(arrivals_ns)
    for index, times in enumerate(np.column_stack([stamps_ns, arrivals_ns]).tolist()):
        if clocks and clocks[-1][0].extend(*times):
            clocks[-1][1].append(index)
            doubtful = None
            continue
        if doubtful is not None and doubtful[0].extend(*times):
            doubtful[1].append(index)
        else:
            doubtful = (StampSeries(*times), [index])
        if not clocks or doubtful[0].shows_clock:
            if clocks and not clocks[-1][0].shows_clock:
                clocks.pop()
            clocks.append(doubtful)
            doubtful = None
    return [indices for _, indices in clocks]
