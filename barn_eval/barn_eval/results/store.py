"""What a finished trial leaves: its bag, its row, its track and its commands."""

from __future__ import annotations

import shutil
from collections.abc import Iterator
from contextlib import contextmanager
from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING

from barn_eval.results.bags import BAGS
from barn_eval.results.commands import commands_line
from barn_eval.results.provenance import versions
from barn_eval.results.tracks import track_line
from barn_eval.trials.result import TrialResult
from barn_eval.trials.trial import FinishedTrial

if TYPE_CHECKING:
    from barn_eval.results.bags.recorder import Recorder

LOGS = "logs"


@dataclass(frozen=True)
class TrialRecord:
    """What a folder keeps of a trial beside its bag."""

    result: TrialResult
    track: str | None  # line of the track, None where nothing was driven
    commands: str | None = None  # line of the commands, None where they are not kept
    traceback: str = ""  # of the exception that the planner raised


@dataclass(frozen=True)
class BagStore:
    """Where trials leave their bags; workers share it."""

    folder: Path  # the run's folder
    bags: str = "none"  # which trials keep a bag: all, failed or none

    @contextmanager
    def recorder(self, trial_id: str) -> Iterator[Recorder | None]:
        """Yield a recorder for a trial's new bag, None if the run keeps no bags.

        An earlier bag of the trial is deleted. One that the context does not finish
        keeps its partial name.
        """
        if self.bags == "none":
            yield None
            return
        # Loads all message types, which runs without bags do not need.
        from barn_eval.results.bags.recorder import Recorder  # noqa: PLC0415

        path = self._bag(trial_id)
        # A run that was killed may have left the bag of a trial without its row.
        if path.exists():
            shutil.rmtree(path)
        with Recorder(path) as recorder:
            yield recorder

    def make_record(self, finished: FinishedTrial) -> TrialRecord:
        """Return what the folder keeps of a trial; delete a bag it does not keep.

        That is the bag of a success where only bags of failures are kept. Nothing is
        written.
        """
        result = finished.result
        # How a trial ends is known only after its bag has been written.
        if self.bags == "failed" and result.scores.success:
            shutil.rmtree(self._bag(result.trial_id))
        return TrialRecord(
            result, track_line(finished), commands_line(finished), finished.traceback
        )

    def _bag(self, trial_id: str) -> Path:
        """Return the path of a trial's bag, whether it is there or not."""
        return self.folder / BAGS / trial_id


def finish_bag(recorder: Recorder, finished: FinishedTrial) -> None:
    """Add specification, versions and result to a bag, and give it its final name.

    Args:
        recorder: Recorder of the bag.
        finished: The trial, whose specification and result the bag gets.
    """
    trial = {"specification": finished.spec.description(), "versions": versions()}
    recorder.add_metadata("barn.trial", trial)
    recorder.add_metadata("barn.result", {"result": finished.result.repeatable()})
    recorder.finish()
