"""Workers on this machine, one process each.

Executors of the standard library and loky give up all jobs when one process dies. Here each worker has a pipe of its
own: if it is killed, hangs or crashes, its own job is lost, a new process takes its place and nobody else notices.
A worker does not import the user's main script again, as those of multiprocessing do (see `worker`).
"""

import os
import pickle
import signal
import socket
import subprocess
import sys
import time
from contextlib import suppress
from dataclasses import replace
from multiprocessing.connection import Connection, wait
from pathlib import Path

import cloudpickle

from barn_eval.running.engine import ENVIRONMENT, Engine, Lost, Note, Part, Report, Work
from barn_eval.running.worker import GRACE_S
from barn_eval.trials.trial import processor_wait_s
from barn_worlds.base.errors import ConfigError

_LONGEST_GAP_S = 10.0  # between two looks at workers; a longer one is that of a process that was stopped


class LocalEngine(Engine):
    """Processes on this machine, started when first needed, which find modules where this one does.

    A job, or part of one, that exceeds the limit (0: none) costs its worker's life. Raises ConfigError if `work` holds
    something that cannot be handed to another process.
    """

    def __init__(self, work: Work, workers: int, trial_limit_s: float) -> None:
        try:
            self._work = cloudpickle.dumps(work)
        except Exception as error:
            why = f"{type(error).__name__}: {error}"
            raise ConfigError(
                f"a planner cannot be handed to a worker ({why}); workers=1 needs none"
            ) from None
        path = (
            {"PYTHONPATH": os.pathsep.join(map(os.path.abspath, sys.path))}
            if work.loads
            else {}
        )
        self._environment = os.environ | ENVIRONMENT | path
        self._limit_s = trial_limit_s or float("inf")
        self._workers: list[_Worker | None] = [None] * workers
        self._looked_s = time.monotonic()

    @property
    def slots(self) -> int:
        """Number of workers."""
        return len(self._workers)

    def submit(self, key: str, job: object) -> None:
        """Hand a job to an idle worker."""
        number = next(
            n
            for n, worker in enumerate(self._workers)
            if worker is None or worker.key is None
        )
        worker = self._workers[number]
        if worker is not None and not worker.submit(key, job, self._limit_s):
            worker.kill()
            worker = None
        if worker is None:
            worker = self._workers[number] = _Worker(
                f"local-{number}", self._work, self._environment
            )
            # Should it die at once, the pipe is broken already; that shows when waiting for it.
            worker.submit(key, job, self._limit_s)

    def wait(self, limit_s: float) -> list[Report]:
        """Return what workers have reported, and the loss of those that died or exceeded their time."""
        busy = {
            worker.connection: worker
            for worker in self._workers
            if worker is not None and worker.key is not None
        }
        first = min((worker.deadline for worker in busy.values()), default=0.0)
        ready = wait(list(busy), max(0.0, min(limit_s, first - time.monotonic())))
        now_s = time.monotonic()
        gap_s, self._looked_s = now_s - self._looked_s, now_s
        reports = []
        for worker in busy.values():
            worker.stand_still(gap_s, self._limit_s, all_did=gap_s > _LONGEST_GAP_S)
        for connection, worker in busy.items():
            if connection in ready:
                reports.append(worker.report(self._limit_s))
            elif time.monotonic() >= worker.deadline and not worker.has_second_try(
                self._limit_s
            ):
                reports.append(
                    worker.give_up(
                        f"no result within {self._limit_s:g} s of wall-clock time"
                    )
                )
        self._workers = [
            None if worker is not None and worker.dead else worker
            for worker in self._workers
        ]
        return reports

    def close(self) -> None:
        """Ask all workers to end, and kill those that do not within their time."""
        workers = [worker for worker in self._workers if worker is not None]
        self._workers = [None] * len(self._workers)
        for worker in workers:
            worker.ask_to_end()
        deadline = time.monotonic() + GRACE_S
        for worker in workers:
            worker.join(max(0.0, deadline - time.monotonic()))
            worker.kill()


