"""What the workers of an experiment are handed; over ROS, each keeps its nodes running for a share of the trials."""

import os
from collections.abc import Mapping, Sequence
from contextlib import closing
from dataclasses import dataclass
from functools import partial

from rich.console import Console

from barn_eval.experiments.engine import DirectWork, Emit, Job, Work
from barn_eval.experiments.experiment import Execution, Experiment
from barn_eval.experiments.live import LivePlanner
from barn_eval.experiments.request import Request
from barn_eval.experiments.ros_config import RosSetup
from barn_eval.experiments.run import run_experiment
from barn_eval.experiments.run_file import isolated, isolation, ros_problem
from barn_eval.experiments.store import LOGS, Store
from barn_eval.ros.supervision import run_ros_trials
from barn_eval.trials.result import TrialResult
from barn_eval.trials.spec import TrialSpec
from barn_worlds.base.errors import ConfigError


@dataclass(frozen=True)
class RosWork(Work):
    """Shares of trials over ROS; the supervisor of its nodes chooses a ROS domain for each worker.

    A single worker takes the domain of the environment, if that names one.
    """

    loads = False
    experiment: Experiment
    store: Store
    workers: int

    def jobs(self, trials: Sequence[TrialSpec]) -> list[Job]:
        """Return the shares of trials: as many per planner as there are workers, worlds dealt in turn."""
        made = []
        for planner in self.experiment.planners:
            own = [spec for spec in trials if spec.planner == planner.name]
            worlds = list(dict.fromkeys(spec.index for spec in own))
            for number in range(min(self.workers, len(worlds))):
                share = set(worlds[number :: self.workers])
                key = f"{planner.name}_{number}" if self.workers > 1 else planner.name
                made.append(Job(key, tuple(spec for spec in own if spec.index in share)))
        return made

    def run(self, job: Job, emit: Emit) -> None:
        """Run a share to its end; ProcessError where its nodes cannot be run, and other BarnErrors."""
        from barn_eval.experiments.direct import warm_up  # noqa: PLC0415 (loads the simulator, in the worker only)

        first = job.trials[0]
        (planner,) = (one for one in self.experiment.planners if one.name == first.planner)
        warm_up(first, with_planner=planner.registered)
        environment = {key: text for key, text in os.environ.items() if key != "ROS_DOMAIN_ID" or self.workers == 1}
        alone = self.workers == len(self.experiment.planners) == 1
        logs = self.store.folder / LOGS / ("" if alone else job.key)
        with closing(run_ros_trials(self.experiment, job.trials, self.store, logs, emit, environment)) as records:
            for record in records:
                emit(record)


def work_of(experiment: Experiment, execution: Execution, store: Store, live: Mapping[str, LivePlanner]) -> Work:
    """Return what workers of an experiment are handed; live: its planners that are Python objects, by name."""
    if experiment.mode == "direct":
        return DirectWork(store, live)
    return RosWork(experiment, store, execution.processes)


def isolation_text(setup: RosSetup) -> str:
    """Return that nothing keeps planners from the suite's processes, and why; empty if something does."""
    if setup.isolate and isolated():
        return ""
    why = isolation() if setup.isolate else "isolate=false"
    apart = f"planners are not kept apart from the suite's processes ({why})"
    return f"{apart}: a trial in which one of those ends counts as their failure"


def run_request(
    request: Request, console: Console, live: Mapping[str, LivePlanner] | None = None, *, overwrite: bool = False
) -> list[TrialResult]:
    """Run what an experiment still lacks and return all its results; BarnError in one line for what is not possible.

    live: its planners that are Python objects, by name.
    """
    if request.experiment.mode == "ros":
        if problem := ros_problem():
            raise ConfigError(f"mode ros: {problem}; install the ROS 2 wheels for this Python or use that of ROS")
        if text := isolation_text(request.experiment.ros):
            console.print(text, markup=False, highlight=False, soft_wrap=True)
    return run_experiment(request, console, partial(work_of, live=live or {}), overwrite=overwrite)
