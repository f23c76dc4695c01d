"""Putting a finished trial away: its picture first, then its row, so that a row never lacks anything."""

from __future__ import annotations

from barn_eval.runs import RunFolder
from barn_eval.trial import FinishedTrial


def store(folder: RunFolder, finished: FinishedTrial) -> None:
    """Draw the picture of a trial and add its result to the run; ConfigError if the folder cannot be written."""
    from barn_eval.picture import draw_trial  # noqa: PLC0415 (matplotlib takes a second to load)

    draw_trial(finished, folder.picture_path(finished.result.trial_id))
    folder.append(finished.result)
