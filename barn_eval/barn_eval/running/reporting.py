"""What a run tells its user while it goes on: to a logger, or on a console."""

import logging
import math
import time
from collections import Counter, defaultdict
from collections.abc import Iterator, Sequence
from contextlib import contextmanager
from dataclasses import dataclass
from enum import Enum
from importlib.util import find_spec
from typing import Any

from rich.console import Console, RenderableType
from rich.highlighter import RegexHighlighter
from rich.progress import (
    BarColumn,
    MofNCompleteColumn,
    Progress,
    ProgressColumn,
    TextColumn,
)
from rich.table import Column, Table

from barn_eval.running.pool import Notice
from barn_eval.running.runner import Event, TrialLoss
from barn_eval.trials.result import Outcome, TrialResult
from barn_worlds.base.errors import strip_controls

logger = logging.getLogger(__name__)

LINE_PERIOD_S = 30.0
"""Time between two lines on the state of a run that nobody watches [s]."""

_MAX_TALLIES = 12  # planners in the live table


_FAILURES = "|".join(
    outcome.value for outcome in Outcome if outcome is not Outcome.SUCCESS
)


class OutcomeColors(RegexHighlighter):
    """Colors the names of outcomes; rich heeds the variable NO_COLOR."""

    highlights = (r"\b(?P<green>success)\b", rf"\b(?P<red>{_FAILURES})\b")


class Verbosity(Enum):
    """What a console shows of a run, by the most trials that have a line each."""

    QUIET = 0  # only warnings
    NORMAL = 10
    VERBOSE = math.inf


class Reporter:
    """Receives the notices and the progress of runs, and logs them."""

    max_trial_lines: float = 100
    """Most trials of a run for which each trial has a line."""

    def __init__(self, log: Any = logger):
        """Log to a logger of Python or of a ROS node."""
        self._log = log

    def notify(self, text: str) -> None:
        """Log a line of text at level INFO."""
        self._log.info(text)

    def warn(self, text: str) -> None:
        """Log a line of text at level WARNING."""
        self._log.warning(text)

    @contextmanager
    def show_progress(self, progress: "RunProgress") -> Iterator[None]:
        """Log the state of a run when the context ends, unless it was just logged."""
        try:
            yield
        finally:
            # After the last trial, `update` may just have logged it.
            if progress.count != progress.last_line_count:
                self.notify(progress.line())

    def update(self, progress: "RunProgress") -> None:
        """Log the state of a run if its last line is at least `LINE_PERIOD_S` old."""
        if progress.is_line_due():
            self.notify(progress.line())


class ConsoleReporter(Reporter):
    """Prints notices and, on a terminal or in a notebook, a table with a bar."""

    def __init__(self, console: Console, verbosity: Verbosity = Verbosity.NORMAL):
        """Print to a console of rich; there is no bar before `show_progress`."""
        self._console = console
        self._verbosity = verbosity
        self.max_trial_lines = verbosity.value
        self._bar: Progress

    @property
    def _shows_bar(self) -> bool:
        """Whether a bar shows: on a terminal or notebook with widgets, unless quiet."""
        if self._verbosity is Verbosity.QUIET:
            return False
        # Notebooks need widgets for a bar; without them, they get lines.
        if self._console.is_jupyter:
            return find_spec("ipywidgets") is not None
        # A log file would get every state of the bar.
        return self._console.is_terminal

    def notify(self, text: str) -> None:
        """Print a line of text to the console unless it is quiet."""
        if self._verbosity is not Verbosity.QUIET:
            self.warn(text)

    def warn(self, text: str) -> None:
        """Print a line to the console without control characters, outcomes in color."""
        text = strip_controls(text)
        self._console.print(OutcomeColors()(text), soft_wrap=True)

    @contextmanager
    def show_progress(self, progress: "RunProgress") -> Iterator[None]:
        """Show planners and a bar until the context ends; or lines, if no terminal."""
        if not self._shows_bar:
            with super().show_progress(progress):
                yield
            return
        with _LiveTable(
            progress,
            BarColumn(bar_width=20),
            MofNCompleteColumn(table_column=Column(no_wrap=True)),
            TextColumn(
                "{task.description}",
                highlighter=OutcomeColors(),
                table_column=Column(ratio=1),
            ),
            console=self._console,
            expand=True,
            refresh_per_second=2.0,
        ) as self._bar:
            self._bar.add_task(
                progress.text(), total=progress.total, completed=progress.count
            )
            yield

    def update(self, progress: "RunProgress") -> None:
        """Move the bar; without a terminal, print a line every `LINE_PERIOD_S`."""
        if not self._shows_bar:
            super().update(progress)
            return
        for task in self._bar.task_ids:
            self._bar.update(
                task, completed=progress.count, description=progress.text()
            )


class _LiveTable(Progress):
    """A bar below a table of the planners so far."""

    def __init__(
        self, progress: "RunProgress", *columns: ProgressColumn, **options: Any
    ):
        """Show the tallies of `progress`; the rest is as for `Progress`."""
        self._progress = progress
        super().__init__(*columns, **options)

    def get_renderables(self) -> Iterator[RenderableType]:
        """Yield a table, for 2 to 12 planners so far, and the bar."""
        tallies = self._progress.tallies
        if 1 < len(tallies) <= _MAX_TALLIES:
            grid = Table.grid(padding=(0, 2))
            grid.add_row("planner", "trials", "success", "score")
            for name, tally in tallies.items():
                success = f"{100.0 * tally.successes / tally.trials:.0f}%"
                score = f"{tally.score_sum / tally.trials:.3f}"
                grid.add_row(name, str(tally.trials), success, score)
            yield grid
        yield from super().get_renderables()


