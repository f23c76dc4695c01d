"""Compute and draw the parts of a report in parallel processes."""

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

# A report has few parts that take long.
_MAX_PROCESSES = 8
_jobs: Sequence[Callable[[], Any]] = ()


def run_forked(jobs: Sequence[Callable[[], Any]], progress: Progress) -> list[Any]:
    """Run jobs in up to 8 forks; return results in order; BarnError if one is killed.

    Forks inherit the jobs and everything that these refer to, so only results are
    pickled. They end with this process, even if it is killed.

    Args:
        jobs: What to run.
        progress: Receives the share that is done, from 0 to 1.

    Returns:
        What each job returns, in their order.

    Raises:
        BarnError: A fork was killed.
    """
    finished_count = itertools.count(1)
    processes = min(len(os.sched_getaffinity(0)), _MAX_PROCESSES)
    pool = ProcessPoolExecutor(
        processes,
        # Entries with all their tracks are large, and a spawned process would have to
        # be sent them.
        mp_context=get_context("fork"),
        initializer=_initialize_fork,
        initargs=(jobs,),
    )
    try:
        # Only a number crosses to the fork, which has the job already.
        futures = [pool.submit(_run_job, position) for position in range(len(jobs))]
        for future in futures:
            future.add_done_callback(
                lambda _: progress(next(finished_count) / len(jobs))
            )
        return [future.result() for future in futures]
    except BrokenProcessPool:
        raise BarnError(
            "a process that computed a part of the report was killed, probably because memory ran out"
        ) from None
    finally:
        pool.shutdown(cancel_futures=True)


def _initialize_fork(jobs: Sequence[Callable[[], Any]]) -> None:
    """Keep the jobs in a new fork, let Ctrl-C end it, and watch its parent."""
    global _jobs  # noqa: PLW0603 (each fork has its own)
    _jobs = jobs
    # Else each fork would print a traceback at Ctrl-C.
    signal.signal(signal.SIGINT, signal.SIG_DFL)
    threading.Thread(target=_exit_with_parent, daemon=True).start()


def _run_job(position: int) -> Any:
    """Run the job at this position, from 0, and return its result."""
    return _jobs[position]()


def _exit_with_parent() -> None:
    """Wait until the parent process ends, then end this fork at once."""
    parent = parent_process()
    assert parent is not None
    parent.join()
    # sys.exit would end no more than this thread.
    os._exit(1)
