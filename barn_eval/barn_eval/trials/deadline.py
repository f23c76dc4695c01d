"""A limit on how long a call may take, so that a planner that hangs cannot hang everything; signals for a while."""

from __future__ import annotations

import signal
import threading
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from types import FrameType


@contextmanager
def handled(number: int, handler: Callable[[int, FrameType | None], None]) -> Iterator[bool]:
    """Handle a signal while the context lasts and give whether that is so: only the main thread can."""
    if threading.current_thread() is not threading.main_thread():
        yield False
        return
    before = signal.signal(number, handler)
    try:
        yield True
    finally:
        signal.signal(number, before)


class DeadlineError(BaseException):
    """The limit has passed; not an Exception, so that a planner that catches those does not swallow it."""


class Deadline:
    """Raise DeadlineError in calls that take longer than the limit.

    limit_s may be changed and holds from the next call on. Works by an interval timer: in the main thread only
    (elsewhere nothing is limited), and in compiled code not before it returns.
    """

    def __init__(self, limit_s: float) -> None:
        self.limit_s = limit_s
        self._armed = False

    @contextmanager
    def installed(self) -> Iterator[Deadline]:
        """Take over the alarm signal, and give it back at the end."""
        with handled(signal.SIGALRM, self._expired) as armed:
            self._armed = armed
            try:
                yield self
            finally:
                self.__exit__()
                self._armed = False

    def __enter__(self) -> None:
        """Begin to count."""
        if self._armed:
            signal.setitimer(signal.ITIMER_REAL, self.limit_s)

    def __exit__(self, *error: object) -> None:
        """Stop counting."""
        if self._armed:
            signal.setitimer(signal.ITIMER_REAL, 0.0)

    def _expired(self, _signal: int, _frame: FrameType | None) -> None:
        raise DeadlineError
