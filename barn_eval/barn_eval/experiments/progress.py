"""How far a campaign is: a bar where somebody watches, a line now and then elsewhere."""

from __future__ import annotations

import time
from collections import Counter
from collections.abc import Sequence
from types import TracebackType

from rich.console import Console
from rich.progress import BarColumn, MofNCompleteColumn, Progress, TextColumn

from barn_eval.experiments.runner import Loss
from barn_eval.trials.result import TrialResult

LINE_PERIOD_S = 30.0


class CampaignProgress:
    """Show the number of trials, rate, real-time factor, remaining time and outcomes; a context manager.

    Rates are those of this session. On a terminal, a bar; else a plain line every half minute and at the end.
    """

    def __init__(self, total: int, earlier: Sequence[TrialResult], console: Console) -> None:
        self._console = console
        self._total = total
        self._outcomes = Counter(result.outcome for result in earlier)
        self._done = len(earlier)
        self._session = 0
        self._simulated_s = 0.0
        self._began_s = self._last_line_s = time.monotonic()
        self._bar = Progress(
            TextColumn("trials"),
            BarColumn(),
            MofNCompleteColumn(),
            TextColumn("{task.description}"),
            console=console,
            refresh_per_second=2.0,
            disable=not console.is_terminal,
        )
        self._task = self._bar.add_task(self.text(), total=total, completed=self._done)

    def __enter__(self) -> CampaignProgress:
        """Begin to show."""
        self._bar.start()
        return self

    def __exit__(
        self, kind: type[BaseException] | None, error: BaseException | None, trace: TracebackType | None
    ) -> None:
        """Show the last state."""
        self._bar.stop()
        if not self._console.is_terminal:
            self._line()

    def take(self, event: TrialResult | Loss) -> None:
        """Take in what has happened."""
        if isinstance(event, Loss):
            note = f"{event.trial_id}: attempt {event.attempt} lost, {event.reason}"
            self._bar.console.print(note, markup=False, highlight=False, soft_wrap=True)
            return
        self._done += 1
        self._session += 1
        self._simulated_s += event.scores.duration_s
        self._outcomes[event.outcome] += 1
        self._bar.update(self._task, completed=self._done, description=self.text())
        if not self._console.is_terminal and time.monotonic() - self._last_line_s >= LINE_PERIOD_S:
            self._line()

    def text(self) -> str:
        """Return rate, real-time factor, remaining time and outcomes."""
        elapsed_s = time.monotonic() - self._began_s
        parts = []
        if self._session:
            rate = self._session / elapsed_s
            remaining_s = (self._total - self._done) / rate
            parts = [f"{60.0 * rate:.1f}/min", f"{self._simulated_s / elapsed_s:.1f} x real time"]
            parts += [f"{clock(remaining_s)} left"] if self._done < self._total else [f"in {clock(elapsed_s)}"]
        parts += [f"{outcome.value} {count}" for outcome, count in self._outcomes.most_common()]
        return ", ".join(parts)

    def _line(self) -> None:
        self._last_line_s = time.monotonic()
        text = f"{self._done}/{self._total} trials, {self.text()}".rstrip(", ")
        self._console.print(text, markup=False, highlight=False, soft_wrap=True)


def clock(duration_s: float) -> str:
    """Return a duration as hours, minutes and seconds."""
    minutes, seconds = divmod(round(duration_s), 60)
    hours, minutes = divmod(minutes, 60)
    return f"{hours}:{minutes:02d}:{seconds:02d}"
