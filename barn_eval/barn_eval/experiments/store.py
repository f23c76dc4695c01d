"""Putting a finished trial away: its picture and track first, then its row, so that a row never lacks anything."""

from __future__ import annotations

from barn_eval.experiments.rows import TrackRows
from barn_eval.experiments.runs import RunFolder
from barn_eval.experiments.track import track_line
from barn_eval.trials.spec import FinishedTrial


def store(folder: RunFolder, finished: FinishedTrial) -> None:
    """Draw the picture of a trial and add its track and result to the run.

    Raises ConfigError or StoreError if the folder cannot be written.
    """
    from barn_eval.experiments.picture import draw_trial  # noqa: PLC0415 (matplotlib takes a second to load)

    draw_trial(finished, folder.picture_path(finished.result.trial_id))
    if (line := track_line(finished)) is not None:
        TrackRows(folder.path).append(line)
    folder.append(finished.result)
