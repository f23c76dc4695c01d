"""How far an experiment is: a bar where somebody watches, lines elsewhere."""

from __future__ import annotations

import time
from collections import Counter
from collections.abc import Sequence
from importlib.util import find_spec

from rich.console import Console
from rich.progress import BarColumn, MofNCompleteColumn, Progress, TextColumn
from rich.table import Column

from barn_eval.experiments.engine import Note
from barn_eval.experiments.runner import Event, Loss
from barn_eval.trials.result import TrialResult

LINE_PERIOD_S = 30.0
MOST_LINES = 100  # trials, up to which each gets a line of its own


class ExperimentProgress:
    """Show the number of trials, rate, real-time factor, remaining time and outcomes; a context manager."""

    def __init__(self, total: int, earlier: Sequence[TrialResult], console: Console) -> None:
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

    def __enter__(self) -> ExperimentProgress:
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
            self._print(f"{event.trial_id}: attempt {event.attempt} lost, {event.reason}")
            return
        self._done += 1
        self._simulated_s += event.scores.duration_s
        self._outcomes[event.outcome] += 1
        if self._total <= MOST_LINES:
            self._print(f"[{self._done}/{self._total}] {event.trial_id}: {_ending(event)}")
        self._bar.update(self._task, completed=self._done, description=self.text())
        if not self._watched and time.monotonic() - self._last_line_s >= LINE_PERIOD_S:
            self._line()

    def text(self) -> str:
        """Return rate, real-time factor, remaining time and outcomes."""
        elapsed_s = max(time.monotonic() - self._began_s, 0.001)
        parts = ["starting; new kernels are compiled first"]
        if made := self._done - self._earlier:
            rate, left = made / elapsed_s, self._total - self._done
            parts = [f"{60.0 * rate:.1f}/min", f"{self._simulated_s / elapsed_s:.1f} x real time"]
            parts += [f"{clock(left / rate)} left" if left else f"in {clock(elapsed_s)}"]
        parts += [f"{outcome.value} {count}" for outcome, count in self._outcomes.most_common()]
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


def _ending(result: TrialResult) -> str:
    ending = f"{result.outcome.value} ({result.detail})" if result.detail else result.outcome.value
    if result.scores.success:
        ending = f"success in {result.scores.traversal_time_s:.2f} s"
    return ", ".join(filter(None, (ending, result.wall_clock.remark, result.wall_clock.retried)))
