"""Worker processes on this machine.

The executors of the standard library and loky give up all jobs when one process dies.
Here each worker has a pipe of its own: if it is killed, hangs or crashes, only its own
job is lost, and a new process takes its place. Workers do not import the user's main
script again, as those of multiprocessing do (see `worker`).
"""

import os
import pickle
import signal
import socket
import subprocess
import sys
import time
from contextlib import suppress
from multiprocessing.connection import Connection, wait
from pathlib import Path

import cloudpickle

from barn_eval.running.pool import (
    ENVIRONMENT,
    JobLoss,
    Notice,
    PartialResult,
    Report,
    Work,
    WorkerPool,
)
from barn_eval.running.worker import GRACE_S
from barn_eval.trials.trial import processor_wait_s
from barn_worlds.base.errors import ConfigError

# A longer gap between two looks at the workers means that this process was stopped.
_MAX_GAP_S = 10.0


class LocalPool(WorkerPool):
    """Worker processes, started at their first job.

    A job, or a part of one, that exceeds the time limit costs its worker's life.
    """

    def __init__(self, work: Work, workers: int, trial_limit_s: float):
        """Prepare the pool, start no process; ConfigError if `work` cannot be pickled.

        Args:
            work: What workers do with jobs.
            workers: Number of worker processes.
            trial_limit_s: Wall-clock time limit of a job or a part of it [s]; 0 is no
                limit.

        Raises:
            ConfigError: If `work` has an object that no other process can get.
        """
        try:
            self._work = cloudpickle.dumps(work)
        except Exception as error:
            raise ConfigError(
                f"a planner cannot be sent to a worker process ({type(error).__name__}:"
                f" {error}); use workers=1, which starts no worker process"
            ) from None
        self._environment = os.environ | ENVIRONMENT
        if work.needs_import_path:
            # A worker runs no main script whose folder would be in its path.
            path = os.pathsep.join(map(os.path.abspath, sys.path))
            self._environment["PYTHONPATH"] = path
        self._limit_s = trial_limit_s or float("inf")
        # At most one worker for each slot; it is started at its first job.
        self._slots = workers
        self._workers: dict[int, _Worker] = {}
        self._last_look_s = time.monotonic()

    @property
    def slots(self) -> int:
        """Number of workers, busy, idle or not yet started."""
        return self._slots

    def submit(self, key: str, job: object) -> None:
        """Send a job to an idle worker, starting one if needed; do not wait.

        Args:
            key: Key of the job, which its reports carry.
            job: What `Work.run` takes.
        """
        busy = {slot for slot, worker in self._workers.items() if worker.key}
        slot = min(set(range(self._slots)) - busy)
        worker = self._workers.get(slot)
        if worker is not None:
            if worker.submit(key, job):
                return
            worker.kill()
        worker = _Worker(f"local-{slot}", self._work, self._environment, self._limit_s)
        self._workers[slot] = worker
        # If the process dies at once, the pipe is already broken. `wait` finds that.
        worker.submit(key, job)

    def wait(self, limit_s: float) -> list[Report]:
        """Wait up to `limit_s` [s]; return reports and losses of dead or late ones."""
        busy = {
            worker.connection: worker
            for worker in self._workers.values()
            if worker.key is not None
        }
        deadline_s = min((worker.deadline_s for worker in busy.values()), default=0.0)
        # A worker that exceeds its limit sends nothing that would end the wait.
        timeout_s = min(limit_s, deadline_s - time.monotonic())
        ready = wait(list(busy), max(0.0, timeout_s))

        now_s = time.monotonic()
        gap_s = now_s - self._last_look_s
        self._last_look_s = now_s
        # Time in which a worker, or this process, stood still is not the planner's.
        for worker in busy.values():
            if gap_s > _MAX_GAP_S or worker.is_stopped():
                worker.excuse(gap_s)

        reports = []
        for connection, worker in busy.items():
            if connection in ready:
                reports.append(worker.receive())
            elif time.monotonic() >= worker.deadline_s and not worker.extend():
                reports.append(worker.give_up())
        for slot, worker in list(self._workers.items()):
            if worker.is_dead:
                del self._workers[slot]
        return reports

    def close(self) -> None:
        """Ask all workers to end, and kill those that do not within `GRACE_S`."""
        # All are asked before any is waited for, so that they end at the same time.
        for worker in self._workers.values():
            worker.request_end()
        deadline_s = time.monotonic() + GRACE_S
        for worker in self._workers.values():
            worker.join(max(0.0, deadline_s - time.monotonic()))
            worker.kill()
        self._workers.clear()


