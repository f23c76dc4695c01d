"""A run from its request to its tables."""

import signal
from collections.abc import Callable, Collection, Iterator, Sequence
from contextlib import (
    AbstractContextManager,
    ExitStack,
    closing,
    contextmanager,
    nullcontext,
)
from dataclasses import dataclass
from pathlib import Path

from barn_eval.results.folder import ResultsFolder
from barn_eval.results.store import BagStore
from barn_eval.running.local_pool import LocalPool
from barn_eval.running.pool import DirectWork, InlinePool, Work, WorkerPool
from barn_eval.running.ray_pool import RayPool
from barn_eval.running.reporting import Reporter, RunProgress
from barn_eval.running.request import RunRequest
from barn_eval.running.runner import run_trials
from barn_eval.trials.identity import task_line
from barn_eval.trials.result import Rows, TrialResult
from barn_eval.trials.run_config import ExecutionConfig
from barn_eval.trials.spec import TrialSpec
from barn_eval.trials.trial import signal_handler
from barn_worlds.base.errors import BarnError, ConfigError, list_names
from barn_worlds.robots.files import name_unless_standard

_MAX_UNSCORED_NAMES = 5
# Share of the limit; a trial that needs at least this has hardly enough time.
_TIGHT_SHARE = 0.9

MakeWork = Callable[[RunRequest, BagStore], Work]
"""Returns what workers do with the jobs of a run."""


@contextmanager
def open_run(
    request: RunRequest,
    reporter: Reporter,
    make_work: MakeWork | None = None,
    *,
    overwrite: bool = False,
    pool: WorkerPool | None = None,
) -> Iterator["Run"]:
    """Open or resume a run's folder; signals interrupt; BarnError if it is another's.

    Args:
        request: The run and its folder.
        reporter: Receives notices and progress.
        make_work: Makes the work of the pool. By default, trials run in mode direct.
        overwrite: Delete the results of a different run in the same folder.
        pool: Pool shared with other runs, which keep no bags. By default, the run
            starts its own pool.

    Yields:
        The run; `Run.drive` executes the trials that are still missing.

    Raises:
        BarnError: If the folder belongs to another run or the request is invalid.
    """
    # Reads the worlds and checks planners, before the folder is touched.
    trials = request.trials()
    warning = check_limits(trials)
    if warning:
        reporter.warn(warning)
    store = BagStore(request.out.absolute(), request.config.bags)
    if make_work is None:
        work: Work = DirectWork(store, request.planner_objects)
    else:
        work = make_work(request, store)
    with (
        _stop_on_signals(),
        ResultsFolder.open(
            request.out,
            request.config,
            request.execution,
            trials,
            request.worlds,
            isolation=work.isolation,
            overwrite=overwrite,
        ) as folder,
    ):
        first = trials[0]
        robot = name_unless_standard(first.simulator.chassis)
        reporter.notify(task_line(first.protocol.name, first.task, robot))
        if folder.completed:
            reporter.notify(
                f"{len(folder.completed)} of {folder.total} trials are already there"
            )
        yield Run(request, folder, reporter, work, pool)


@dataclass(frozen=True)
class Run:
    """A run whose results folder is open."""

    request: RunRequest
    folder: ResultsFolder
    reporter: Reporter
    work: Work

    # Pool shared with other runs, if any.
    pool: WorkerPool | None

    def drive(self, worlds: Collection[int] | None = None) -> Rows:
        """Run missing trials, of `worlds` or all; return all rows; write final tables.

        Args:
            worlds: Numbers of the worlds to drive in. By default, all.

        Returns:
            All results so far, in the order of the schedule.

        Raises:
            BarnError: If the user has to change something. Results up to then are kept,
                also when the process is interrupted or killed.
        """
        trials = [
            spec
            for spec in self.folder.remaining
            if worlds is None or spec.world_number in worlds
        ]
        if trials:
            # Those of earlier sessions count in the progress, but not in the rates.
            completed = self.folder.results()
            total = len(completed) + len(trials)
            progress = RunProgress(total, completed, self.reporter)
            execution = self.request.execution
            pool_context = (
                nullcontext(self.pool)
                if self.pool is not None
                else closing(make_pool(execution, self.work))
            )
            with (
                pool_context as pool,
                self.reporter.show_progress(progress),
                closing(
                    run_trials(
                        self.folder,
                        trials,
                        pool,
                        execution,
                        self.work,
                        self.request.config.mode,
                    )
                ) as events,
            ):
                for event in events:
                    progress.take(event)

        # Tables need all trials; until then the rows are in results.jsonl alone.
        is_partial = bool(self.folder.remaining)
        results = self.folder.results() if is_partial else self.folder.complete()
        warning = describe_unscored(results)
        if warning:
            self.reporter.warn(warning)
        return results

    def drive_scored(self, worlds: Sequence[int]) -> list[TrialResult]:
        """Return all results in `worlds` after driving; BarnError if one is not scored.

        Raises:
            BarnError: If a trial failed through no fault of its planner.
        """
        numbers = set(worlds)
        results = [row for row in self.drive(numbers) if row.world in numbers]
        for row in results:
            # A decision between planners needs all of their trials.
            if not row.is_scored:
                raise BarnError(
                    f"{row.trial_id} failed, but not through a fault of the planner;"
                    " the same command repeats the trial"
                )
        return results


