"""Processes that compute and draw the parts of a report at the same time."""

import itertools
import os
import signal
import threading
from collections.abc import Callable, Sequence
from concurrent.futures import ProcessPoolExecutor
from concurrent.futures.process import BrokenProcessPool
from multiprocessing import get_context, parent_process
from typing import Any

from barn_eval.pages import Progress
from barn_worlds.base.errors import BarnError

_MOST = 8  # a report has few parts that take long
_jobs: Sequence[Callable[[], Any]] = ()


def run_forked(jobs: Sequence[Callable[[], Any]], progress: Progress) -> list[Any]:
    """Return what each job returns, done by forks of this process, one per core; they end with it, if it is killed too.

    They inherit the jobs and all that these refer to: only what is returned is pickled. progress: gets the share that
    is done. BarnError where one of them was killed.
    """
    done = itertools.count(1)
    count = min(len(os.sched_getaffinity(0)), _MOST)
    pool = ProcessPoolExecutor(
        count, mp_context=get_context("fork"), initializer=_begin, initargs=(jobs,)
    )
    try:
        made = [pool.submit(_do, place) for place in range(len(jobs))]
        for one in made:
            one.add_done_callback(lambda _: progress(next(done) / len(jobs)))
        return [one.result() for one in made]
    except BrokenProcessPool:
        raise BarnError(
            "a process that computed a part of the report was killed; was there enough memory?"
        ) from None
    finally:
        pool.shutdown(cancel_futures=True)


def _begin(jobs: Sequence[Callable[[], Any]]) -> None:
    global _jobs  # noqa: PLW0603 (a fork's own)
    _jobs = jobs
    signal.signal(signal.SIGINT, signal.SIG_DFL)  # no traceback of each at Ctrl-C
    threading.Thread(target=_end_with_parent, daemon=True).start()


def _do(place: int) -> Any:
    return _jobs[place]()


def _end_with_parent() -> None:
    parent = parent_process()
    assert parent is not None
    parent.join()
    os._exit(1)
