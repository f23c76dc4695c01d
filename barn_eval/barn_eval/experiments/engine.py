"""What runs the trials of a campaign: workers that are handed one job each and report on it."""

from __future__ import annotations

import traceback
from abc import ABC, abstractmethod
from collections.abc import Callable, Sequence
from dataclasses import dataclass
from datetime import datetime, timezone
from typing import Any

from barn_worlds.errors import BarnError

# Workers share the processors already; and the order in which threads add up numbers must not decide a result.
ENVIRONMENT = dict.fromkeys(("OMP_NUM_THREADS", "OPENBLAS_NUM_THREADS", "MKL_NUM_THREADS", "NUMBA_NUM_THREADS"), "1")


Emit = Callable[[Any], None]


class Work(ABC):
    """What a worker does with a job; handed to each worker, so that it must be picklable."""

    @abstractmethod
    def run(self, job: Any, emit: Emit) -> Any:
        """Do a job and return its result; results of parts of it may be handed to `emit` before.

        A BarnError ends the campaign, any other exception counts as a loss.
        """

    def close(self) -> None:  # noqa: B027 (most have nothing to end)
        """End what was kept between jobs."""


@dataclass(frozen=True)
class Done:
    """A job that has a result; `started_at` in UTC after ISO 8601."""

    key: str
    worker: str
    result: Any
    started_at: str


@dataclass(frozen=True)
class Part:
    """A result of a job that goes on."""

    key: str
    worker: str
    result: Any
    started_at: str


@dataclass(frozen=True)
class Lost:
    """A job without a result, because its worker died, took too long or failed; it may be tried again."""

    key: str
    worker: str
    reason: str
    traceback: str = ""
    overtime: bool = False


@dataclass(frozen=True)
class Refused:
    """A job that cannot be done for a reason that the user has to remove."""

    key: str
    worker: str
    message: str


Report = Done | Part | Lost | Refused


class Engine(ABC):
    """Workers, each of which has at most one job at a time.

    Whatever happens to a worker, each job submitted comes back in exactly one report that is no `Part`.
    """

    @property
    @abstractmethod
    def slots(self) -> int:
        """Number of jobs that can be worked on at a time."""

    @abstractmethod
    def submit(self, key: str, job: Any) -> None:
        """Hand out a job; only while fewer than `slots` are out."""

    @abstractmethod
    def wait(self, limit_s: float) -> Sequence[Report]:
        """Return the reports that have come, after waiting for one at most that long."""

    @abstractmethod
    def close(self) -> None:
        """End all workers; jobs that are out are given up."""


def attempt(work: Work, job: Any, send: Callable[[tuple[Any, ...]], None]) -> tuple[Any, ...]:
    """Do a job, in a worker, and return what `reported` makes a report of in the campaign's process.

    send: takes the same for a part of the job.
    """
    started_at = [now()]

    def emit(result: Any) -> None:
        send(("part", result, started_at[0]))
        started_at[0] = now()

    try:
        return "done", work.run(job, emit), started_at[0]
    except BarnError as error:
        return "refused", str(error)
    except Exception as error:
        return "lost", f"{type(error).__name__}: {error}", traceback.format_exc()


def now() -> str:
    """Return the present time in UTC after ISO 8601."""
    return datetime.now(timezone.utc).isoformat(timespec="milliseconds")


def reported(key: str, worker: str, content: Sequence[Any]) -> Report:
    """Return the report that a worker's attempt makes."""
    kind, *rest = content
    kinds: dict[str, type[Any]] = {"done": Done, "part": Part, "lost": Lost, "refused": Refused}
    report: Report = kinds[kind](key, worker, *rest)
    return report
