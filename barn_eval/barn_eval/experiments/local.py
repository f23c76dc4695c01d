"""Workers on this machine, one process each.

Executors of the standard library and loky give up all jobs when one process dies. Here each worker has a pipe of its
own: if it is killed, hangs or crashes, its own job is lost, a new process takes its place and nobody else notices.
"""

from __future__ import annotations

import multiprocessing
import os
import pickle
import signal
import threading
import time
from collections.abc import Iterator
from contextlib import contextmanager, suppress
from multiprocessing.connection import Connection, wait
from typing import Any

from barn_eval.experiments.engine import ENVIRONMENT, Engine, Lost, Part, Report, Work, attempt, reported

# Time that workers have to end what they have started (nodes of ROS trials) before they are killed.
GRACE_S = 20.0
_SPAWN = multiprocessing.get_context("spawn")


class LocalEngine(Engine):
    """Processes on this machine, started when first needed.

    A job, or part of one, that exceeds the limit costs its worker's life.
    """

    def __init__(self, work: Work, workers: int, trial_limit_s: float) -> None:
        self._work = work
        self._limit_s = trial_limit_s
        self._workers: list[_Worker | None] = [None] * workers

    @property
    def slots(self) -> int:
        """Number of workers."""
        return len(self._workers)

    def submit(self, key: str, job: Any) -> None:
        """Hand a job to an idle worker."""
        number = next(n for n, worker in enumerate(self._workers) if worker is None or worker.key is None)
        worker = self._workers[number]
        if worker is not None and not worker.submit(key, job, self._limit_s):
            worker.kill()
            worker = None
        if worker is None:
            worker = self._workers[number] = _Worker(f"local-{number}", self._work)
            # Should it die at once, the pipe is broken already; that shows when waiting for it.
            worker.submit(key, job, self._limit_s)

    def wait(self, limit_s: float) -> list[Report]:
        """Return what workers have reported, and the loss of those that died or exceeded their time."""
        busy = {worker.connection: worker for worker in self._workers if worker is not None and worker.key is not None}
        first = min((worker.deadline for worker in busy.values()), default=0.0)
        ready = wait(list(busy), max(0.0, min(limit_s, first - time.monotonic())))
        reports = []
        for connection, worker in busy.items():
            if connection in ready:
                reports.append(worker.report(self._limit_s))
            elif time.monotonic() >= worker.deadline:
                reports.append(worker.give_up(f"no result within {self._limit_s:g} s of wall-clock time"))
        self._workers = [None if worker is not None and worker.dead else worker for worker in self._workers]
        return reports

    def close(self) -> None:
        """Ask all workers to end, and kill those that do not within their time."""
        workers = [worker for worker in self._workers if worker is not None]
        self._workers = [None] * len(self._workers)
        for worker in workers:
            worker.ask_to_end()
        deadline = time.monotonic() + GRACE_S
        for worker in workers:
            worker.process.join(max(0.0, deadline - time.monotonic()))
            worker.kill()


class _Worker:
    """The parent's view of a worker: its process, the pipe to it and the job it has."""

    def __init__(self, name: str, work: Work) -> None:
        self.name = name
        self.key: str | None = None
        self.deadline = 0.0
        self.dead = False
        self.connection, theirs = _SPAWN.Pipe()
        self.process = _SPAWN.Process(target=_serve, args=(theirs, work), name=f"barn {name}", daemon=True)
        with _environment(), _interrupts_held():
            self.process.start()
        theirs.close()

    def submit(self, key: str, job: Any, limit_s: float) -> bool:
        """Send a job and return whether the worker was there to take it."""
        self.key, self.deadline = key, time.monotonic() + limit_s
        try:
            self.connection.send(job)
        except OSError:
            return False
        return True

    def report(self, limit_s: float) -> Report:
        """Receive a report on the job, which is there or will never come; after a part, the limit counts anew."""
        key = self._take_key()
        try:
            content = self.connection.recv()
        except (EOFError, OSError, pickle.UnpicklingError):
            self.kill()
            return Lost(key, self.name, f"its worker process {_ending(self.process.exitcode)}")
        report = reported(key, self.name, content)
        if isinstance(report, Part):
            self.key, self.deadline = key, time.monotonic() + limit_s
        return report

    def give_up(self, reason: str) -> Report:
        """End the worker because of its job."""
        key = self._take_key()
        self.process.terminate()
        self.process.join(GRACE_S)
        self.kill()
        return Lost(key, self.name, reason, overtime=True)

    def ask_to_end(self) -> None:
        """Let an idle worker return, and interrupt one that has a job."""
        if self.key is None:
            with suppress(OSError):
                self.connection.send(None)
        else:
            self.process.terminate()

    def kill(self) -> None:
        """End the process, if it has not, and forget it."""
        self.dead = True
        self.connection.close()
        self.process.join(0.2)  # a worker whose pipe has closed is about to die by itself, with its own exit code
        self.process.kill()
        self.process.join()

    def _take_key(self) -> str:
        key, self.key = self.key, None
        if key is None:
            raise RuntimeError(f"{self.name} has no job")
        return key


def _serve(connection: Connection, work: Work) -> None:
    """Be a worker: do jobs until None comes, or the parent is gone."""
    signal.signal(signal.SIGINT, signal.SIG_IGN)  # Ctrl-C reaches all processes; the parent decides
    signal.pthread_sigmask(signal.SIG_UNBLOCK, [signal.SIGINT])
    signal.signal(signal.SIGTERM, _exit)
    threading.Thread(target=_outlive_no_parent, daemon=True).start()
    try:
        while (job := connection.recv()) is not None:
            connection.send(attempt(work, job, connection.send))
    except (EOFError, OSError):
        return  # the parent is gone
    finally:
        work.close()


def _exit(_signal: int, _frame: object) -> None:
    signal.signal(signal.SIGTERM, signal.SIG_IGN)
    raise SystemExit(128 + signal.SIGTERM)


def _outlive_no_parent() -> None:
    """End this worker, job or not, when the campaign's process has been killed."""
    parent = multiprocessing.parent_process()
    if parent is not None:
        parent.join()
        os.kill(os.getpid(), signal.SIGTERM)
        time.sleep(GRACE_S)
        os._exit(1)


def _ending(code: int | None) -> str:
    """Return in words how a process has ended."""
    if code is not None and code < 0:
        return f"was killed by {signal.Signals(-code).name}"
    return f"ended with exit code {code}"


@contextmanager
def _environment() -> Iterator[None]:
    """Give a process that is started in the context the environment of workers."""
    before = {name: os.environ.get(name) for name in ENVIRONMENT}
    os.environ.update(ENVIRONMENT)
    try:
        yield
    finally:
        for name, value in before.items():
            if value is None:
                del os.environ[name]
            else:
                os.environ[name] = value


@contextmanager
def _interrupts_held() -> Iterator[None]:
    """Keep Ctrl-C from a process started in the context until it has made up its mind about it."""
    before = signal.pthread_sigmask(signal.SIG_BLOCK, [signal.SIGINT])
    try:
        yield
    finally:
        signal.pthread_sigmask(signal.SIG_SETMASK, before)
