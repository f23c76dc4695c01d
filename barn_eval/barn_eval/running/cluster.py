"""Workers of a Ray cluster, or of a Ray started on this machine; Ray is an optional extra (`barn_eval[ray]`).

Each node needs the suite in the same version; with bags, also the folder that they go to.
"""

import importlib
import os
import socket
import time
from typing import Any

from barn_eval.running.engine import ENVIRONMENT, Engine, Lost, Report, Work, attempt
from barn_worlds.base.errors import BarnError, ConfigError, format_error


class RayEngine(Engine):
    """One Ray task with one processor per job; Ray keeps worker processes warm from task to task."""

    def __init__(
        self, work: Work, workers: int, trial_limit_s: float, address: str = ""
    ) -> None:
        try:
            self._ray: Any = importlib.import_module("ray")
        except ImportError:
            raise ConfigError(
                "engine ray needs Ray, which is not installed: pip install 'barn_eval[ray]'"
            ) from None
        self._limit_s = trial_limit_s or float("inf")
        self._workers = workers
        self._out: dict[Any, tuple[str, float]] = {}
        self._connect(address)
        self._work = self._ray.put(work)
        self._task = self._ray.remote(num_cpus=1, max_retries=0)(_do)

    @property
    def slots(self) -> int:
        """Number of processors of the cluster as it is now, at most the number of workers asked for, if any."""
        processors = int(self._cluster(self._ray.cluster_resources).get("CPU", 0))
        return min(processors, self._workers or processors)

    def submit(self, key: str, job: object) -> None:
        """Hand a job to the cluster."""
        reference = self._cluster(self._task.remote, self._work, key, job)
        self._out[reference] = (key, time.monotonic() + self._limit_s)

    def wait(self, limit_s: float) -> list[Report]:
        """Return what has come from the cluster."""
        if not self._out:
            time.sleep(min(limit_s, 0.1))
            return []
        first = min(deadline for _, deadline in self._out.values())
        waiting_s = max(0.0, min(limit_s, first - time.monotonic()))
        ready, _ = self._cluster(
            self._ray.wait, list(self._out), num_returns=1, timeout=waiting_s
        )
        if ready:
            ready, _ = self._cluster(
                self._ray.wait, list(self._out), num_returns=len(self._out), timeout=0
            )
        reports = [self._report(reference) for reference in ready]
        for reference, (key, deadline) in list(self._out.items()):
            if time.monotonic() >= deadline:
                del self._out[reference]
                self._ray.cancel(reference, force=True)
                reason = f"no result within {self._limit_s:g} s of wall-clock time"
                reports.append(Lost(key, "ray", reason, overtime=True))
        return reports

    def close(self) -> None:
        """Cancel what is out and leave the cluster; one that was started here ends."""
        for reference in self._out:
            self._ray.cancel(reference, force=True)
        self._ray.shutdown()

    def _connect(self, address: str) -> None:
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

    def _report(self, reference: object) -> Report:
        key, _ = self._out.pop(reference)
        errors = self._ray.exceptions
        try:
            report: Report = self._ray.get(reference)
        except errors.RuntimeEnvSetupError as error:
            raise ConfigError(
                f"engine ray: a worker cannot be set up: {format_error(error)}"
            ) from None
        except errors.RayError as error:
            report = Lost(
                key, "ray", f"its worker was lost: {type(error).__name__}", str(error)
            )
        return report

    def _cluster(self, call: Any, *arguments: Any, **options: Any) -> Any:
        """Call Ray; BarnError where the cluster as a whole is gone."""
        try:
            return call(*arguments, **options)
        except (ConnectionError, self._ray.exceptions.RaySystemError) as error:
            raise BarnError(
                f"engine ray: the cluster is gone: {format_error(error)}"
            ) from None


def _do(work: Work, key: str, job: object) -> Report:
    address = importlib.import_module("ray").util.get_node_ip_address()
    try:
        return attempt(work, key, f"{address}/{os.getpid()}", job, lambda _: None)
    finally:
        work.close()


def _require_answer(address: str) -> None:
    """Raise ConfigError at once for a host and port where nobody answers, for which Ray would try for minutes."""
    host, _, port = address.removeprefix("ray://").rpartition(":")
    if host and port.isdigit():
        try:
            socket.create_connection((host, int(port)), timeout=5.0).close()
        except (OSError, OverflowError) as error:
            raise ConfigError(
                f"engine ray: cannot reach {address}: {format_error(error)}"
            ) from None
