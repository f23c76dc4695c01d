"""Processes that compute and draw the parts of a report at the same time."""

import itertools
import os
import signal
import threading
from collections.abc import Callable, Iterator
from concurrent.futures import Executor, Future, ProcessPoolExecutor
from concurrent.futures.process import BrokenProcessPool
from contextlib import contextmanager
from multiprocessing import get_context, parent_process
from typing import Any

from barn_eval.pages import Progress
from barn_worlds.base.errors import BarnError

_MOST = 8  # a report has few parts that take long


@contextmanager
def workers() -> Iterator[Executor]:
    """Have forks of this process, one per core, begun now; they end with the block, or if this process is killed.

    Raises BarnError where one of them was killed.
    """
    count = min(len(os.sched_getaffinity(0)), _MOST)
    pool = ProcessPoolExecutor(count, mp_context=get_context("fork"), initializer=_begin)
    try:
        pool.submit(int)  # starts all of them
        yield pool
    except BrokenProcessPool:
        raise BarnError("a process that computed a part of the report was killed; was there enough memory?") from None
    finally:
        pool.shutdown(cancel_futures=True)


def tally(jobs: int, progress: Progress) -> Callable[[Future[Any]], None]:
    """Return what tells the share of so many jobs that is done, to be called at the end of each."""
    done = itertools.count(1)
    return lambda _: progress(next(done) / jobs)


def _begin() -> None:
    signal.signal(signal.SIGINT, signal.SIG_DFL)  # no traceback of each at Ctrl-C
    threading.Thread(target=_end_with_parent, daemon=True).start()
    import scipy.stats  # noqa: F401, PLC0415 (takes half a second, in which the parent reads the trials)


def _end_with_parent() -> None:
    parent = parent_process()
    assert parent is not None
    parent.join()
    os._exit(1)
