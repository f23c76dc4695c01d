"""Garbage collection in programs of the suite."""

import atexit
import gc


def reduce_garbage_collection() -> None:
    """Make this process collect garbage less often, and not at all when it ends.

    Call it in programs, not in libraries. Otherwise a program spends a quarter of its
    time to start and end on checking the definitions of libraries again and again,
    although they stay to the end.
    """
    gc.set_threshold(10_000)
    # The collection at the end of the process skips frozen objects.
    atexit.register(gc.freeze)
