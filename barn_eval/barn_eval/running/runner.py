"""The loop of a run: it hands out jobs, keeps results and retries lost trials."""

from collections import Counter, deque
from collections.abc import Generator, Iterator, Sequence
from contextlib import suppress
from dataclasses import dataclass, field, replace
from textwrap import indent

from barn_eval.results.folder import LOSSES, TRACEBACKS, ResultsFolder
from barn_eval.results.store import TrialRecord
from barn_eval.running.pool import (
    Job,
    JobLoss,
    JobRefusal,
    JobResult,
    Notice,
    PartialResult,
    Report,
    Work,
    WorkerPool,
)
from barn_eval.trials.result import Outcome, TrialResult, Verdict, WallClock
from barn_eval.trials.run_config import ExecutionConfig
from barn_eval.trials.spec import TrialSpec
from barn_eval.trials.trajectory import TrajectoryLog
from barn_eval.trials.trial import finish_trial
from barn_worlds.base.errors import BarnError, ExitCode, StoreError

_WAIT_S = 1.0


class RunError(BarnError):
    """A run that has to stop; the results so far are kept."""

    exit_code = ExitCode.NOT_SCORED


@dataclass(frozen=True)
class TrialLoss:
    """An attempt at a trial that gave no result."""

    trial_id: str
    attempt: int
    reason: str


Event = TrialResult | TrialLoss | Notice


def run_trials(
    folder: ResultsFolder,
    trials: Sequence[TrialSpec],
    pool: WorkerPool,
    execution: ExecutionConfig,
    work: Work,
    mode: str = "direct",
) -> Generator[Event, None, None]:
    """Run trials, retry lost ones, write and yield results; RunError if many are lost.

    All of `trials` run, so the caller leaves out those with a result.

    A trial that is lost at every attempt gets a result as well, by its last attempt:
    environment_failed if the machine stood still, planner_stalled if it exceeded its
    wall-clock time, and else planner_died in mode direct, where the planner shares the
    worker's process, or simulator_died in mode ros, where it cannot reach the worker.

    Args:
        folder: Receives the results.
        trials: Specifications, in the order in which they start.
        pool: Runs the jobs; the caller closes it.
        execution: Number of attempts and of losses in a row that end the run.
        work: Divides trials into jobs.
        mode: Mode of the run, "direct" or "ros".

    Yields:
        Each result once it is on the disk, each lost attempt and each notice.

    Raises:
        RunError: If the user has to change something, or too many trials in a row are
            lost.
        StoreError: If a result cannot be written.
    """
    loop = _Loop(folder, execution, mode, deque(work.jobs(trials)))
    try:
        while loop.waiting or loop.running:
            while loop.waiting and len(loop.running) < pool.slots:
                job = loop.waiting.popleft()
                loop.running[job.key] = job
                folder.begin_attempt(job.trials[0].trial_id)
                pool.submit(job.key, job)
            for report in pool.wait(_WAIT_S):
                yield from loop.take(report)
    except BaseException as error:
        # A planner may interrupt a run to have a trial repeated.
        for job in loop.running.values():
            reason = f"the run was interrupted: {type(error).__name__}"
            with suppress(StoreError):
                folder.write_note(LOSSES, job.trials[0].trial_id, reason)
        raise


