"""Working off a campaign: hand out trials, keep results, try lost ones again a bounded number of times."""

from __future__ import annotations

from collections import Counter, deque
from collections.abc import Iterator
from dataclasses import dataclass, replace

from barn_eval.experiments.config import ExecutionConfig
from barn_eval.experiments.engine import Done, Engine, Lost, Part, Refused
from barn_eval.experiments.folder import CampaignFolder
from barn_eval.experiments.trials import Record
from barn_eval.trials.outcome import Outcome, Verdict
from barn_eval.trials.result import TrialResult
from barn_eval.trials.spec import TrialSpec, conclude
from barn_eval.trials.trajectory import TrajectoryLog
from barn_worlds.errors import BarnError

_WAIT_S = 1.0


class CampaignError(BarnError):
    """A campaign that had to stop; the results so far are kept."""


@dataclass(frozen=True)
class Loss:
    """An attempt at a trial that gave no result."""

    trial_id: str
    attempt: int
    reason: str


def work_off(
    folder: CampaignFolder, engine: Engine, execution: ExecutionConfig, mode: str = "direct"
) -> Iterator[TrialResult | Loss]:
    """Run what a campaign lacks; yield each result once it is on the disk, and each loss.

    A trial that is lost at every attempt gets a result too: planner_stalled if it exceeded its wall-clock time in the
    last, else simulator_died. Raises CampaignError for what the user has to remove, StoreError if a result cannot be
    written. The engine is left to the caller to close.
    """
    todo = deque(folder.remaining)
    out: dict[str, TrialSpec] = {}
    attempts: Counter[str] = Counter()
    lost_in_a_row = 0
    while todo or out:
        while todo and len(out) < engine.slots:
            spec = todo.popleft()
            out[spec.trial_id] = spec
            attempts[spec.trial_id] += 1
            engine.submit(spec.trial_id, spec)
        for report in engine.wait(_WAIT_S):
            spec, attempt = out.pop(report.key), attempts[report.key]
            if isinstance(report, Refused):
                raise CampaignError(f"{report.key}: {report.message}")
            if not isinstance(report, Lost):
                lost_in_a_row = 0
                yield kept(folder, report, attempt)
                continue
            lost_in_a_row += 1
            yield noted(folder, report, attempt)
            if lost_in_a_row >= execution.losses:
                raise CampaignError(f"{lost_in_a_row} attempts in a row were lost, the last one: {report.reason}")
            if attempt < execution.attempts:
                todo.appendleft(spec)
            else:
                yield _given_up(folder, spec, report, attempt, mode)


def kept(folder: CampaignFolder, report: Done | Part, attempt: int = 1) -> TrialResult:
    """Keep a result that a worker has reported, and return it."""
    record: Record = report.result
    clock = replace(record.result.wall_clock, started_at=report.started_at, worker=report.worker, attempts=attempt)
    folder.append(result := replace(record.result, wall_clock=clock), record.track)
    return result


def noted(folder: CampaignFolder, report: Lost, attempt: int) -> Loss:
    """Keep what is known of a loss, and return it."""
    text = f"attempt {attempt} on {report.worker}: {report.reason}\n{report.traceback}".rstrip()
    folder.note_loss(report.key, text)
    return Loss(report.key, attempt, report.reason)


def _given_up(folder: CampaignFolder, spec: TrialSpec, report: Lost, attempt: int, mode: str) -> TrialResult:
    """Keep and return the result of a trial that was lost at every attempt."""
    outcome = Outcome.PLANNER_STALLED if report.overtime else Outcome.SIMULATOR_DIED
    verdict = Verdict(outcome, f"{report.reason}, at the last of {attempt} attempts", None, 0.0, 0.0)
    result = conclude(spec, mode, verdict, TrajectoryLog().trajectory()).result
    result = replace(result, wall_clock=replace(result.wall_clock, worker=report.worker, attempts=attempt))
    folder.append(result)
    return result
