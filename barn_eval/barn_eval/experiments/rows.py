"""Files that survive a kill at any moment: one line of JSON per trial, on the disk before it counts.

The lines of tracks are kept apart from those of results, which people read.
"""

import json
import os
from collections.abc import Sequence
from io import FileIO
from pathlib import Path

from barn_eval.trials.result import TrialResult, from_json_line, to_json_line
from barn_worlds.errors import BarnError, ConfigError

FILE_NAME = "results.jsonl"
TRACKS_NAME = "tracks.jsonl"


class StoreError(BarnError):
    """A result or table that cannot be written; what was written before is whole."""


class ResultRows:
    """The rows of one folder, in the order in which the trials ended; one process writes at a time."""

    def __init__(self, folder: Path) -> None:
        self.path = folder / FILE_NAME

    def append(self, result: TrialResult) -> None:
        """Add a row and see it onto the disk; StoreError, with the rows as they were, if that fails."""
        append_line(self.path, to_json_line(result))

    def replace(self, results: Sequence[TrialResult]) -> None:
        """Keep these rows and no others; StoreError, with the rows as they were, if that fails."""
        write_whole(self.path, "".join(f"{to_json_line(result)}\n" for result in results).encode())

    def read(self) -> list[TrialResult]:
        """Return the rows without a last line that a kill cut off; the file is left as it is.

        Raises ConfigError naming the line for one that is no result, or that repeats a trial.
        """
        lines = whole_lines(self.path)
        rows: dict[str, TrialResult] = {}
        for number, line in enumerate(lines, 1):
            row = from_json_line(line, f"{self.path}, line {number}")
            if row.trial_id in rows:
                raise ConfigError(f"{self.path}, line {number}: trial {row.trial_id} is there already")
            rows[row.trial_id] = row
        return list(rows.values())


class TrackRows:
    """The tracks of one folder, in the order in which the trials ended; one process writes at a time.

    A trial's track is written before its row. Whoever is killed in between leaves a track without a row, and the trial
    is run again: its last track counts.
    """

    def __init__(self, folder: Path) -> None:
        self.path = folder / TRACKS_NAME

    def append(self, line: str) -> None:
        """Add the line of a track and see it onto the disk; StoreError, with the lines as they were, if that fails."""
        append_line(self.path, line)

    def read(self) -> dict[str, str]:
        """Return the lines by the name of their trial, without one that a kill cut off; empty without a file.

        Raises ConfigError naming the line for one that belongs to no trial.
        """
        return {
            _trial_of(line, f"{self.path}, line {number}"): line
            for number, line in enumerate(whole_lines(self.path), 1)
        }

    def arrange(self, order: Sequence[str]) -> None:
        """Bring the lines into an order of trials, one of each, so that the file no longer tells who ended when."""
        before = whole_lines(self.path)
        tracks = self.read()
        after = [tracks[trial_id] for trial_id in order if trial_id in tracks]
        if after != before:
            write_whole(self.path, "".join(f"{line}\n" for line in after).encode())


def append_line(path: Path, line: str) -> None:
    """Add a line to a file and see it onto the disk; StoreError, with the file's whole lines as they were, if not."""
    try:
        with path.open("a+b", buffering=0) as file:
            whole = _drop_torn_line(file)
            try:
                _write_all(file, f"{line}\n".encode())
                os.fsync(file.fileno())
            except OSError:
                file.truncate(whole)
                raise
    except OSError as error:
        raise StoreError(f"{path}: cannot be written: {error.strerror or error}") from None


def whole_lines(path: Path) -> list[str]:
    """Return the lines of a file without a last one that a kill cut off; none if there is no file."""
    try:
        content = path.read_bytes()
    except FileNotFoundError:
        return []
    except OSError as error:
        raise ConfigError(f"{path}: {error.strerror or error}") from None
    return content.decode("utf-8", errors="replace").split("\n")[:-1]


def write_whole(path: Path, content: bytes) -> None:
    """Write a file so that it is there as a whole or as it was before; StoreError if it cannot be written."""
    partial = path.with_name(path.name + ".partial")
    try:
        with partial.open("wb") as file:
            file.write(content)
            file.flush()
            os.fsync(file.fileno())
        partial.replace(path)
        _sync_folder(path.parent)
    except OSError as error:
        partial.unlink(missing_ok=True)
        raise StoreError(f"{path}: cannot be written: {error.strerror or error}") from None


def _trial_of(line: str, where: str) -> str:
    try:
        return str(json.loads(line)["trial_id"])
    except (ValueError, KeyError, TypeError):
        raise ConfigError(f"{where}: not the track of a trial") from None


def _drop_torn_line(file: FileIO) -> int:
    """Cut the file back to its last whole line and return its size."""
    size = file.seek(0, os.SEEK_END)
    file.seek(max(size - 1, 0))
    if size == 0 or file.read(1) == b"\n":
        return size
    file.seek(0)
    whole = file.read().rfind(b"\n") + 1
    file.truncate(whole)
    return whole


def _write_all(file: FileIO, data: bytes) -> None:
    view = memoryview(data)
    while view:
        view = view[file.write(view) :]


def _sync_folder(path: Path) -> None:
    """See a renamed entry onto the disk."""
    descriptor = os.open(path, os.O_RDONLY)
    try:
        os.fsync(descriptor)
    finally:
        os.close(descriptor)
