"""Keep what a finished trial leaves: its bag, row, track and commands."""

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
    """What a folder keeps of a trial besides its bag."""

    result: TrialResult
    track: str | None  # line of the track; None if the robot did not drive
    commands: str | None = None  # line of the commands; None if they are not kept
    traceback: str = ""  # of an exception that the planner raised


@dataclass(frozen=True)
class BagStore:
    """The place for trials' bags, which workers share."""

    folder: Path  # the run's folder
    bags: str = "none"  # which trials keep a bag: all, failed or none

    @contextmanager
    def recorder(self, trial_id: str) -> Iterator[Recorder | None]:
        """Yield a recorder for a trial, whose old bag is deleted; None without bags.

        A bag that is not finished in the context keeps its partial name.
        """
        if self.bags == "none":
            yield None
            return
        # Only here: it loads all message types, which runs without bags do not need.
        from barn_eval.results.bags.recorder import Recorder  # noqa: PLC0415

        path = self._bag(trial_id)
        # A run that was killed may have left the bag of a trial without its row.
        if path.exists():
            shutil.rmtree(path)
        with Recorder(path) as recorder:
            yield recorder

    def make_record(self, finished: FinishedTrial) -> TrialRecord:
        """Return what the folder keeps of a trial; delete its bag if it is not kept.

        The bag of a success is not kept if the run keeps bags of failures.
        """
        result = finished.result
        # The outcome is only known after the bag has been written.
        if self.bags == "failed" and result.scores.success:
            shutil.rmtree(self._bag(result.trial_id))
        return TrialRecord(
            result, track_line(finished), commands_line(finished), finished.traceback
        )

    def _bag(self, trial_id: str) -> Path:
        """Return the path of a trial's bag, which need not exist."""
        return self.folder / BAGS / trial_id


def finish_bag(recorder: Recorder, finished: FinishedTrial) -> None:
    """Add specification, versions and result to a bag, and finish it.

    Args:
        recorder: Recorder of the bag.
        finished: The trial, whose specification and result the bag gets.
    """
    trial = {"specification": finished.spec.description(), "versions": versions()}
    recorder.add_metadata("barn.trial", trial)
    recorder.add_metadata("barn.result", {"result": finished.result.repeatable()})
    recorder.finish()
