"""An experiment with its workers, in either mode."""

from collections.abc import Mapping
from functools import partial

from rich.console import Console

from barn_eval.experiments.engine import DirectWork, Work
from barn_eval.experiments.experiment import Execution, Experiment
from barn_eval.experiments.live import LivePlanner
from barn_eval.experiments.request import Request
from barn_eval.experiments.run import run_experiment
from barn_eval.experiments.store import Store
from barn_eval.ros.work import ros_work
from barn_eval.trials.result import TrialResult


def run_request(
    request: Request, console: Console, live: Mapping[str, LivePlanner] | None = None, *, overwrite: bool = False
) -> list[TrialResult]:
    """Run what an experiment still lacks and return all its results; BarnError in one line for what is not possible.

    live: its planners that are Python objects, by name.
    """
    return run_experiment(request, console, partial(work_of, live=live or {}), overwrite=overwrite)


def work_of(experiment: Experiment, execution: Execution, store: Store, live: Mapping[str, LivePlanner]) -> Work:
    """Return what workers of an experiment are handed."""
    return DirectWork(store, live) if experiment.mode == "direct" else ros_work(experiment, execution, store)
