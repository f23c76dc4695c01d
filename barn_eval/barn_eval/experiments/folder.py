"""The folder of a campaign.

OUT/run.json                    configuration and checksums of worlds; versions, commit and machine of each session
OUT/results.jsonl               one line per finished trial, on the disk before it counts, in the order they ended
OUT/tracks.jsonl                one line per trial that began: what the robot did; at the end in the plan's order
OUT/results.parquet, .csv       results in the order of the plan, without wall-clock figures; at the end
OUT/timing.parquet, .csv        the wall-clock figures
OUT/bags/TRIAL_ID/              rosbag2 directories, where asked for
OUT/pictures/TRIAL_ID.png       of mode ros
OUT/losses/TRIAL_ID.txt         what is known of attempts that gave no result
"""

from __future__ import annotations

import fcntl
import json
import os
from collections.abc import Iterator, Mapping, Sequence
from contextlib import contextmanager
from datetime import datetime, timezone
from pathlib import Path
from typing import Any

from barn_eval.experiments.config import CampaignConfig, ExecutionConfig
from barn_eval.experiments.provenance import provenance
from barn_eval.experiments.rows import ResultRows, StoreError, TrackRows, write_whole
from barn_eval.experiments.tables import write_tables
from barn_eval.trials.result import TrialResult
from barn_eval.trials.spec import TrialSpec
from barn_worlds.config import as_dict
from barn_worlds.errors import ConfigError
from barn_worlds.text_files import read_json

SCHEMA_VERSION = 1
_MISSING = object()


class CampaignFolder:
    """The results of one campaign; `remaining` holds the trials that have none yet, in order."""

    def __init__(self, path: Path, specs: Sequence[TrialSpec], results: Sequence[TrialResult]) -> None:
        self.path = path
        self._rows = ResultRows(path)
        self._tracks = TrackRows(path)
        self._order = [spec.trial_id for spec in specs]
        self._results = {result.trial_id: result for result in results}
        self.remaining = [spec for spec in specs if spec.trial_id not in self._results]

    @property
    def total(self) -> int:
        """Number of trials of the whole campaign."""
        return len(self._order)

    def results(self) -> list[TrialResult]:
        """Return the results so far in the order of the plan."""
        return [self._results[trial_id] for trial_id in self._order if trial_id in self._results]

    def append(self, result: TrialResult, track: str | None = None) -> None:
        """Keep a result and, before it, the line of its track.

        Raises StoreError if they cannot be written, ValueError if the trial has a result already.
        """
        if result.trial_id in self._results:
            raise ValueError(f"trial {result.trial_id} has a result already")
        if track is not None:
            self._tracks.append(track)
        self._rows.append(result)
        self._results[result.trial_id] = result

    def note_loss(self, trial_id: str, text: str) -> None:
        """Keep what is known of an attempt that gave no result; StoreError if it cannot be written."""
        path = self.path / "losses" / f"{trial_id}.txt"
        try:
            path.parent.mkdir(exist_ok=True)
            with path.open("a", encoding="utf-8") as file:
                file.write(f"{datetime.now(timezone.utc).isoformat(timespec='seconds')} {text}\n")
        except OSError as error:
            raise StoreError(f"{path}: cannot be written: {error.strerror or error}") from None

    def complete(self) -> list[TrialResult]:
        """Write the tables and put the tracks in order, now that no trial is missing, and return all results."""
        results = self.results()
        if len(results) != self.total:
            raise ValueError(f"{self.total - len(results)} trials have no result")
        write_tables(self.path, results)
        self._tracks.arrange(self._order)
        return results