@dataclass
class _Loop:
    """State of a run: its jobs, and what happened to trials so far."""

    folder: ResultsFolder
    execution: ExecutionConfig
    mode: str
    waiting: deque[Job]
    running: dict[str, Job] = field(default_factory=dict)

    # Lost attempts by trial.
    losses: Counter[str] = field(default_factory=Counter)
    losses_in_a_row: int = 0

    # Planners that raised an exception.
    failed_planners: set[str] = field(default_factory=set)

    def take(self, report: Report) -> Iterator[Event]:
        """Write a result, retry a lost job or raise for a refusal; yield events."""
        match report:
            case Notice():
                yield report
            case JobRefusal():
                raise RunError(f"{report.key}: {report.message}")
            case JobLoss():
                job = self.running.pop(report.key)
                if job.trials:
                    yield from self._retry(job, report)
            case PartialResult() | JobResult():
                # Mode ros ends a job without a result: all were partial.
                if report.result is not None:
                    # Any result shows that machine and run are in order.
                    self.losses_in_a_row = 0
                    yield from self._keep_traceback(report.result)
                    yield self._keep_result(report)
                if isinstance(report, JobResult):
                    del self.running[report.key]

    def _retry(self, job: Job, loss: JobLoss) -> Iterator[Event]:
        """Note a loss, put the job back in front or give up; RunError after too many.

        The job continues with its first trial without a result. After the last attempt,
        that trial is given up.
        """
        # Trials of the job that have a result are no longer in it.
        spec = job.trials[0]
        self.losses_in_a_row += 1
        self.losses[spec.trial_id] += 1
        attempt = self.losses[spec.trial_id]
        text = f"attempt {attempt} on {loss.worker}: {loss.reason}\n{loss.traceback}"
        self.folder.write_note(LOSSES, spec.trial_id, text.rstrip())
        yield TrialLoss(spec.trial_id, attempt, loss.reason)

        # Many losses in a row mean that something is wrong with the machine or the run,
        # not with single trials.
        if self.losses_in_a_row >= self.execution.losses:
            raise RunError(
                f"{self.losses_in_a_row} attempts in a row were lost; last reason:"
                f" {loss.reason}"
            )
        if attempt >= self.execution.attempts:
            job = job.without(spec.trial_id)
            yield self._give_up(spec, loss, attempt)
        # In front, so that retries do not pile up at the end of the run.
        if job.trials:
            self.waiting.appendleft(job)

    def _keep_traceback(self, record: TrialRecord) -> Iterator[Notice]:
        """Write a planner's traceback; yield a warning for each planner's first."""
        if not record.traceback:
            return
        result = record.result
        self.folder.write_note(TRACEBACKS, result.trial_id, record.traceback)
        if result.planner not in self.failed_planners:
            self.failed_planners.add(result.planner)
            lines = indent(record.traceback.rstrip(), "  ")
            text = f"planner {result.planner}, in {result.trial_id}:\n{lines}"
            yield Notice(result.trial_id, "", text, is_warning=True)

    def _keep_result(self, report: JobResult | PartialResult) -> TrialResult:
        """Write and return a result with worker and attempts; take it off its job."""
        record: TrialRecord = report.result
        trial_id = record.result.trial_id
        wall_clock = record.result.wall_clock
        result = replace(
            record.result,
            wall_clock=replace(
                wall_clock,
                started_at=report.started_at,
                worker=report.worker,
                attempts=max(wall_clock.attempts, self.folder.count_attempts(trial_id)),
            ),
        )
        # The row is on the disk before the trial counts as done.
        self.folder.append(replace(record, result=result))
        job = self.running[report.key].without(trial_id)
        self.running[report.key] = job
        if job.trials:
            self.folder.begin_attempt(job.trials[0].trial_id)
        return result

    def _give_up(self, spec: TrialSpec, loss: JobLoss, attempt: int) -> TrialResult:
        """Write and return a failure for a trial whose last attempt was lost."""
        # In this order: a machine that stands still also makes a job exceed its time.
        if loss.is_stall:
            outcome = Outcome.ENVIRONMENT_FAILED
        elif loss.is_overtime:
            outcome = Outcome.PLANNER_STALLED
        elif self.mode == "direct":
            outcome = Outcome.PLANNER_DIED
        else:
            outcome = Outcome.SIMULATOR_DIED
        detail = f"{loss.reason}, at the last of {attempt} attempts"
        result = finish_trial(
            spec,
            self.mode,
            Verdict(outcome, detail, None, 0.0, 0.0),
            TrajectoryLog().trajectory(),
            wall_clock=WallClock(worker=loss.worker, attempts=attempt),
        ).result
        self.folder.append(TrialRecord(result, None))
        return result
