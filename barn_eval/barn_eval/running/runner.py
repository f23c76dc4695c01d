"""The loop of an experiment: hand out jobs, keep results, try lost trials again a bounded number of times."""

from collections import Counter, deque
from collections.abc import Generator, Iterator, Sequence
from dataclasses import dataclass, field, replace
from textwrap import indent

from barn_eval.results.folder import LOSSES, TRACEBACKS, ResultsFolder
from barn_eval.results.store import TrialRecord
from barn_eval.running.engine import (
    Done,
    Engine,
    Job,
    Lost,
    Note,
    Part,
    Refused,
    Report,
    Work,
)
from barn_eval.trials.outcome import Outcome, Verdict
from barn_eval.trials.result import TrialResult, WallClock
from barn_eval.trials.run_config import ExecutionConfig
from barn_eval.trials.spec import TrialSpec
from barn_eval.trials.trajectory import TrajectoryLog
from barn_eval.trials.trial import finish_trial
from barn_worlds.base.errors import BarnError

_WAIT_S = 1.0


class ExperimentError(BarnError):
    """An experiment that had to stop; the results so far are kept."""


@dataclass(frozen=True)
class Loss:
    """An attempt at a trial that gave no result."""

    trial_id: str
    attempt: int
    reason: str


Event = TrialResult | Loss | Note


def run_remaining(
    folder: ResultsFolder,
    engine: Engine,
    execution: ExecutionConfig,
    work: Work,
    mode: str = "direct",
    trials: Sequence[TrialSpec] | None = None,
) -> Generator[Event, None, None]:
    """Run what an experiment lacks; yield each result once it is on the disk, each loss, and what workers note.

    trials: those of the remaining ones that are to be run now, all unless given.

    A trial that is lost at every attempt gets a result too, by the last of them: environment_failed if the machine
    stood still, planner_stalled if it exceeded its wall-clock time, else planner_died in mode direct, where the planner
    shares the worker's process, and simulator_died in mode ros, where it cannot touch the worker. Raises
    ExperimentError for what the user has to remove, StoreError if a result cannot be written. The engine is left to the
    caller to close.
    """
    loop = _Loop(
        folder,
        execution,
        mode,
        deque(work.jobs(folder.remaining if trials is None else trials)),
    )
    while loop.waiting or loop.out:
        while loop.waiting and len(loop.out) < engine.slots:
            job = loop.waiting.popleft()
            loop.out[job.key] = job
            engine.submit(job.key, job)
        for report in engine.wait(_WAIT_S):
            yield from loop.take(report)


@dataclass
class _Loop:
    """What is known while an experiment runs: jobs that wait and are out, losses by trial, planners that raised."""

    folder: ResultsFolder
    execution: ExecutionConfig
    mode: str
    waiting: deque[Job]
    out: dict[str, Job] = field(default_factory=dict)
    losses: Counter[str] = field(default_factory=Counter)
    failed: set[str] = field(default_factory=set)
    lost_in_a_row: int = 0

    def take(self, report: Report) -> Iterator[Event]:
        if isinstance(report, Note):
            yield report
        elif isinstance(report, Refused):
            raise ExperimentError(f"{report.key}: {report.message}")
        elif isinstance(report, Lost):
            job = self.out.pop(report.key)
            if job.trials:
                yield from self._lose(job, report)
        else:
            if report.result is not None:
                self.lost_in_a_row = 0
                yield from self._tell(report.result)
                yield self._keep(report)
            if isinstance(report, Done):
                del self.out[report.key]

    def _lose(self, job: Job, report: Lost) -> Iterator[Event]:
        """Try a job again whose worker was lost, at the first trial that has no result, or give that trial up."""
        spec, execution = job.trials[0], self.execution
        self.lost_in_a_row += 1
        self.losses[spec.trial_id] += 1
        attempt = self.losses[spec.trial_id]
        text = f"attempt {attempt} on {report.worker}: {report.reason}\n{report.traceback}".rstrip()
        self.folder.write_note(LOSSES, spec.trial_id, text)
        yield Loss(spec.trial_id, attempt, report.reason)
        if self.lost_in_a_row >= execution.losses:
            raise ExperimentError(
                f"{self.lost_in_a_row} attempts in a row were lost, the last one: {report.reason}"
            )
        if attempt >= execution.attempts:
            job = job.without(spec.trial_id)
            yield self._give_up(spec, report, attempt)
        if job.trials:
            self.waiting.appendleft(job)

    def _tell(self, record: TrialRecord) -> Iterator[Note]:
        """Keep the traceback of a planner that raised an exception, and show the first of each planner."""
        result = record.result
        if record.traceback:
            self.folder.write_note(TRACEBACKS, result.trial_id, record.traceback)
            if result.planner not in self.failed:
                told = indent(record.traceback.rstrip(), "  ")
                yield Note(
                    result.trial_id,
                    "",
                    f"planner {result.planner}, in {result.trial_id}:\n{told}",
                )
            self.failed.add(result.planner)

    def _keep(self, report: Done | Part) -> TrialResult:
        result, clock = report.result.result, report.result.result.wall_clock
        attempts = max(clock.attempts, self.losses[result.trial_id] + 1)
        clock = replace(
            clock, started_at=report.started_at, worker=report.worker, attempts=attempts
        )
        kept: TrialResult = replace(result, wall_clock=clock)
        self.folder.append(TrialRecord(kept, report.result.track))
        self.out[report.key] = self.out[report.key].without(kept.trial_id)
        return kept

    def _give_up(self, spec: TrialSpec, report: Lost, attempt: int) -> TrialResult:
        lost = Outcome.PLANNER_DIED if self.mode == "direct" else Outcome.SIMULATOR_DIED
        outcome = Outcome.PLANNER_STALLED if report.overtime else lost
        outcome = Outcome.ENVIRONMENT_FAILED if report.stalled else outcome
        verdict = Verdict(
            outcome,
            f"{report.reason}, at the last of {attempt} attempts",
            None,
            0.0,
            0.0,
        )
        clock = WallClock(worker=report.worker, attempts=attempt)
        result = finish_trial(
            spec, self.mode, verdict, TrajectoryLog().trajectory(), wall_clock=clock
        ).result
        self.folder.append(TrialRecord(result, None))
        return result
