"""An experiment from its request to its tables, how far it is, and what it would take."""

import signal
import time
from collections import Counter
from collections.abc import Callable, Collection, Iterable, Iterator
from contextlib import ExitStack, closing, contextmanager, nullcontext
from dataclasses import dataclass
from importlib.util import find_spec
from pathlib import Path
from statistics import fmean

from rich.console import Console
from rich.progress import BarColumn, MofNCompleteColumn, Progress, TextColumn
from rich.table import Column

from barn_eval.results.bags import BAGS
from barn_eval.results.folder import ResultsFolder, find_completed
from barn_eval.results.run_file import RunFile
from barn_eval.results.store import BagStore
from barn_eval.running.cluster import RayEngine
from barn_eval.running.engine import DirectWork, Engine, InlineEngine, Note, Work
from barn_eval.running.local import LocalEngine
from barn_eval.running.request import Request
from barn_eval.running.runner import Event, Loss, run_remaining
from barn_eval.trials.identity import task_line
from barn_eval.trials.result import Rows, TrialResult
from barn_eval.trials.run_config import ExecutionConfig, RunConfig
from barn_eval.trials.trial import signal_handler
from barn_worlds.base.errors import BarnError

# Where the folder has no trials yet: means of 60 trials of the suite's planners in barn300, on a 2 GHz core.
SIMULATED_S = 22.0
TRIAL_S = {
    "direct": 2.0,
    "ros": 5.0,
}  # in lockstep, without the first compilation of kernels
BAG_BYTES, ROW_BYTES = 1_200_000, 3_000

_NAMED = 5  # of the trials that are kept apart

MakeWork = Callable[[RunConfig, ExecutionConfig, BagStore], Work]
Drive = Callable[[Collection[int] | None], list[TrialResult]]


def run_experiment(
    request: Request,
    console: Console,
    make_work: MakeWork | None = None,
    *,
    overwrite: bool = False,
) -> list[TrialResult]:
    """Run what an experiment still lacks, write its tables and return all results in the order of the plan.

    make_work: what workers are handed; the default runs planners of the registry in mode direct. overwrite: remove what
    other experiments have left in the folder. Raises BarnError in one line for what the user has to change; results
    that were there by then are kept, as they are when the process is interrupted or killed.
    """
    with begun(request, console, make_work, overwrite=overwrite) as drive:
        return drive(None)


@contextmanager
def begun(
    request: Request,
    console: Console,
    make_work: MakeWork | None = None,
    *,
    overwrite: bool = False,
    engine: Engine | None = None,
) -> Iterator[Drive]:
    """Open the folder of an experiment and yield what drives it, as `run_experiment` does, in some worlds at a time.

    That is given numbers of worlds, None for all, and returns all results so far; tables are written once none lacks.
    engine: that of several experiments, which keep no bags.
    """
    experiment, execution = request.experiment, request.execution
    specs = request.trials()
    store = BagStore(request.out.absolute(), experiment.bags)
    work = make_work(experiment, execution, store) if make_work else DirectWork(store)
    with (
        _stopped_by_signals(),
        ResultsFolder.open(
            request.out,
            experiment,
            execution,
            specs,
            request.worlds,
            isolation=work.isolation,
            overwrite=overwrite,
        ) as folder,
    ):
        console.print(
            task_line(experiment.protocol.name, specs[0].task), highlight=False
        )
        if folder.completed:
            console.print(
                f"{len(folder.completed)} of {folder.total} trials are there already"
            )

        def drive(worlds: Collection[int] | None) -> list[TrialResult]:
            left = [
                spec
                for spec in folder.remaining
                if worlds is None or spec.world_number in worlds
            ]
            if left:
                there = folder.results()
                with (
                    nullcontext(engine)
                    if engine
                    else closing(engine_of(execution, work)) as running,
                    ExperimentProgress(
                        len(there) + len(left), there, console
                    ) as progress,
                    closing(
                        run_remaining(
                            folder, running, execution, work, experiment.mode, left
                        )
                    ) as events,
                ):
                    for event in events:
                        progress.take(event)
            results = folder.results() if folder.remaining else folder.complete()
            if text := kept_apart(results):
                console.print(text, markup=False, highlight=False, soft_wrap=True)
            return results

        yield drive


