"""An experiment from its request to its tables."""

import signal
from collections.abc import Callable
from contextlib import closing
from types import FrameType

from rich.console import Console

from barn_eval.experiments.direct_work import DirectWork
from barn_eval.experiments.engine import Engine, InlineEngine, Work
from barn_eval.experiments.experiment import Execution, Experiment
from barn_eval.experiments.folder import opened
from barn_eval.experiments.local import LocalEngine
from barn_eval.experiments.progress import ExperimentProgress
from barn_eval.experiments.request import Request
from barn_eval.experiments.runner import run_remaining
from barn_eval.experiments.store import Store
from barn_eval.trials.deadline import handled
from barn_eval.trials.result import TrialResult

MakeWork = Callable[[Experiment, Execution, Store], Work]


def direct_work(_experiment: Experiment, _execution: Execution, store: Store) -> Work:
    """Return the work of an experiment in mode direct whose planners are all in the registry."""
    return DirectWork(store)


def run_experiment(
    request: Request, console: Console, make_work: MakeWork = direct_work, *, overwrite: bool = False
) -> list[TrialResult]:
    """Run what an experiment still lacks, write its tables and return all results in the order of the plan.

    make_work: what workers are handed; the default runs trials in mode direct. overwrite: remove what other experiments
    have left in the folder. Raises BarnError in one line for what the user has to change; results that were there by
    then are kept, as they are when the process is interrupted or killed.
    """
    experiment, execution = request.experiment, request.execution
    experiment.check()
    specs = experiment.trials()
    with (
        handled(signal.SIGTERM, _interrupt),
        opened(request.out, experiment, execution, specs, overwrite=overwrite) as folder,
    ):
        earlier = folder.results()
        if earlier:
            console.print(f"{len(earlier)} of {folder.total} trials are there already")
        if folder.remaining:
            work = make_work(experiment, execution, Store(folder.path.absolute(), experiment.bags, execution.pictures))
            with (
                closing(_engine(execution, work)) as engine,
                ExperimentProgress(folder.total, earlier, console) as progress,
                closing(run_remaining(folder, engine, execution, work, experiment.mode)) as events,
            ):
                for event in events:
                    progress.take(event)
        return folder.complete()


def _engine(execution: Execution, work: Work) -> Engine:
    if execution.engine == "ray":
        from barn_eval.experiments.cluster import RayEngine  # noqa: PLC0415 (an optional extra)

        return RayEngine(work, execution.workers, execution.trial_limit_s, execution.address)
    if execution.engine == "inline":
        return InlineEngine(work)
    return LocalEngine(work, execution.processes, execution.trial_limit_s)


def _interrupt(_number: int, _frame: FrameType | None) -> None:
    """Let SIGTERM, which batch systems send, stop an experiment as Ctrl-C does."""
    raise KeyboardInterrupt
