"""How fast this computer is, by a fixed loop, and what a planner's cycle takes of it.

The reference computer does the loop in `NOMINAL_S`, as the cores at 2 to 3 GHz do on which the figures of the
documentation were made. The pace of a machine makes times on the reference computer of times measured on it.
"""

import resource
import time
from functools import cache

import numpy as np

NOMINAL_S = 0.006
_REPEATS = 7


def reference_loop() -> float:
    """Do a fixed amount of work as planners have it, plain Python and small arrays, and return its result."""
    total, ranges = 0.0, np.linspace(0.1, 10.0, 720)
    for k in range(1600):
        near = np.minimum(ranges, 1.0 + 0.0025 * k)
        total += float(near @ ranges) + sum(i * 0.5 for i in range(60))
    return total


@cache
def pace() -> float:
    """Return reference seconds per second of this processor, measured once per process: above 1 on a faster one."""
    taken = []
    for _ in range(_REPEATS):
        began = time.thread_time()
        reference_loop()
        taken.append(time.thread_time() - began)
    return NOMINAL_S / max(min(taken), 1e-6)


class Stopwatch:
    """Times what this thread does from the moment that it is made.

    That is the processor's time, so that other work on the machine costs nothing; but the wall clock's where the thread
    gave its processor away to wait: for a graphics card, another thread, a sleep.
    """

    def __init__(self) -> None:
        self._waits = _waits()
        self._wall_s, self._used_s = time.perf_counter(), time.thread_time()

    def elapsed_s(self) -> float:
        """Return the time so far."""
        used_s, wall_s = time.thread_time() - self._used_s, time.perf_counter() - self._wall_s
        return wall_s if _waits() > self._waits else min(used_s, wall_s)


def _waits() -> int:
    return resource.getrusage(resource.RUSAGE_THREAD).ru_nvcsw