def scored(drive: Drive, worlds: Iterable[int]) -> list[TrialResult]:
    """Return the trials in some worlds; BarnError if one failed by no fault of the planner."""
    chosen = set(worlds)
    results = [one for one in drive(chosen) if one.world in chosen]
    if lost := [one.trial_id for one in results if not one.is_scored]:
        raise BarnError(
            f"{lost[0]} failed by no fault of the planner; the same command runs it again"
        )
    return results


def kept_apart(results: Rows) -> str:
    """Return in one line which trials are not scored because something other than the planner failed; empty if none."""
    apart = [
        f"{one.trial_id} ({one.fault}: {one.detail})"
        for one in results
        if not one.is_scored
    ]
    more = f" and {len(apart) - _NAMED} more" if len(apart) > _NAMED else ""
    text = f"{len(apart)} of {len(results)} trials failed by no fault of the planner and are not scored"
    return (
        f"{text}; the same command runs them again: {', '.join(apart[:_NAMED])}{more}"
        if apart
        else ""
    )


@dataclass(frozen=True)
class Plan:
    """What running an experiment would do."""

    out: str
    mode: str
    worlds: tuple[int, ...]
    planners: tuple[str, ...]
    repetitions: int
    workers: int
    trials: int
    there: int  # of them, which have a result already
    wall_s: float  # what the others take
    disk_bytes: int  # likewise, bags at most
    basis: str  # what these are estimated from


def plan_experiment(request: Request, *, overwrite: bool = False) -> Plan:
    """Return what a request would do; BarnError in one line where it would be refused. Nothing is written."""
    experiment, execution = request.experiment, request.execution
    specs = request.trials()
    checksums = {spec.world_number: spec.world.checksum for spec in specs}
    there = find_completed(
        RunFile.for_run(request.out, experiment, checksums), specs, overwrite=overwrite
    ).results
    left = len(specs) - len(there)
    bag_bytes = _bag_bytes(request.out, there) if experiment.bags != "none" else 0.0
    return Plan(
        out=str(request.out),
        mode=experiment.mode,
        worlds=tuple(checksums),
        planners=tuple(one.name for one in experiment.planners),
        repetitions=experiment.repetitions,
        workers=execution.processes,
        trials=len(specs),
        there=len(there),
        wall_s=left * _trial_s(request, there) / min(execution.processes, max(left, 1)),
        disk_bytes=round(left * (ROW_BYTES + bag_bytes)),
        basis=f"{len(there)} trials in the folder"
        if there
        else "means of the suite's planners in barn300",
    )


def _trial_s(request: Request, there: Rows) -> float:
    if there:
        return fmean(result.wall_clock.duration_s for result in there)
    setup = request.experiment.ros
    if (
        request.experiment.mode == "ros"
        and not setup.lockstep
        and setup.real_time_factor
    ):
        return SIMULATED_S / setup.real_time_factor
    return TRIAL_S[request.experiment.mode]


def _bag_bytes(out: Path, there: Rows) -> float:
    kept = [
        folder for result in there if (folder := out / BAGS / result.trial_id).is_dir()
    ]
    sizes = [sum(file.stat().st_size for file in folder.iterdir()) for folder in kept]
    return fmean(sizes) if sizes else BAG_BYTES


def engine_of(execution: ExecutionConfig, work: Work) -> Engine:
    """Return the workers that an execution asks for."""
    if execution.engine == "ray":
        return RayEngine(
            work, execution.workers, execution.trial_limit_s, execution.address
        )
    if execution.engine == "inline":
        return InlineEngine(work)
    return LocalEngine(work, execution.processes, execution.trial_limit_s)


def direct_engine(execution: ExecutionConfig) -> Engine:
    """Return workers for several experiments of mode direct whose planners are the suite's; see `begun`."""
    return engine_of(execution, DirectWork(BagStore(Path())))


