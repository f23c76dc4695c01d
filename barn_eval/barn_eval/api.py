"""The front door of the suite for Python: what the `barn` command does, as functions."""

from __future__ import annotations

from collections.abc import Mapping

from rich.console import Console

from barn_eval.experiments import plan as planning
from barn_eval.experiments.direct_work import DirectWork
from barn_eval.experiments.engine import Work
from barn_eval.experiments.experiment import Execution, Experiment
from barn_eval.experiments.live import LivePlanner
from barn_eval.experiments.plan import Plan
from barn_eval.experiments.request import Request
from barn_eval.experiments.run import run_experiment
from barn_eval.experiments.store import Store
from barn_eval.trials.result import TrialResult


def run_request(
    request: Request, console: Console, live: Mapping[str, LivePlanner] | None = None, *, overwrite: bool = False
) -> list[TrialResult]:
    """Run what an experiment still lacks and return all its results; BarnError in one line for what is not possible.

    live: its planners that are Python objects, by name.
    """

    def make_work(experiment: Experiment, execution: Execution, store: Store) -> Work:
        if experiment.mode == "direct":
            return DirectWork(store, live or {})
        from barn_eval.ros.shares import ros_work  # noqa: PLC0415 (needs sockets and locks of POSIX)

        return ros_work(experiment, execution, store)

    return run_experiment(request, console, make_work, overwrite=overwrite)


def plan_request(request: Request, *, overwrite: bool = False) -> Plan:
    """Return what running an experiment would do, without doing it."""
    return planning.plan(request, overwrite=overwrite)
