"""How often a program of the suite looks for garbage."""

import atexit
import gc


def reduce_garbage_collection() -> None:
    """Let this process collect garbage less often, and not once more as it ends.

    For programs, not for libraries: a quarter of the time that one takes to start and to end would go into looking
    again and again at what libraries have defined, which stays to the end anyway.
    """
    gc.set_threshold(10_000)
    atexit.register(gc.freeze)