class _Worker:
    """The parent's view of a worker: its process, the pipe to it and the job it has."""

    def __init__(self, name: str, work: bytes, environment: dict[str, str]) -> None:
        self.name = name
        self.key: str | None = None
        self.deadline = 0.0
        self.dead = False
        self._queued_s = self._stood_s = 0.0
        self._stalled = False
        ours, theirs = socket.socketpair()
        safe = (
            ["-P"] if sys.version_info >= (3, 11) else []
        )  # modules are not to be found in the present folder
        before = signal.pthread_sigmask(
            signal.SIG_BLOCK, [signal.SIGINT]
        )  # until it has said how it takes Ctrl-C
        try:
            with theirs:
                self.process = subprocess.Popen(  # noqa: S603
                    [
                        sys.executable,
                        *safe,
                        "-m",
                        "barn_eval.running.worker",
                        str(theirs.fileno()),
                        name,
                    ],
                    env=environment,
                    stdin=subprocess.DEVNULL,
                    pass_fds=[theirs.fileno()],
                )
        finally:
            signal.pthread_sigmask(signal.SIG_SETMASK, before)
        self.connection = Connection(ours.detach())
        with suppress(OSError):  # should it die at once, that shows when waiting for it
            self.connection.send_bytes(work)

    def submit(self, key: str, job: object, limit_s: float) -> bool:
        """Send a job and return whether the worker was there to take it."""
        self.key, self.deadline = key, time.monotonic() + limit_s
        self._queued_s, self._stood_s, self._stalled = (
            processor_wait_s(self.process.pid),
            0.0,
            False,
        )
        with suppress(OSError):
            self.connection.send((key, job))
            return True
        return False

    def report(self, limit_s: float) -> Report:
        """Receive a report on the job, which is there or will never come; after a part, the limit counts anew."""
        try:
            report: Report = self.connection.recv()
        except (EOFError, OSError, pickle.UnpicklingError):
            self.kill()
            code = self.process.returncode
            how = (
                f"was killed by {signal.Signals(-code).name}"
                if code < 0
                else f"ended with exit code {code}"
            )
            return self._lost(f"its worker process {how}")
        if isinstance(report, Part):
            self.deadline = time.monotonic() + limit_s
        elif not isinstance(report, Note):
            self.key = None
        return report

    def stand_still(self, gap_s: float, limit_s: float, *, all_did: bool) -> None:
        """Put the deadline off by a time in which the worker was stopped, or everything was; by the limit at most."""
        if self._stood_s < limit_s and (all_did or self._is_stopped()):
            self.deadline += gap_s
            self._stood_s += gap_s

    def has_second_try(self, limit_s: float) -> bool:
        """Tell, at the deadline, whether it has been put off once more, as the machine withheld its processor."""
        queued = processor_wait_s(self.process.pid) - self._queued_s
        if self._stalled or (queued < 0.5 * limit_s and self._stood_s < limit_s):
            return False
        self._stalled = True
        self.deadline += limit_s
        return True

    def _is_stopped(self) -> bool:
        with suppress(OSError):
            stat = Path(f"/proc/{self.process.pid}/stat").read_text("utf-8", "replace")
            return stat.rpartition(") ")[2][:1] in ("T", "t")
        return False

    def give_up(self, reason: str) -> Report:
        """End the worker because of its job."""
        self.process.terminate()
        self.join(GRACE_S)
        self.kill()
        still = ", as the machine stood still" if self._stalled else ""
        return replace(
            self._lost(reason + still),
            stalled=self._stalled,
            overtime=not self._stalled,
        )

    def ask_to_end(self) -> None:
        """Let an idle worker return, and interrupt one that has a job."""
        if self.key is None:
            with suppress(OSError):
                self.connection.send(None)
        else:
            self.process.terminate()

    def join(self, limit_s: float) -> None:
        """Wait for the process to end, at most that long."""
        with suppress(subprocess.TimeoutExpired):
            self.process.wait(limit_s)

    def kill(self) -> None:
        """End the process, if it has not, and forget it."""
        self.dead = True
        self.connection.close()
        self.join(
            0.2
        )  # a worker whose pipe has closed is about to die by itself, with its own exit code
        self.process.kill()
        self.process.wait()

    def _lost(self, reason: str) -> Lost:
        return Lost(str(self.key), self.name, reason)
