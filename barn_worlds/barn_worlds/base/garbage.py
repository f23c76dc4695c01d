"""Garbage collection in programs of the suite."""

import atexit
import gc


def reduce_garbage_collection() -> None:
    """Let this process collect garbage less often, and not as it ends.

    Call it in programs, not in libraries. Otherwise a quarter of the time that a
    program takes to start and end goes into looking again and again at the definitions
    of libraries, which stay to the end anyway.
    """
    gc.set_threshold(10_000)
    # What is frozen is left out of the collection at the end of the process.
    atexit.register(gc.freeze)
