"""The work of a run's workers: over ROS each keeps its nodes for several trials."""

from collections.abc import Sequence
from contextlib import closing
from dataclasses import dataclass
from socket import AF_INET, SOCK_DGRAM, socket

from barn_eval.results.store import LOGS, BagStore
from barn_eval.ros.isolation import (
    can_isolate,
    probe_isolation,
    ros_problem,
    session_isolation,
)
from barn_eval.ros.supervision.supervisor import run_ros_trials
from barn_eval.running.pool import DirectWork, Emit, Job, Work
from barn_eval.running.reporting import Reporter
from barn_eval.running.request import RunRequest
from barn_eval.running.run import open_run
from barn_eval.trials.result import Rows
from barn_eval.trials.ros_config import RosConfig
from barn_eval.trials.run_config import RunConfig
from barn_eval.trials.spec import TrialSpec
from barn_worlds.base.errors import ConfigError, convert_os_errors

# Worlds of each worker for which the nodes of each of several planners start once.
_BLOCK_WORLDS = 10


@dataclass(frozen=True)
class RosWork(Work):
    """Shares of trials over ROS, each run by a supervisor on a ROS domain of its own.

    A single worker takes the domain of the environment, if that names one.
    """

    needs_import_path = False
    config: RunConfig
    store: BagStore
    workers: int

    @property
    def isolation(self) -> str:
        """Isolation in run.json: "apart", "visible" or why planners have none."""
        return session_isolation(self.config.ros)

    def jobs(self, trials: Sequence[TrialSpec]) -> list[Job]:
        """Split trials into jobs of one planner for one worker; deal worlds in turn.

        Several planners all drive in a block of worlds before any drives in the next,
        so a run that is stopped early compares them. Nodes start once for a block and
        not for each trial.
        """
        planners = self.config.planners
        worlds = list(dict.fromkeys(spec.world_number for spec in trials))
        block_size = len(worlds)
        if len(planners) > 1:
            block_size = _BLOCK_WORLDS * self.workers

        jobs = []
        for block, begin in enumerate(range(0, len(worlds), block_size)):
            block_worlds = worlds[begin : begin + block_size]
            for planner in planners:
                for number in range(self.workers):
                    share = set(block_worlds[number :: self.workers])
                    specs = [
                        spec
                        for spec in trials
                        if spec.planner == planner.name and spec.world_number in share
                    ]
                    if not specs:
                        continue
                    # The key names the folder of logs, so it says no more than it must.
                    key = planner.name
                    if self.workers > 1:
                        key += f"_{number}"
                    if block_size < len(worlds):
                        key += f"/{block}"
                    jobs.append(Job(key, tuple(specs)))
        return jobs

    def run(self, job: Job, emit: Emit) -> None:
        """Run the trials of a job over ROS, and emit a record of each.

        Args:
            job: Trials of one planner.
            emit: Receives a record for each trial, and notices for the user.

        Raises:
            ProcessError: If the nodes cannot be run.
            BarnError: For other mistakes in the input.
        """
        # In the worker only: this loads the simulator.
        from barn_eval.running.direct import warm_up  # noqa: PLC0415

        spec = job.trials[0]
        planner = self.config.planner(spec.planner)
        warm_up(spec, with_planner=planner.registered)

        logs = self.store.folder / LOGS
        if self.workers > 1 or len(self.config.planners) > 1:
            logs /= job.key
        with closing(
            run_ros_trials(self.config, job.trials, self.store, logs, emit)
        ) as records:
            for record in records:
                emit(record)


def work_of(request: RunRequest, store: BagStore) -> Work:
    """Return how workers run the trials: in their process, or over ROS.

    Args:
        request: The run.
        store: Where trials leave their bags.

    Returns:
        The work of mode direct or ros.
    """
    if request.config.mode == "direct":
        return DirectWork(store, request.planner_objects)
    return RosWork(request.config, store, request.execution.processes)


def isolation_warning(setup: RosConfig) -> str:
    """Return a warning that planners are not isolated, empty if they are."""
    if setup.isolate and can_isolate():
        return ""
    reason = probe_isolation() if setup.isolate else "isolate=false"
    return (
        f"planners are not isolated from the suite's processes ({reason}): if one of"
        " these ends, the trial counts as the planner's failure"
    )


def require_ros(config: RunConfig, reporter: Reporter) -> None:
    """Raise ConfigError if mode ros cannot run here; warn if nothing isolates planners.

    Args:
        config: The run; other modes pass.
        reporter: Receives the warning.

    Raises:
        ConfigError: If ROS or the loopback interface is missing.
    """
    if config.mode != "ros":
        return
    problem = ros_problem()
    if problem:
        raise ConfigError(
            f"mode ros: {problem}; install the ROS 2 wheels for this Python or use"
            " the Python of ROS"
        )
    with (
        convert_os_errors(ConfigError, "mode ros: no loopback interface, 127.0.0.1"),
        socket(AF_INET, SOCK_DGRAM) as probe,
    ):
        # To connect a datagram socket sends nothing: it only looks for a route.
        probe.connect(("127.0.0.1", 9))
    warning = isolation_warning(config.ros)
    if warning:
        reporter.warn(warning)


def run_request(
    request: RunRequest, reporter: Reporter, *, overwrite: bool = False
) -> Rows:
    """Run the trials that have no result yet; return all results, old ones included.

    Args:
        request: Run and folder.
        reporter: Receives notices and progress.
        overwrite: Delete the results of a different run in the same folder.

    Returns:
        All results, in the order of the schedule.

    Raises:
        BarnError: For what the user has to change.
    """
    require_ros(request.config, reporter)
    with open_run(request, reporter, work_of, overwrite=overwrite) as run:
        return run.drive()