@contextmanager
def _stopped_by_signals() -> Iterator[None]:
    """Let what batch systems and closed terminals send stop an experiment as Ctrl-C does, unless it is ignored."""
    with ExitStack() as kept:
        for number in (signal.SIGTERM, signal.SIGHUP, signal.SIGQUIT):
            if (
                signal.getsignal(number) is not signal.SIG_IGN
            ):  # as SIGHUP is under nohup
                kept.enter_context(signal_handler(number, signal.default_int_handler))
        yield


LINE_PERIOD_S = 30.0
MOST_LINES = 100  # trials, up to which each gets a line of its own


class ExperimentProgress:
    """Show the number of trials, rate, real-time factor, remaining time and outcomes; a context manager."""

    def __init__(self, total: int, earlier: Rows, console: Console) -> None:
        self._total, self._done, self._earlier = total, len(earlier), len(earlier)
        self._outcomes = Counter(result.outcome for result in earlier)
        self._simulated_s, self._note = 0.0, ""
        self._began_s = self._last_line_s = time.monotonic()
        notebook = console.is_jupyter and find_spec("ipywidgets") is not None
        self._watched = console.is_terminal or notebook
        self._bar = Progress(
            BarColumn(bar_width=20),
            MofNCompleteColumn(table_column=Column(no_wrap=True)),
            TextColumn("{task.description}", table_column=Column(ratio=1)),
            console=console,
            expand=True,
            refresh_per_second=2.0,
            disable=not self._watched,
        )
        self._task = self._bar.add_task(self.text(), total=total, completed=self._done)

    def __enter__(self) -> "ExperimentProgress":
        """Begin to show."""
        self._bar.start()
        return self

    def __exit__(self, *_: object) -> None:
        """Show the last state."""
        self._bar.stop()
        if not self._watched:
            self._line()

    def take(self, event: Event) -> None:
        """Take in what has happened."""
        if isinstance(event, Note):
            if event.text != self._note:  # what is waited for is said every few seconds
                self._print(event.text)
            self._note = event.text
            return
        if isinstance(event, Loss):
            self._print(
                f"{event.trial_id}: attempt {event.attempt} lost, {event.reason}"
            )
            return
        self._done += 1
        self._simulated_s += event.scores.duration_s
        self._outcomes[event.outcome] += 1
        if self._total <= MOST_LINES:
            self._print(
                f"[{self._done}/{self._total}] {event.trial_id}: {_ended(event)}"
            )
        self._bar.update(self._task, completed=self._done, description=self.text())
        if not self._watched and time.monotonic() - self._last_line_s >= LINE_PERIOD_S:
            self._line()

    def text(self) -> str:
        """Return rate, real-time factor, remaining time and outcomes."""
        elapsed_s = max(time.monotonic() - self._began_s, 0.001)
        parts = ["starting; new kernels are compiled first"]
        if made := self._done - self._earlier:
            rate, left = made / elapsed_s, self._total - self._done
            parts = [
                f"{60.0 * rate:.1f}/min",
                f"{self._simulated_s / elapsed_s:.1f} x real time",
            ]
            parts += [
                f"{clock(left / rate)} left" if left else f"in {clock(elapsed_s)}"
            ]
        parts += [
            f"{outcome.value} {count}"
            for outcome, count in self._outcomes.most_common()
        ]
        return ", ".join(parts)

    def _line(self) -> None:
        self._last_line_s = time.monotonic()
        self._print(f"{self._done}/{self._total} trials, {self.text()}")

    def _print(self, text: str) -> None:
        self._bar.console.print(text, markup=False, highlight=False, soft_wrap=True)


def clock(duration_s: float) -> str:
    """Return a duration as hours, minutes and seconds."""
    minutes, seconds = divmod(round(duration_s), 60)
    return f"{minutes // 60}:{minutes % 60:02d}:{seconds:02d}"


def _ended(result: TrialResult) -> str:
    ending = result.outcome.value + (f" ({result.detail})" if result.detail else "")
    if result.scores.success:
        ending = f"success in {result.scores.traversal_time_s:.2f} s"
    return ", ".join(
        filter(None, (ending, result.wall_clock.remark, result.wall_clock.retry_note))
    )
