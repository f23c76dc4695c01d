"""A campaign from its configuration to its tables."""

from __future__ import annotations

import os
from collections.abc import Generator
from contextlib import closing

from rich.console import Console

from barn_eval.experiments.config import Campaign, ExecutionConfig
from barn_eval.experiments.engine import Engine, Work
from barn_eval.experiments.folder import CampaignFolder, opened
from barn_eval.experiments.local import LocalEngine
from barn_eval.experiments.progress import CampaignProgress
from barn_eval.experiments.runner import Loss, work_off
from barn_eval.experiments.trials import DirectWork, trials
from barn_eval.trials.result import TrialResult


def run_campaign(campaign: Campaign, console: Console) -> list[TrialResult]:
    """Run what a campaign still lacks, write its tables and return all results in the order of the plan.

    Raises BarnError in one line for what the user has to change; results that were there by then are kept, as they are
    when the process is interrupted or killed.
    """
    for plan in campaign.config.plans():
        plan.check()
    specs = list(trials(campaign.config))
    with opened(campaign.out, campaign.config, campaign.execution, specs) as folder:
        earlier = folder.results()
        if earlier and folder.remaining:
            console.print(f"{len(earlier)} of {folder.total} trials are there already")
        if folder.remaining:
            with (
                CampaignProgress(folder.total, earlier, console) as progress,
                closing(_events(campaign, folder)) as all_,
            ):
                for event in all_:
                    progress.take(event)
        return folder.complete()


def _events(campaign: Campaign, folder: CampaignFolder) -> Generator[TrialResult | Loss, None, None]:
    config, execution = campaign.config, campaign.execution
    if config.mode == "direct":
        work: Work = DirectWork(config.bags, folder.path.absolute())
        with closing(_engine(execution, work)) as engine:
            yield from work_off(folder, engine, execution, config.mode)
        return
    from barn_eval.ros.shards import RosWork, work_off_shards  # noqa: PLC0415 (needs sockets and locks of POSIX)

    workers = execution.workers or _processors()
    work = RosWork(folder.path.absolute(), shared_domain=workers == 1)
    with closing(LocalEngine(work, workers, execution.trial_limit_s)) as engine:
        yield from work_off_shards(folder, engine, execution, config)


def _engine(execution: ExecutionConfig, work: Work) -> Engine:
    if execution.engine == "ray":
        from barn_eval.experiments.cluster import RayEngine  # noqa: PLC0415 (an optional extra)

        return RayEngine(work, execution.workers, execution.trial_limit_s, execution.address)
    return LocalEngine(work, execution.workers or _processors(), execution.trial_limit_s)


def _processors() -> int:
    """Return the number of processors that this process may use."""
    return len(os.sched_getaffinity(0))
