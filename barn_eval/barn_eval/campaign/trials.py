"""The trials of a campaign, always in the same order, and what a worker does with one in direct mode."""

from __future__ import annotations

import shutil
from collections.abc import Iterator
from dataclasses import dataclass
from pathlib import Path

from barn_eval.campaign.config import CampaignConfig
from barn_eval.campaign.engine import Emit, Work
from barn_eval.result import TrialResult
from barn_eval.trial import TrialSpec

BAG_FOLDER = "bags"


def trials(config: CampaignConfig) -> Iterator[TrialSpec]:
    """Yield the trials world by world, repetition by repetition, planner by planner.

    So planners are compared on the same worlds however early a campaign is stopped. WorldError if a world cannot be
    read.
    """
    return (spec for group in zip(*(plan.trials() for plan in config.plans()), strict=True) for spec in group)


@dataclass(frozen=True)
class DirectWork(Work):
    """Trials in one process; bags of those that `bags` asks for go to a folder."""

    bags: str
    folder: Path

    def run(self, job: TrialSpec, emit: Emit) -> TrialResult:  # noqa: ARG002 (one result per job)
        """Run a trial; BagError where its bag cannot be written."""
        from barn_eval.direct import run_direct_trial  # noqa: PLC0415 (loads simulator and planners in the worker)
        from barn_eval.recorder import Recorder  # noqa: PLC0415

        if self.bags == "none":
            return run_direct_trial(job).result
        path = bag_path(self.folder, job.trial_id)
        with Recorder(path) as recorder:
            result = run_direct_trial(job, recorder).result
        if self.bags == "failed" and result.scores.success:
            shutil.rmtree(path)
        return result


def bag_path(folder: Path, trial_id: str) -> Path:
    """Return where a trial's bag goes, after removing what a lost attempt left there."""
    path = folder / BAG_FOLDER / trial_id
    if path.exists():
        shutil.rmtree(path)
    return path
