"""What a finished trial leaves: its bag in its experiment's folder, and row and track, to be kept last."""

from __future__ import annotations

import shutil
from collections.abc import Iterator
from contextlib import contextmanager
from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING

from barn_eval.results.bags import BAGS
from barn_eval.results.provenance import versions
from barn_eval.results.tracks import track_line
from barn_eval.trials.result import TrialResult
from barn_eval.trials.trial import FinishedTrial

if TYPE_CHECKING:
    from barn_eval.results.bags.recorder import Recorder

LOGS = "logs"


@dataclass(frozen=True)
class TrialRecord:
    """What is kept of a trial: its result, the line of its track, None where nothing was driven, and a traceback."""

    result: TrialResult
    track: str | None
    traceback: str = ""


@dataclass(frozen=True)
class BagStore:
    """Where trials leave their bags; workers share it."""

    folder: Path
    bags: str = "none"

    @contextmanager
    def recorder(self, trial_id: str) -> Iterator[Recorder | None]:
        """Give the recorder of a trial's bag, None where none is asked for; a bag that is not finished is abandoned."""
        if self.bags == "none":
            yield None
            return
        from barn_eval.results.bags.recorder import Recorder  # noqa: PLC0415 (loads all message types)

        if (path := self._bag(trial_id)).exists():
            shutil.rmtree(path)
        with Recorder(path) as recorder:
            yield recorder

    def make_record(self, finished: FinishedTrial) -> TrialRecord:
        """Drop a bag that is not wanted, and return what else is to be kept."""
        result = finished.result
        if self.bags == "failed" and result.scores.success:
            shutil.rmtree(self._bag(result.trial_id))
        return TrialRecord(result, track_line(finished), finished.traceback)

    def _bag(self, trial_id: str) -> Path:
        return self.folder / BAGS / trial_id


def finish_bag(recorder: Recorder, finished: FinishedTrial) -> None:
    """Complete the bag of a trial with its specification and its result."""
    recorder.add_metadata(
        "barn.trial",
        {"specification": finished.spec.description(), "versions": versions()},
    )
    recorder.add_metadata("barn.result", {"result": finished.result.repeatable()})
    recorder.finish()
