"""What runs the trials of an experiment: workers that are handed one job each and report on it."""

import traceback
from abc import ABC, abstractmethod
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, field, replace
from datetime import datetime, timezone
from typing import Any

from barn_eval.results.store import BagStore, TrialRecord
from barn_eval.running.planner_objects import LivePlanner
from barn_eval.trials.spec import TrialSpec
from barn_eval.trials.trial import MachineStalledError
from barn_worlds.base.errors import BarnError

# Workers share the processors already; and the order in which threads add up numbers must not decide a result.
ENVIRONMENT = dict.fromkeys(
    ("OMP_NUM_THREADS", "OPENBLAS_NUM_THREADS", "MKL_NUM_THREADS", "NUMBA_NUM_THREADS"),
    "1",
)

Emit = Callable[[Any], None]


@dataclass(frozen=True)
class Job:
    """Trials that one worker runs in turn; `key` tells jobs apart."""

    key: str
    trials: tuple[TrialSpec, ...]

    def without(self, trial_id: str) -> "Job":
        """Return what is left of the job once a trial has its result."""
        return replace(
            self,
            trials=tuple(spec for spec in self.trials if spec.trial_id != trial_id),
        )


class Work(ABC):
    """What a worker does with a job; handed to each worker, so that it must be picklable.

    loads: whether a job may need what this process finds by its import path.
    """

    loads = True

    @property
    def isolation(self) -> str:
        """What keeps planner processes from the suite's; empty without ROS."""
        return ""

    def jobs(self, trials: Sequence[TrialSpec]) -> list[Job]:
        """Return trials as jobs, one each unless a kind of work shares them out otherwise."""
        return [Job(spec.trial_id, (spec,)) for spec in trials]

    @abstractmethod
    def run(self, job: Any, emit: Emit) -> Any:
        """Do a job and return its result; results of parts of it, and texts for the user, may go to `emit` before.

        A BarnError ends the experiment, any other exception counts as a loss.
        """

    def close(self) -> None:  # noqa: B027 (most have nothing to end)
        """End what was kept between jobs."""


@dataclass(frozen=True)
class DirectWork(Work):
    """Trials in one process. planners: those given as Python objects, by name."""

    store: BagStore
    planners: Mapping[str, LivePlanner] = field(default_factory=dict)

    def run(self, job: Job, emit: Emit) -> TrialRecord:  # noqa: ARG002 (one result per job)
        """Run the one trial of a job; BagError where its bag cannot be written."""
        # In the worker only: this loads simulator and planners.
        from barn_eval.running.direct import run_direct_trial, warm_up  # noqa: PLC0415

        (spec,) = job.trials
        live = self.planners.get(spec.planner)
        warm_up(spec, with_planner=live is None)
        with self.store.recorder(spec.trial_id) as recorder:
            return self.store.make_record(
                run_direct_trial(spec, recorder, live.make() if live else None)
            )


@dataclass(frozen=True)
class JobReport:
    """What a worker reports on the job of that key."""

    key: str
    worker: str


@dataclass(frozen=True)
class Done(JobReport):
    """A job that has a result; started_at: in UTC after ISO 8601."""

    result: Any
    started_at: str


@dataclass(frozen=True)
class Part(JobReport):
    """A result of a job that goes on."""

    result: Any
    started_at: str


@dataclass(frozen=True)
class Note(JobReport):
    """A line for the user about a job that goes on."""

    text: str


@dataclass(frozen=True)
class Lost(JobReport):
    """A job without a result, because its worker died, took too long or failed; it may be tried again."""

    reason: str
    traceback: str = ""
    overtime: bool = False
    stalled: bool = (
        False  # the machine stood still, so that the planner is not to blame
    )


@dataclass(frozen=True)
class Refused(JobReport):
    """A job that cannot be done for a reason that the user has to remove."""

    message: str


Report = Done | Part | Note | Lost | Refused


def attempt(
    work: Work, key: str, worker: str, job: object, send: Callable[[Report], None]
) -> Report:
    """Do a job, in a worker, and return the report at its end; those on parts of it, and notes, go to `send`."""
    started_at = _now()

    def emit(result: object) -> None:
        nonlocal started_at
        send(
            Note(key, worker, result)
            if isinstance(result, str)
            else Part(key, worker, result, started_at)
        )
        started_at = started_at if isinstance(result, str) else _now()

    try:
        return Done(key, worker, work.run(job, emit), started_at)
    except BarnError as error:
        return Refused(key, worker, str(error))
    except Exception as error:
        stalled = isinstance(error, MachineStalledError)
        return Lost(
            key,
            worker,
            f"{type(error).__name__}: {error}",
            traceback.format_exc(),
            stalled=stalled,
        )


def _now() -> str:
    return datetime.now(timezone.utc).isoformat(timespec="milliseconds")


class Engine(ABC):
    """Workers, each of which has at most one job at a time.

    Whatever happens to a worker, each job submitted comes back in exactly one report that is neither `Part` nor `Note`.
    """

    @property
    @abstractmethod
    def slots(self) -> int:
        """Number of jobs that can be worked on at a time."""

    @abstractmethod
    def submit(self, key: str, job: object) -> None:
        """Hand out a job; only while fewer than `slots` are out."""

    @abstractmethod
    def wait(self, limit_s: float) -> Sequence[Report]:
        """Return the reports that have come, after waiting for one at most that long."""

    @abstractmethod
    def close(self) -> None:
        """End all workers; jobs that are out are given up."""


class InlineEngine(Engine):
    """The calling process, one job at a time; nothing protects it from what a job does."""

    slots = 1

    def __init__(self, work: Work) -> None:
        self._work = work
        self._reports: list[Report] = []

    def submit(self, key: str, job: object) -> None:
        """Do a job."""
        self._reports.append(
            attempt(self._work, key, "inline", job, self._reports.append)
        )

    def wait(self, limit_s: float) -> list[Report]:  # noqa: ARG002 (a job takes as long as it takes)
        """Return what has been reported."""
        found, self._reports = self._reports, []
        return found

    def close(self) -> None:
        """End what was kept between jobs."""
        self._work.close()
