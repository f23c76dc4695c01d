"""Experiments over ROS: each worker keeps simulator, planner and evaluator running for a share of the trials."""

import os
from collections.abc import Generator, Sequence
from contextlib import closing
from dataclasses import dataclass
from typing import cast

from barn_eval.experiments.engine import Emit, Job, Work
from barn_eval.experiments.experiment import Execution, Experiment
from barn_eval.experiments.store import LOGS, Record, Store
from barn_eval.ros.supervision import run_ros_trials
from barn_eval.trials.spec import TrialSpec


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
        environment = dict(os.environ)
        if self.workers > 1:
            environment.pop("ROS_DOMAIN_ID", None)
        alone = self.workers == len(self.experiment.planners) == 1
        logs = self.store.folder / LOGS / ("" if alone else job.key)
        records = run_ros_trials(self.experiment, job.trials, self.store, logs, emit, environment)
        with closing(cast(Generator[Record, None, None], records)):
            for record in records:
                emit(record)


def ros_work(experiment: Experiment, execution: Execution, store: Store) -> Work:
    """Return the work of an experiment in mode ros."""
    return RosWork(experiment, store, execution.processes)
