"""Workers of a Ray cluster, or of Ray on this machine.

Ray is an optional extra, `barn_eval[ray]`. Each node of a cluster needs the same
version of the suite and, with bags, the folder that they go to.
"""

import importlib
import os
import socket
import time
from collections.abc import Callable
from typing import Any

from barn_eval.running.pool import (
    ENVIRONMENT,
    JobLoss,
    Report,
    Work,
    WorkerPool,
    run_job,
)
from barn_worlds.base.errors import BarnError, ConfigError, format_error


class RayPool(WorkerPool):
    """Runs each job as a Ray task on one processor; Ray reuses its processes."""

    def __init__(
        self, work: Work, workers: int, trial_limit_s: float, address: str = ""
    ):
        """Connect to a cluster, or start Ray here; ConfigError if that fails.

        Args:
            work: What workers do with jobs.
            workers: Most jobs at a time; 0 is no limit.
            trial_limit_s: Wall-clock time limit of a job [s]; 0 is no limit.
            address: Address of the cluster; empty to start Ray on this machine.

        Raises:
            ConfigError: If Ray is not installed or the cluster does not answer.
        """
        try:
            self._ray: Any = importlib.import_module("ray")
        except ImportError:
            raise ConfigError(
                "engine ray needs Ray, which is not installed: pip install"
                " 'barn_eval[ray]'"
            ) from None
        self._limit_s = trial_limit_s or float("inf")
        self._workers = workers
        # Key and deadline of each job, by Ray's reference to its task.
        self._running: dict[Any, tuple[str, float]] = {}
        self._connect(address)
        self._work = self._ray.put(work)
        # Retries are counted and recorded by the run, not by Ray.
        self._task = self._ray.remote(num_cpus=1, max_retries=0)(_run_task)

    @property
    def slots(self) -> int:
        """Number of processors of the cluster now, at most the number of workers."""
        # Nodes may join and leave a cluster at any time.
        processors = int(self._call(self._ray.cluster_resources).get("CPU", 0))
        return min(processors, self._workers or processors)

    def submit(self, key: str, job: object) -> None:
        """Start a job as a task of the cluster, and its time limit; do not wait.

        Args:
            key: Key of the job, which its reports carry.
            job: What `Work.run` takes.
        """
        reference = self._call(self._task.remote, self._work, key, job)
        self._running[reference] = (key, time.monotonic() + self._limit_s)

    def wait(self, limit_s: float) -> list[Report]:
        """Wait up to `limit_s` [s]; return reports; cancel late jobs as lost."""
        # There is nothing to wait for, and callers would otherwise spin.
        if not self._running:
            time.sleep(min(limit_s, 0.1))
            return []
        first_deadline_s = min(deadline_s for _, deadline_s in self._running.values())
        timeout_s = max(0.0, min(limit_s, first_deadline_s - time.monotonic()))
        references = list(self._running)
        ready, _ = self._call(
            self._ray.wait, references, num_returns=1, timeout=timeout_s
        )
        # The first call waits for one result; this one takes all that are ready.
        if ready:
            ready, _ = self._call(
                self._ray.wait, references, num_returns=len(references), timeout=0
            )
        reports = [self._receive(reference) for reference in ready]

        for reference, (key, deadline_s) in list(self._running.items()):
            if time.monotonic() >= deadline_s:
                # Its result may still arrive, but must not count in addition to the loss.
                del self._running[reference]
                self._ray.cancel(reference, force=True)
                reason = f"no result within {self._limit_s:g} s of wall-clock time"
                reports.append(JobLoss(key, "ray", reason, is_overtime=True))
        return reports

    def close(self) -> None:
        """Cancel all jobs and leave the cluster; a Ray that started here ends."""
        for reference in self._running:
            self._ray.cancel(reference, force=True)
        self._ray.shutdown()

    def _connect(self, address: str) -> None:
        """Connect to the cluster at an address, or start Ray here; else ConfigError."""
        # Ray would send usage statistics to its makers.
        os.environ.setdefault("RAY_USAGE_STATS_ENABLED", "0")
        options: dict[str, Any] = {"address": address or "local"}
        if address:
            _require_answer(address)
        else:
            options |= {"include_dashboard": False, "num_cpus": self._workers or None}
        try:
            self._ray.init(
                log_to_driver=False,
                logging_level="ERROR",
                runtime_env={"env_vars": ENVIRONMENT},
                **options,
            )
        except (
            self._ray.exceptions.RayError,
            OSError,
            RuntimeError,
            ValueError,
        ) as error:
            raise ConfigError(
                f"engine ray: cannot reach {address or 'Ray'}: {format_error(error)}"
            ) from None

    def _receive(self, reference: object) -> Report:
        """Return an ended task's report or loss; ConfigError if Ray cannot start it."""
        # Whatever comes of it, the job is over.
        key, _ = self._running.pop(reference)
        errors = self._ray.exceptions
        try:
            report: Report = self._ray.get(reference)
        except errors.RuntimeEnvSetupError as error:
            raise ConfigError(
                f"engine ray: cannot start a worker: {format_error(error)}"
            ) from None
        except errors.RayError as error:
            reason = f"its worker was lost: {type(error).__name__}"
            return JobLoss(key, "ray", reason, str(error))
        return report

    def _call(self, function: Callable[..., Any], *args: Any, **options: Any) -> Any:
        """Call a function of Ray; raise BarnError if the whole cluster is gone."""
        try:
            return function(*args, **options)
        except (ConnectionError, self._ray.exceptions.RaySystemError) as error:
            raise BarnError(
                f"engine ray: lost the connection to the cluster: {format_error(error)}"
            ) from None


def _run_task(work: Work, key: str, job: object) -> Report:
    """Run a job in a Ray task and return its last report; earlier ones are dropped."""
    address = importlib.import_module("ray").util.get_node_ip_address()
    try:
        return run_job(work, key, f"{address}/{os.getpid()}", job, lambda _: None)
    finally:
        work.close()


def _require_answer(address: str) -> None:
    """Raise ConfigError if "HOST:PORT" does not answer in 5 s; skip other addresses.

    Ray itself would try for minutes.
    """
    # Names of clusters that Ray itself resolves are left to it.
    host, _, port = address.removeprefix("ray://").rpartition(":")
    if not (host and port.isdigit()):
        return
    try:
        socket.create_connection((host, int(port)), timeout=5.0).close()
    except (OSError, OverflowError) as error:
        raise ConfigError(
            f"engine ray: cannot reach {address}: {format_error(error)}"
        ) from None
