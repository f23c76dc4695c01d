"""Campaigns over ROS: each worker keeps simulator, planner and evaluator running for a share of the trials.

A share is a run of its own in OUT/shards/NAME, so that a worker that was lost, or another session, goes on where it
stopped. Its rows come to the campaign one by one; its bags and pictures are moved there.
"""

from __future__ import annotations

import os
import shutil
from collections import Counter
from collections.abc import Generator, Iterator
from contextlib import closing
from dataclasses import dataclass, replace
from pathlib import Path
from typing import cast

from barn_eval.experiments.config import CampaignConfig, ExecutionConfig
from barn_eval.experiments.engine import Emit, Engine, Lost, Part, Refused, Work
from barn_eval.experiments.folder import CampaignFolder
from barn_eval.experiments.rows import TrackRows
from barn_eval.experiments.runner import CampaignError, Loss, kept, noted
from barn_eval.experiments.runs import RunFolder, RunPlan
from barn_eval.experiments.trials import Record
from barn_eval.ros.supervision import run_ros_trials
from barn_eval.trials.result import TrialResult

SHARD_FOLDER = "shards"
_WAIT_S = 1.0


@dataclass(frozen=True)
class Shard:
    """A share of a planner's trials, by name; `done` are those that have a result already."""

    name: str
    plan: RunPlan
    done: tuple[TrialResult, ...] = ()


def shards(config: CampaignConfig, folder: CampaignFolder, workers: int) -> list[Shard]:
    """Return the shares of what a campaign lacks: as many per planner as there are workers, worlds dealt in turn."""
    made = []
    for plan in config.plans():
        worlds = list(dict.fromkeys(spec.index for spec in folder.remaining if spec.planner == plan.planner))
        for number in range(min(workers, len(worlds))):
            share = ",".join(map(str, worlds[number::workers]))
            made.append(Shard(f"{plan.planner}_{number}", replace(plan, worlds=share)))
    return made


@dataclass(frozen=True)
class RosWork(Work):
    """Shares of trials over ROS; each worker has a ROS domain of its own, chosen by the supervisor of its nodes."""

    folder: Path
    shared_domain: bool

    def run(self, job: Shard, emit: Emit) -> None:
        """Run a share to its end; ProcessError where its nodes cannot be run, and other BarnErrors of its folder."""
        if not self.shared_domain:
            os.environ.pop("ROS_DOMAIN_ID", None)
        path = self.folder / SHARD_FOLDER / job.name
        shutil.rmtree(path, ignore_errors=True)
        run = RunFolder.create(path, job.plan)
        for result in job.done:
            run.append(result)

        with closing(cast(Generator[TrialResult, None, None], run_ros_trials(run))) as results:
            for result in results:
                self._move(path, result.trial_id)
                emit(Record(result, TrackRows(path).read().get(result.trial_id)))

    def _move(self, shard: Path, trial_id: str) -> None:
        """Move what a trial has left beside its row; what a lost attempt left in its place goes."""
        for source in (shard / "bags" / trial_id, shard / "pictures" / f"{trial_id}.png"):
            if source.exists():
                target = self.folder / source.relative_to(shard)
                target.parent.mkdir(exist_ok=True)
                if target.is_dir():
                    shutil.rmtree(target)
                source.replace(target)


def work_off_shards(
    folder: CampaignFolder, engine: Engine, execution: ExecutionConfig, config: CampaignConfig
) -> Iterator[TrialResult | Loss]:
    """Run what a campaign over ROS lacks; yield each result once it is on the disk, and each loss of a worker.

    A share whose worker was lost goes on with another one, unless `execution.attempts` were lost without a result in
    between: CampaignError then, and for what the user has to remove.
    """
    todo = shards(config, folder, engine.slots)
    out: dict[str, Shard] = {}
    lost: Counter[str] = Counter()
    while todo or out:
        while todo and len(out) < engine.slots:
            shard = todo.pop(0)
            out[shard.name] = shard
            engine.submit(shard.name, _with_results(shard, folder))
        for report in engine.wait(_WAIT_S):
            shard = out[report.key]
            if isinstance(report, Part):
                lost[shard.name] = 0
                yield kept(folder, report)
                continue
            del out[shard.name]
            if isinstance(report, Refused):
                raise CampaignError(report.message)
            if isinstance(report, Lost):
                lost[shard.name] += 1
                yield noted(folder, report, lost[shard.name])
                if lost[shard.name] >= execution.attempts:
                    raise CampaignError(
                        f"{shard.name}: lost {lost[shard.name]} times in a row, at last: {report.reason}"
                    )
                todo.append(shard)
    shutil.rmtree(folder.path / SHARD_FOLDER, ignore_errors=True)


def _with_results(shard: Shard, folder: CampaignFolder) -> Shard:
    worlds = set(shard.plan.worlds.split(","))
    results = (one for one in folder.results() if one.planner == shard.plan.planner and str(one.world) in worlds)
    return replace(shard, done=tuple(results))
