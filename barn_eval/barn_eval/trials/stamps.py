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
        self._first_arrival_ns = self.last_arrival_ns = arrival_ns

    @property
    def shows_clock(self) -> bool:
        """Whether the stamps span too much time to be isolated wrong ones."""
        return self._last_ns - self._first_ns > _TOLERANCE_NS

    def extend(self, stamp_ns: int, arrival_ns: int) -> bool:
        """Add a stamp if it fits those before; return whether it does."""
        arrived_ns = max(self.last_arrival_ns - self._first_arrival_ns, _TOLERANCE_NS)
        # A simulator may be faster than real time. Stamps may also arrive late.
        pace = max(1.0, (self._last_ns - self._first_ns) / arrived_ns)
        most_ns = _TOLERANCE_NS + 2.0 * pace * (arrival_ns - self.last_arrival_ns)
        step_ns = stamp_ns - self._last_ns
        if not 0 <= step_ns <= min(most_ns, _LONGEST_GAP_NS):
            return False
        self._last_ns = stamp_ns
        self.last_arrival_ns = arrival_ns
        return True


def number_clocks(stamps_ns: Integers, arrivals_ns: Integers) -> Integers:
    """Return for each stamp (n,) which clock it is of, counted from 0, or -1 if wrong.

    Isolated stamps that do not fit are wrong, also the first ones.

    Args:
        stamps_ns: Stamps (n,) in the order of arrival.
        arrivals_ns: Ascending times (n,) of arrival by another clock, such as the log's.
    """
    clocks = np.full(len(stamps_ns), -1)
    number = first = 0
    series: StampSeries | None = None
    doubtful: StampSeries | None = None
    for index, times in enumerate(np.column_stack([stamps_ns, arrivals_ns]).tolist()):
        if series is not None and series.extend(*times):
            clocks[index] = number
            doubtful = None
            continue
        if doubtful is None or not doubtful.extend(*times):
            doubtful = StampSeries(*times)
            first = index
        if series is None or doubtful.shows_clock:
            if series is not None and series.shows_clock:
                number += 1
            else:
                clocks[:] = -1
            series = doubtful
            clocks[first : index + 1] = number
    return clocks
