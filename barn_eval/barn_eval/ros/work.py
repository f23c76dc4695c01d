"""What the workers of an experiment are handed; over ROS, each keeps its nodes running for a share of the trials."""

import os
from collections.abc import Sequence
from contextlib import closing
from dataclasses import dataclass
from socket import AF_INET, SOCK_DGRAM, socket

from barn_eval.results.store import LOGS, BagStore
from barn_eval.ros.isolation import (
    is_isolated,
    isolation,
    ros_problem,
    session_isolation,
)
from barn_eval.ros.supervision import run_ros_trials
from barn_eval.running.pool import DirectWork, Emit, Job, Work
from barn_eval.running.reporting import Reporter
from barn_eval.running.request import RunRequest
from barn_eval.running.run import open_run
from barn_eval.trials.result import TrialResult
from barn_eval.trials.ros_config import RosConfig
from barn_eval.trials.run_config import RunConfig
from barn_eval.trials.spec import TrialSpec
from barn_worlds.base.errors import ConfigError, convert_os_errors

_WORLDS_AT_A_TIME = 10  # of each worker, for which the nodes of each of several planners are started once


@dataclass(frozen=True)
class RosWork(Work):
    """Shares of trials over ROS; the supervisor of its nodes chooses a ROS domain for each worker.

    A single worker takes the domain of the environment, if that names one.
    """

    needs_import_path = False
    experiment: RunConfig
    store: BagStore
    workers: int

    @property
    def isolation(self) -> str:
        """What keeps planner processes from the suite's, as run.json has it."""
        return session_isolation(self.experiment.ros)

    def jobs(self, trials: Sequence[TrialSpec]) -> list[Job]:
        """Return the shares of trials: as many per planner as there are workers, worlds dealt in turn.

        Of several planners all drive in some worlds before any does in the next, so that what is stopped early compares
        them; nodes are started once for these and not for each trial.
        """
        worlds = list(dict.fromkeys(spec.world_number for spec in trials))
        size = (
            _WORLDS_AT_A_TIME * self.workers
            if len(self.experiment.planners) > 1
            else len(worlds)
        )
        made = []
        for begin in range(0, len(worlds), size):
            for planner in self.experiment.planners:
                for number in range(self.workers):
                    share = set(worlds[begin : begin + size][number :: self.workers])
                    own = tuple(
                        spec
                        for spec in trials
                        if spec.planner == planner.name and spec.world_number in share
                    )
                    key = (
                        f"{planner.name}_{number}" if self.workers > 1 else planner.name
                    )
                    made += (
                        [
                            Job(
                                f"{key}/{begin // size}" if size < len(worlds) else key,
                                own,
                            )
                        ]
                        if own
                        else []
                    )
        return made

    def run(self, job: Job, emit: Emit) -> None:
        """Run a share to its end; ProcessError where its nodes cannot be run, and other BarnErrors."""
        from barn_eval.running.direct import warm_up  # noqa: PLC0415 (loads the simulator, in the worker only)

        first = job.trials[0]
        (planner,) = (
            one for one in self.experiment.planners if one.name == first.planner
        )
        warm_up(first, with_planner=planner.registered)
        environment = {
            key: text
            for key, text in os.environ.items()
            if key != "ROS_DOMAIN_ID" or self.workers == 1
        }
        alone = self.workers == len(self.experiment.planners) == 1
        logs = self.store.folder / LOGS / ("" if alone else job.key)
        with closing(
            run_ros_trials(
                self.experiment, job.trials, self.store, logs, emit, environment
            )
        ) as records:
            for record in records:
                emit(record)


def work_of(request: RunRequest, store: BagStore) -> Work:
    """Return what the workers of a run do with its jobs.

    Args:
        request: The run.
        store: Receives the bags of its trials.
    """
    if request.config.mode == "direct":
        return DirectWork(store, request.planner_objects)
    return RosWork(request.config, store, request.execution.processes)


def isolation_text(setup: RosConfig) -> str:
    """Return that nothing keeps planners from the suite's processes, and why; empty if something does."""
    if setup.isolate and is_isolated():
        return ""
    why = isolation() if setup.isolate else "isolate=false"
    apart = f"planners are not kept apart from the suite's processes ({why})"
    return f"{apart}: a trial in which one of those ends counts as their failure"


def require_ros(experiment: RunConfig, reporter: Reporter) -> None:
    """Raise ConfigError if an experiment needs ROS that is not there; print what keeps no planners apart."""
    if experiment.mode != "ros":
        return
    if problem := ros_problem():
        raise ConfigError(
            f"mode ros: {problem}; install the ROS 2 wheels for this Python or use that of ROS"
        )
    with (
        convert_os_errors(ConfigError, "mode ros: no loopback interface, 127.0.0.1"),
        socket(AF_INET, SOCK_DGRAM) as line,
    ):
        line.connect(("127.0.0.1", 9))
    if text := isolation_text(experiment.ros):
        reporter.warn(text)


def run_request(
    request: RunRequest, reporter: Reporter, *, overwrite: bool = False
) -> list[TrialResult]:
    """Execute the missing trials of a run and return all its results.

    Args:
        request: The run and its folder.
        reporter: Receives notices and progress.
        overwrite: Delete the results of a different run in the same folder.

    Raises:
        BarnError: If the user has to change something.
    """
    require_ros(request.config, reporter)
    with open_run(request, reporter, work_of, overwrite=overwrite) as run:
        return run.drive()