@contextmanager
def opened(
    path: Path, config: CampaignConfig, execution: ExecutionConfig, specs: Sequence[TrialSpec]
) -> Iterator[CampaignFolder]:
    """Begin a campaign in a folder, or go on with it, alone for as long as the context lasts.

    Raises ConfigError if the folder holds another campaign, one with other worlds, or anything else; StoreError if it
    cannot be written.
    """
    try:
        path.mkdir(parents=True, exist_ok=True)
        lock = os.open(path / ".lock", os.O_RDWR | os.O_CREAT | os.O_CLOEXEC, 0o644)
    except OSError as error:
        raise StoreError(f"{path}: cannot be written: {error.strerror or error}") from None
    try:
        _take(lock, path)
        results = _checked_results(path, specs) if _begin_session(path, config, execution, specs) else []
        yield CampaignFolder(path, specs, results)
    finally:
        os.close(lock)


def read_results(path: Path) -> list[TrialResult]:
    """Return the results of a run or campaign, finished or not; ConfigError if there are none."""
    results = ResultRows(path).read()
    if not results:
        raise ConfigError(f"{path}: holds no results of a run or campaign")
    return results


def read_run(path: Path) -> dict[str, Any]:
    """Return the content of a campaign's run.json; ConfigError if it cannot be read."""
    where = path / "run.json"
    content = read_json(where)
    if not isinstance(content, dict) or "campaign" not in content:
        raise ConfigError(f"{where}: holds no campaign")
    if content.get("schema_version") != SCHEMA_VERSION:
        raise ConfigError(f"{where}: schema_version must be {SCHEMA_VERSION}, got {content.get('schema_version')!r}")
    return content


def _take(lock: int, path: Path) -> None:
    try:
        fcntl.flock(lock, fcntl.LOCK_EX | fcntl.LOCK_NB)
    except BlockingIOError:
        raise ConfigError(f"{path}: another process is working on this campaign") from None


def _begin_session(path: Path, config: CampaignConfig, execution: ExecutionConfig, specs: Sequence[TrialSpec]) -> bool:
    """Write run.json with this session added and return whether there were others before."""
    known = (path / "run.json").exists()
    if not known and any(entry.name != ".lock" for entry in path.iterdir()):
        raise ConfigError(f"{path}: is not empty and holds no campaign")
    content: dict[str, Any] = {
        "schema_version": SCHEMA_VERSION,
        "campaign": as_dict(config),
        "worlds": {str(spec.index): spec.world.checksum for spec in specs},
        "sessions": [],
    }
    if known:
        earlier = read_run(path)
        _compare(path, earlier["campaign"], content["campaign"], "configuration")
        _compare(path, earlier["worlds"], content["worlds"], "checksum of world")
        content["sessions"] = earlier["sessions"]
    session = {"started_at": datetime.now(timezone.utc).isoformat(timespec="seconds")}
    content["sessions"] = [*content["sessions"], session | {"execution": as_dict(execution)} | provenance()]
    write_whole(path / "run.json", (json.dumps(content, indent=1) + "\n").encode())
    return known


def _compare(path: Path, there: Mapping[str, Any], here: Mapping[str, Any], what: str) -> None:
    """Raise ConfigError naming the first key whose value differs."""
    old, new = (dict(_leaves(json.loads(json.dumps(content)))) for content in (there, here))
    for key in [*new, *old]:
        before, now = old.get(key, _MISSING), new.get(key, _MISSING)
        if before != now:
            shown = ["not set" if value is _MISSING else repr(value) for value in (before, now)]
            raise ConfigError(
                f"{path}: holds a campaign of another {what}: {key} is {shown[0]} there, {shown[1]} here;"
                " use another folder"
            )


def _leaves(content: Any, name: str = "") -> Iterator[tuple[str, Any]]:
    pairs = content.items() if isinstance(content, dict) else enumerate(content) if isinstance(content, list) else ()
    for key, value in pairs:
        yield from _leaves(value, f"{name}.{key}" if name else str(key))
    if not isinstance(content, (dict, list)) or not content:
        yield name, content


def _checked_results(path: Path, specs: Sequence[TrialSpec]) -> list[TrialResult]:
    results = ResultRows(path).read()
    known = {spec.trial_id for spec in specs}
    for result in results:
        if result.trial_id not in known:
            raise ConfigError(f"{path}: holds a result of {result.trial_id}, which is no trial of this campaign")
    return results