class _Worker:
    """The parent's side of a worker: its process, the pipe to it and its job."""

    def __init__(
        self, name: str, work: bytes, environment: dict[str, str], limit_s: float
    ):
        """Start the process and send it its pickled work; do not wait."""
        self.name = name
        self.key: str | None = None  # of its job; None while it is idle
        self.deadline_s = 0.0
        self.is_dead = False
        self._limit_s = limit_s
        self._processor_wait_s = 0.0  # of the process when the job began
        self._excused_s = 0.0
        self._is_extended = False

        ours, theirs = socket.socketpair()
        command = [sys.executable]
        if sys.version_info >= (3, 11):
            # Modules in the current folder must not shadow installed ones.
            command.append("-P")
        descriptor = theirs.fileno()
        command += ["-m", "barn_eval.running.worker", str(descriptor), name]
        # Ctrl-C must not reach the process before it ignores the signal.
        mask = signal.pthread_sigmask(signal.SIG_BLOCK, [signal.SIGINT])
        try:
            with theirs:
                self.process = subprocess.Popen(  # noqa: S603
                    command,
                    env=environment,
                    stdin=subprocess.DEVNULL,
                    pass_fds=[descriptor],
                )
        finally:
            signal.pthread_sigmask(signal.SIG_SETMASK, mask)
        self.connection = Connection(ours.detach())
        # If the process dies at once, the pool finds that when it waits for a report.
        with suppress(OSError):
            self.connection.send_bytes(work)

    def submit(self, key: str, job: object) -> bool:
        """Send a job, restart its time limit; return False if the pipe is broken."""
        self.key = key
        self.deadline_s = time.monotonic() + self._limit_s
        self._processor_wait_s = processor_wait_s(self.process.pid)
        self._excused_s = 0.0
        self._is_extended = False
        try:
            self.connection.send((key, job))
        except OSError:
            return False
        return True

    def receive(self) -> Report:
        """Return the arrived report (the last frees the worker), or a dead one's loss.

        After a partial result, the time limit counts anew.
        """
        try:
            report: Report = self.connection.recv()
        except (EOFError, OSError, pickle.UnpicklingError):
            self.kill()
            # `kill` leaves a process that has ended by itself its own exit code.
            code = self.process.returncode
            end = f"ended with exit code {code}"
            if code < 0:
                end = f"was killed by {signal.Signals(-code).name}"
            return JobLoss(str(self.key), self.name, f"its worker process {end}")
        if isinstance(report, PartialResult):
            self.deadline_s = time.monotonic() + self._limit_s
        elif not isinstance(report, Notice):
            self.key = None
        return report

    def is_stopped(self) -> bool:
        """Return whether the process is stopped, by a signal or a debugger."""
        with suppress(OSError):
            stat = Path(f"/proc/{self.process.pid}/stat").read_text("utf-8", "replace")
            return stat.rpartition(") ")[2][:1] in ("T", "t")
        return False

    def excuse(self, gap_s: float) -> None:
        """Move the deadline later by a standstill [s], in all by about the time limit."""
        if self._excused_s < self._limit_s:
            self.deadline_s += gap_s
            self._excused_s += gap_s

    def extend(self) -> bool:
        """Move the deadline once, by the limit, if the machine was slow; tell whether.

        That is: it withheld a processor or stood still.

        Returns:
            Whether the deadline moved.
        """
        wait_s = processor_wait_s(self.process.pid) - self._processor_wait_s
        is_slow = wait_s >= 0.5 * self._limit_s or self._excused_s >= self._limit_s
        # Once only: a planner that hangs must not profit from a slow machine forever.
        if self._is_extended or not is_slow:
            return False
        self._is_extended = True
        self.deadline_s += self._limit_s
        return True

    def give_up(self) -> Report:
        """Terminate the worker, kill it after `GRACE_S`, and return its job's loss."""
        self.process.terminate()
        self.join(GRACE_S)
        self.kill()
        reason = f"no result within {self._limit_s:g} s of wall-clock time"
        if self._is_extended:
            reason += ", as the machine stood still"
        return JobLoss(
            str(self.key),
            self.name,
            reason,
            is_overtime=not self._is_extended,
            is_stall=self._is_extended,
        )

    def request_end(self) -> None:
        """Send an idle worker None and a busy one SIGTERM; do not wait."""
        # An idle worker waits for a message, a busy one would not read it.
        if self.key is None:
            with suppress(OSError):
                self.connection.send(None)
        else:
            self.process.terminate()

    def join(self, limit_s: float) -> None:
        """Wait for the process to end, at most `limit_s` [s]; it may go on."""
        with suppress(subprocess.TimeoutExpired):
            self.process.wait(limit_s)

    def kill(self) -> None:
        """Set `is_dead`, close the pipe, kill the process unless it ends in 0.2 s."""
        self.is_dead = True
        self.connection.close()
        # A worker whose pipe closed is about to end by itself, with its own exit code.
        self.join(0.2)
        self.process.kill()
        self.process.wait()
