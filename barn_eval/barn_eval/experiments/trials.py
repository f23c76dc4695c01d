"""The trials of a campaign, always in the same order, and what a worker does with one in direct mode."""

from __future__ import annotations

import shutil
from collections.abc import Iterator
from contextlib import nullcontext
from dataclasses import dataclass
from pathlib import Path

from barn_eval.experiments.config import CampaignConfig
from barn_eval.experiments.engine import Emit, Work
from barn_eval.trials.result import TrialResult
from barn_eval.trials.spec import TrialSpec


def trials(config: CampaignConfig) -> Iterator[TrialSpec]:
    """Yield the trials world by world, repetition by repetition, planner by planner.

    So planners are compared on the same worlds however early a campaign is stopped. WorldError if a world cannot be
    read.
    """
    return (spec for group in zip(*(plan.trials() for plan in config.plans()), strict=True) for spec in group)


@dataclass(frozen=True)
class Record:
    """What a worker reports of a trial: its result and the line of its track, None where nothing was driven."""

    result: TrialResult
    track: str | None


@dataclass(frozen=True)
class DirectWork(Work):
    """Trials in one process; bags of those that `bags` asks for go to a folder."""

    bags: str
    folder: Path

    def run(self, job: TrialSpec, emit: Emit) -> Record:  # noqa: ARG002 (one result per job)
        """Run a trial; BagError where its bag cannot be written."""
        from barn_eval.bags.recorder import Recorder  # noqa: PLC0415
        from barn_eval.experiments.direct import run_direct_trial  # noqa: PLC0415 (loads simulator and planners in the worker)
        from barn_eval.experiments.track import track_line  # noqa: PLC0415

        path = self.folder / "bags" / job.trial_id
        if path.exists():  # of an attempt whose worker was lost before it could report
            shutil.rmtree(path)
        with Recorder(path) if self.bags != "none" else nullcontext() as recorder:
            finished = run_direct_trial(job, recorder)
        if self.bags == "failed" and finished.result.scores.success:
            shutil.rmtree(path)
        return Record(finished.result, track_line(finished))
