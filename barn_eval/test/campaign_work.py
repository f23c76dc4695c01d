"""Jobs for engines under test.

Each names what is to happen to the worker that does it.
"""

import os
import signal
import time
from pathlib import Path

from waiting import until

from barn_eval.running.pool import JobResult, Work
from barn_worlds.base.errors import BarnError


class Deeds(Work):
    """A job is (deed, argument); the result tells what the worker has seen."""

    def __init__(self, log: str = "") -> None:
        self.log = log
        self.jobs = 0

    def run(self, job, emit):
        deed, argument = job
        self.emit = emit
        self.jobs += 1
        return getattr(self, deed)(argument)

    def close(self):
        if self.log:
            with Path(self.log).open("a") as file:
                file.write(f"closed {os.getpid()}\n")

    def echo(self, argument):
        return argument

    def parts(self, count):
        for number in range(count):
            self.emit(number)
        return "all"

    def parts_then_die(self, count):
        self.parts(count)
        os.kill(os.getpid(), signal.SIGKILL)

    def slow_parts(self, period_s):
        for number in range(3):
            time.sleep(period_s)
            self.emit(number)

    def whoami(self, argument):
        return os.getpid(), self.jobs, os.environ.get("OMP_NUM_THREADS")

    def sleep(self, seconds):
        with Path(self.log).open("a") as file:
            file.write(f"started {os.getpid()}\n")
        time.sleep(seconds)
        return seconds

    def make(self, seconds):
        _HalfMade(self.sleep, seconds)

    def die(self, number):
        os.kill(os.getpid(), number)
        time.sleep(10)

    def leave(self, code):
        os._exit(code)

    def fail(self, message):
        raise ValueError(message)

    def refuse(self, message):
        raise BarnError(message)

    def ignore_term(self, seconds):
        signal.signal(signal.SIGTERM, signal.SIG_IGN)
        time.sleep(seconds)

    def unpicklable(self, argument):
        return lambda: argument

    def huge(self, size):
        return bytes(size)

    def meet(self, argument):
        """Sign a list and wait until it has been signed often enough.

        Return the parent of this process.
        """
        path, count = argument
        with Path(path).open("a") as file:
            file.write(f"{os.getpid()}\n")
        until(lambda: signatures(path) >= count)
        return os.getppid()


def all_reports(engine, jobs):
    """Run jobs and return the reports by key."""
    waiting = list(jobs.items())
    reports = {}
    while len(reports) < len(jobs):
        while waiting and len(jobs) - len(waiting) - len(reports) < engine.slots:
            engine.submit(*waiting.pop(0))
        for report in engine.wait(5.0):
            assert report.key not in reports
            reports[report.key] = report
    return reports


def report_of(engine, *job):
    """Run one job, a deed and its argument, and return its report."""
    return all_reports(engine, {"job": job})["job"]


def echoes(count):
    """Return jobs that are done at once, by their number."""
    return {str(number): ("echo", number) for number in range(count)}


def failed_keys(reports):
    return [key for key, report in reports.items() if not isinstance(report, JobResult)]


class _HalfMade:
    """Its finaliser fails unless its construction was complete, as llvmlite's
    references do.
    """

    def __init__(self, wait, seconds):
        wait(seconds)
        self.pointer = 0

    def __del__(self):
        del self.pointer


def signatures(path):
    return Path(path).read_text().count("\n") if Path(path).exists() else 0