def make_reporter(progress: "bool | Reporter") -> Reporter:
    """Return a given reporter, or one with a bar on stderr, or else one that logs.

    Args:
        progress: Whether to show progress in a terminal or notebook; elsewhere, and
            without it, the reporter logs. Or the reporter itself.
    """
    if isinstance(progress, Reporter):
        return progress
    console = Console(stderr=True)
    if progress and (console.is_terminal or console.is_jupyter):
        return ConsoleReporter(console)
    return Reporter()


@dataclass
class Tally:
    """Figures of a planner's trials so far."""

    trials: int = 0
    successes: int = 0

    score_sum: float = 0.0
    """Sum of the measure by which the protocol ranks."""

    def add(self, result: TrialResult) -> None:
        """Add a trial to the counts, and its score, NaN if missing, to the sum."""
        self.trials += 1
        self.successes += result.scores.success
        # Rows of schema 1 do not name the measure.
        score = getattr(result.scores, result.metric or "challenge", None)
        self.score_sum += math.nan if score is None else score


class RunProgress:
    """Counts the trials of a run and their outcomes, and tells a reporter of both."""

    def __init__(
        self, total: int, completed: Sequence[TrialResult], reporter: Reporter
    ):
        """Begin to count a session's trials, on top of those of earlier sessions.

        Args:
            total: Number of trials, with those of earlier sessions.
            completed: Results of earlier sessions.
            reporter: Receives lines and progress.
        """
        self.total = total
        self.count = len(completed)
        self.reporter = reporter
        self._earlier_count = len(completed)
        self._outcomes: Counter[Outcome] = Counter()
        self.tallies: defaultdict[str, Tally] = defaultdict(Tally)
        for result in completed:
            self._count(result)
        self._simulated_s = 0.0
        self._start_s = time.monotonic()
        self._last_line_s = self._start_s
        self.last_line_count = -1
        self._last_notice = ""
        self._quotations: set[str] = set()

    def take(self, event: Event) -> None:
        """Tell the reporter of an event; count it if it is a trial's result."""
        if isinstance(event, Notice):
            # Workers repeat what they wait for every few seconds.
            if event.is_warning:
                self.reporter.warn(event.text)
            elif event.text != self._last_notice:
                self.reporter.notify(self._without_repetition(event.text))
            self._last_notice = event.text
        elif isinstance(event, TrialLoss):
            self.reporter.warn(
                f"{event.trial_id}: attempt {event.attempt} was lost: {event.reason}"
            )
        else:
            self._take_result(event)

    def _without_repetition(self, text: str) -> str:
        """Return a notice; lines after its first come only once, later "as above"."""
        first_line, _, quotation = text.partition("\n")
        if not quotation:
            return text
        if quotation in self._quotations:
            # All workers meet the same error.
            return f"{first_line} as above"
        self._quotations.add(quotation)
        return text

    def _take_result(self, result: TrialResult) -> None:
        """Count a result; report it in a line unless the run has too many trials."""
        self.count += 1
        self._simulated_s += result.scores.duration_s
        self._count(result)
        if self.total <= self.reporter.max_trial_lines:
            self.reporter.notify(
                f"[{self.count}/{self.total}] {result.trial_id}: {describe_end(result)}"
            )
        self.reporter.update(self)

    def _count(self, result: TrialResult) -> None:
        """Count the outcome of a result, of this session or an earlier one."""
        self._outcomes[result.outcome] += 1
        self.tallies[result.planner].add(result)

    def is_line_due(self) -> bool:
        """Return whether the last line is at least `LINE_PERIOD_S` old."""
        return time.monotonic() - self._last_line_s >= LINE_PERIOD_S

    def line(self) -> str:
        """Return the state of the run in a line, and note its time and count."""
        self._last_line_s = time.monotonic()
        self.last_line_count = self.count
        return f"{self.count}/{self.total} trials, {self.text()}"

    def text(self) -> str:
        """Return trials per minute, real-time factor, time left and outcomes."""
        # Rates are those of this session: earlier ones may have had other workers.
        # A first trial may end in the instant in which the session begins.
        elapsed_s = max(time.monotonic() - self._start_s, 0.001)
        session_count = self.count - self._earlier_count
        duration = format_duration(elapsed_s)
        parts = [f"running for {duration}; new kernels are compiled first"]
        # Without a trial there is no rate to go by.
        if session_count:
            rate = session_count / elapsed_s
            remaining = self.total - self.count
            time_text = f"in {duration}"
            if remaining:
                time_text = f"{format_duration(remaining / rate)} left"
            parts = [
                f"{60.0 * rate:.1f}/min",
                f"{self._simulated_s / elapsed_s:.1f} x real time",
                time_text,
            ]
        for outcome, count in self._outcomes.most_common():
            parts.append(f"{outcome.value} {count}")
        return ", ".join(parts)


def format_duration(duration_s: float) -> str:
    """Return a duration in seconds as H:MM:SS."""
    minutes, seconds = divmod(round(duration_s), 60)
    return f"{minutes // 60}:{minutes % 60:02d}:{seconds:02d}"


def describe_end(result: TrialResult) -> str:
    """Return a trial's time or outcome in words, with remarks on its machine."""
    end = result.outcome.value
    if result.scores.success:
        end = f"success in {result.scores.traversal_time_s:.2f} s"
    elif result.detail:
        end = f"{end} ({result.detail})"
    remarks = (end, result.wall_clock.remark, result.wall_clock.retry_note)
    return ", ".join(filter(None, remarks))
