"""Worker pools: they hand one job at a time to each worker and collect its reports."""

import traceback
from abc import ABC, abstractmethod
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, field, replace
from datetime import datetime, timezone
from typing import Any

from barn_eval.results.store import BagStore, TrialRecord
from barn_eval.running.planner_objects import PlannerObject
from barn_eval.trials.spec import TrialSpec
from barn_eval.trials.trial import PlannerError
from barn_worlds.base.errors import BarnError

# Workers already share the processors. Besides, the order in which threads add up
# numbers must not decide a result.
ENVIRONMENT = dict.fromkeys(
    ("OMP_NUM_THREADS", "OPENBLAS_NUM_THREADS", "MKL_NUM_THREADS", "NUMBA_NUM_THREADS"),
    "1",
)

# Takes the result of a part of a job, or a text for the user.
Emit = Callable[[Any], None]


@dataclass(frozen=True)
class Job:
    """Trials that one worker runs in turn."""

    # Distinguishes the jobs of a run.
    key: str

    trials: tuple[TrialSpec, ...]

    def without(self, trial_id: str) -> "Job":
        """Return a copy of the job without the trial of this ID."""
        trials = tuple(spec for spec in self.trials if spec.trial_id != trial_id)
        return replace(self, trials=trials)


class Work(ABC):
    """What a worker does with a job.

    Each worker gets a pickled copy.
    """

    # Whether a job may import modules that only this process's path has.
    needs_import_path = True

    @property
    def isolation(self) -> str:
        """How planner processes are kept apart; empty where there are none."""
        return ""

    def jobs(self, trials: Sequence[TrialSpec]) -> list[Job]:
        """Divide trials into jobs for workers; by default, each trial is a job."""
        return [Job(spec.trial_id, (spec,)) for spec in trials]

    @abstractmethod
    def run(self, job: Any, emit: Emit) -> Any:
        """Run a job in the worker's process and return its result, None if all emitted.

        Args:
            job: What `jobs` returns, or another kind of work.
            emit: Receives results of parts of the job, and texts for the user.

        Returns:
            The result of the job; None if `emit` received all of it.

        Raises:
            BarnError: If the user has to change something; this ends the run. Any other
                exception loses the job, which may be tried again.
        """

    def close(self) -> None:  # noqa: B027 (most have nothing to end)
        """Release what stays open between jobs; do nothing by default."""


@dataclass(frozen=True)
class DirectWork(Work):
    """Trials in mode direct: simulator and planner in the worker's own process."""

    store: BagStore

    # Planners that are Python objects, by name.
    planners: Mapping[str, PlannerObject] = field(default_factory=dict)

    def run(self, job: Job, emit: Emit) -> TrialRecord:  # noqa: ARG002 (one result)
        """Run the only trial of a job and record its bag; return its record."""
        # Only workers need the simulator and the planners.
        from barn_eval.running.direct import run_direct_trial, warm_up  # noqa: PLC0415

        (spec,) = job.trials
        planner_object = self.planners.get(spec.planner)
        warm_up(spec, with_planner=planner_object is None)
        with self.store.recorder(spec.trial_id) as recorder:
            planner = planner_object.make_planner() if planner_object else None
            return self.store.make_record(run_direct_trial(spec, recorder, planner))


@dataclass(frozen=True)
class JobReport:
    """A worker's report on a job."""

    # Key of the job.
    key: str

    # Name of the worker.
    worker: str


@dataclass(frozen=True)
class PartialResult(JobReport):
    """A result of a job that goes on."""

    result: Any

    # UTC time in ISO 8601.
    started_at: str


@dataclass(frozen=True)
class JobResult(JobReport):
    """The last report on a job that ended."""

    # Its result; None if partial results had all of it.
    result: Any

    # UTC time in ISO 8601.
    started_at: str


@dataclass(frozen=True)
class Notice(JobReport):
    """A line for the user about a job that goes on."""

    text: str

    # Whether the user should see it even if nobody watches the run.
    is_warning: bool = False


@dataclass(frozen=True)
class JobLoss(JobReport):
    """A job without a result, which may be tried again."""

    reason: str

    traceback: str = ""

    # Whether the job exceeded its wall-clock time.
    is_overtime: bool = False

    # Whether the planner is not to blame: the machine stood still, or something else
    # than the planner raised an exception.
    is_stall: bool = False


@dataclass(frozen=True)
class JobRefusal(JobReport):
    """A job that cannot run until the user changes something."""

    message: str


Report = PartialResult | JobResult | Notice | JobLoss | JobRefusal


def run_job(
    work: Work, key: str, worker: str, job: object, send: Callable[[Report], None]
) -> Report:
    """Run a job in this process; return its result, loss or refusal as a report.

    Args:
        work: What to do with the job.
        key: Key of the job, for its reports.
        worker: Name of the worker, for its reports and its rows.
        job: What `Work.run` takes.
        send: Receives partial results and notices.
    """
    # A job of several trials reports the start of each.
    started_at = now_text()

    def emit(result: object) -> None:
        """Send a text as a notice, anything else as a partial result."""
        nonlocal started_at
        # Anything but a text is a result, since works emit nothing else.
        if isinstance(result, str):
            send(Notice(key, worker, result))
        else:
            send(PartialResult(key, worker, result, started_at))
            started_at = now_text()

    try:
        return JobResult(key, worker, work.run(job, emit), started_at)
    # What the user has to change would fail every other attempt as well.
    except BarnError as error:
        return JobRefusal(key, worker, str(error))
    except Exception as error:
        return JobLoss(
            key,
            worker,
            f"{type(error).__name__}: {error}",
            traceback.format_exc(),
            is_stall=not isinstance(error, PlannerError),
        )


def now_text() -> str:
    """Return the current UTC time in ISO 8601, to the millisecond."""
    return datetime.now(timezone.utc).isoformat(timespec="milliseconds")


class WorkerPool(ABC):
    """Workers that run one job each at a time.

    Whatever happens to a worker, each job ends with exactly one `JobResult`, `JobLoss`
    or `JobRefusal`.
    """

    @property
    @abstractmethod
    def slots(self) -> int:
        """Number of jobs that can run at a time, those that already run included."""

    @abstractmethod
    def submit(self, key: str, job: object) -> None:
        """Start a job; the caller makes sure that fewer than `slots` run.

        Args:
            key: Key of the job.
            job: What the pool's `Work` takes.
        """

    @abstractmethod
    def wait(self, limit_s: float) -> Sequence[Report]:
        """Wait up to `limit_s` [s] for a report; return all that arrived, or none."""

    @abstractmethod
    def close(self) -> None:
        """End all workers; jobs that still run are given up without a report."""


class InlinePool(WorkerPool):
    """The calling process as the only worker; nothing protects it from a job."""

    slots = 1

    def __init__(self, work: Work):
        """Keep the work, which is done in the calling process."""
        self._work = work
        self._reports: list[Report] = []

    def submit(self, key: str, job: object) -> None:
        """Run a job to its end in this process; `wait` returns its reports.

        Args:
            key: Key of the job, which its reports carry.
            job: What `Work.run` takes.
        """
        report = run_job(self._work, key, "inline", job, self._reports.append)
        self._reports.append(report)

    def wait(self, limit_s: float) -> list[Report]:  # noqa: ARG002 (the job has ended)
        """Return and forget the reports so far; never wait."""
        reports = self._reports
        self._reports = []
        return reports

    def close(self) -> None:
        """Close the work; there are no workers to end."""
        self._work.close()