def make_pool(execution: ExecutionConfig, work: Work) -> WorkerPool:
    """Return a new pool of local processes, of Ray, or of this process alone.

    Args:
        execution: Kind and number of workers, and the time limit of a trial.
        work: What workers do with jobs.
    """
    if execution.engine == "ray":
        return RayPool(
            work, execution.workers, execution.trial_limit_s, execution.address
        )
    if execution.engine == "inline":
        return InlinePool(work)
    return LocalPool(work, execution.processes, execution.trial_limit_s)


def make_shared_pool(
    *requests: RunRequest,
) -> AbstractContextManager[WorkerPool | None]:
    """Return a context with a worker pool for runs without bags; None unless all direct.

    Their planners are from the registry. See `open_run`.
    """
    if any(request.config.mode != "direct" for request in requests):
        return nullcontext()
    return closing(make_pool(requests[0].execution, DirectWork(BagStore(Path()))))


def check_limits(trials: Sequence[TrialSpec]) -> str:
    """Return a warning on tight time limits, or ""; ConfigError if one cannot be met.

    Args:
        trials: Trials of a run.

    Raises:
        ConfigError: A planner cannot arrive within the limit, however well it drives.
    """
    tight = []
    for spec in trials:
        least_s = _require_time(spec) if spec.repetition == 0 else 0.0
        if least_s > _TIGHT_SHARE * spec.scaled_protocol.limit_s:
            tight.append(f"{spec.planner} in {spec.world.name} ({least_s:.1f} s)")
    if not tight:
        return ""
    return f"at least {_TIGHT_SHARE:.0%} of the limit is needed by {list_names(tight)}"


def _require_time(spec: TrialSpec) -> float:
    """Return a trial's least time in s, 0 if far below the limit, ConfigError if above.

    It may be above a short limit that somebody chose for the course of the protocol,
    for a first look.
    """
    protocol = spec.scaled_protocol
    speed_mps = spec.speed_cap_mps
    # The bound takes a search, and is no longer than the path takes.
    length_m = spec.course.reference_length_m
    if speed_mps is None or length_m < _TIGHT_SHARE * protocol.limit_s * speed_mps:
        return 0.0
    least_s = spec.least_time_s or 0.0
    is_first_look = spec.protocol.limit_is_chosen and spec.world.start is None
    if least_s > protocol.limit_s and not is_first_look:
        raise ConfigError(
            f"{spec.planner} in {spec.world.name} needs at least {least_s:.1f} s at {speed_mps:g} m/s, above limit_s ="
            f" {protocol.limit_s:g} s; set a longer limit in a protocol file with base: {spec.protocol.name}"
        )
    return least_s


def describe_unscored(results: Rows) -> str:
    """Return a line that counts unscored trials and names up to five; empty if none."""
    unscored = [row for row in results if not row.is_scored]
    if not unscored:
        return ""
    trials = [
        f"{row.trial_id} ({row.fault}: {row.detail})"
        for row in unscored[:_MAX_UNSCORED_NAMES]
    ]
    line = (
        f"{len(unscored)} of {len(results)} trials failed through no fault of the planner"
        " and are not scored; the same command runs them again:"
        f" {', '.join(trials)}"
    )
    if len(unscored) > len(trials):
        line += f" and {len(unscored) - len(trials)} more"
    return line


@contextmanager
def _stop_on_signals() -> Iterator[None]:
    """Let SIGTERM, SIGHUP and SIGQUIT raise KeyboardInterrupt during the context.

    Batch systems and closing terminals send them. Ignored signals stay ignored.
    """
    with ExitStack() as handlers:
        for number in (signal.SIGTERM, signal.SIGHUP, signal.SIGQUIT):
            # nohup ignores SIGHUP; that has to stay so.
            if signal.getsignal(number) is not signal.SIG_IGN:
                handlers.enter_context(
                    signal_handler(number, signal.default_int_handler)
                )
        yield
