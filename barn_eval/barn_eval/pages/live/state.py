"""How a run or campaign stands, from its files alone, finished or not: for a page that updates itself."""

from collections import Counter
from collections.abc import Sequence
from datetime import datetime, timedelta
from pathlib import Path
from typing import Any

from barn_eval.analysis.bars import bars
from barn_eval.analysis.measures import metric_of
from barn_eval.analysis.planners import spelling
from barn_eval.analysis.sources import Source, entries_of, read_source
from barn_eval.analysis.summary import summarise
from barn_eval.analysis.verdict import cautions, results_verdict
from barn_eval.bags import BAGS
from barn_eval.experiments.rows import FILE_NAME, ResultRows
from barn_eval.experiments.run_file import RunFile
from barn_eval.pages.template import themed
from barn_eval.trials.identity import task_line
from barn_eval.trials.outcome import Outcome
from barn_eval.trials.result import TrialResult
from barn_worlds.base.errors import BarnError, ConfigError

MOST_LISTED = 50  # trials and failures
_RECENT = 60  # trials, from whose times the rate is taken


class CampaignState:
    """The state of a folder as plain data, computed anew only when its results have changed."""

    def __init__(self, folder: Path) -> None:
        RunFile.read(folder)
        self.folder = folder
        self._seen: tuple[int, int] | None = None
        self._state: dict[str, Any] = {}

    def read(self) -> dict[str, Any]:
        """Return the state: progress, verdict, bars, failures and last trials; "problem" where files cannot be read."""
        path = self.folder / FILE_NAME
        found = path.stat() if path.exists() else None
        seen = (found.st_size, found.st_mtime_ns) if found else (0, 0)
        if seen != self._seen or not self._state:
            try:
                self._state = state_of(self.folder)
            except (BarnError, OSError) as error:
                self._state = {"title": self.folder.resolve().name, "problem": str(error)}
            self._seen = seen
        return self._state

    def bag(self, trial_id: str) -> Path:
        """Return the bag of a trial of this folder; ConfigError if it has none, or if that lies elsewhere."""
        bag = self.folder / BAGS / trial_id
        known = trial_id in {result.trial_id for result in ResultRows(self.folder).read()}
        if not known or not bag.is_dir() or self.folder.resolve() not in bag.resolve().parents:
            raise ConfigError(f"{trial_id[:100]!r}: there is no bag of a trial of this name")
        return bag


def state_of(folder: Path) -> dict[str, Any]:
    """Return how an experiment stands; BarnError if its files do not belong together."""
    rows = ResultRows(folder).read()
    source = read_source(folder, rows)
    results = source.results
    state: dict[str, Any] = {
        "title": folder.resolve().name,
        "problem": "",
        "done": len(results),
        "planned": source.planned,
        "again": sum(not row.counts for row in rows),
        "outcomes": [(_words(name), count) for name, count in Counter(one.outcome for one in results).most_common()],
        **_pace(rows, source.planned),
        "failures": [_trial(folder, row) for row in rows[::-1] if not row.scores.success][:MOST_LISTED],
        "latest": [_trial(folder, row) for row in rows[::-1][:MOST_LISTED]],
    }
    return state | (_leader(source) if results else {"verdict": "No trial has ended yet.", "bars": [], "notes": []})


def _leader(source: Source) -> dict[str, Any]:
    entries = entries_of([source])
    metric = metric_of(source.results)
    summaries = [summarise(entry.results, (metric.key,)) for entry in entries]
    first = source.results[0]
    try:
        told = results_verdict({entry.label: entry.results for entry in entries})
    except BarnError as error:
        told = str(error)
    return {
        "task": task_line(first.protocol, first.task),
        "metric": metric.heading,
        "verdict": told,
        "notes": cautions(max(one.worlds for one in summaries)),
        "bars": [bar | {"colour": themed(bar["colour"])} for bar in bars(entries, summaries)],
    }


def _pace(rows: Sequence[TrialResult], planned: int | None) -> dict[str, Any]:
    """Return when the last trial ended (ISO 8601), trials per minute of the last ones, and seconds left at that."""
    ends = sorted(end for end in map(_end, rows[-_RECENT:]) if end is not None)
    span_s = (ends[-1] - ends[0]).total_seconds() if ends else 0.0
    if span_s <= 0.0:
        return {"last": ends[-1].isoformat() if ends else "", "per_minute": None, "left_s": None}
    rate = (len(ends) - 1) / span_s
    left = max(0, planned - sum(row.counts for row in rows)) / rate if planned else None
    return {"last": ends[-1].isoformat(), "per_minute": 60.0 * rate, "left_s": left}


def _end(row: TrialResult) -> datetime | None:
    try:
        began = datetime.fromisoformat(row.wall_clock.started_at)
    except ValueError:  # rows of the evaluator do not say
        return None
    return began + timedelta(seconds=row.wall_clock.duration_s) if began.tzinfo else None


def _trial(folder: Path, row: TrialResult) -> dict[str, Any]:
    return {
        "id": row.trial_id,
        "planner": spelling(row.planner),
        "world": row.world,
        "outcome": _words(row.outcome),
        "detail": row.detail,
        "counts": row.counts,
        "time_s": row.scores.traversal_time_s if row.scores.success else None,
        "bag": (folder / BAGS / row.trial_id).is_dir(),
    }


def _words(outcome: Outcome) -> str:
    return outcome.value.replace("_", " ")
