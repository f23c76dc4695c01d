"""The folder of a run.

OUT/run.json                configuration and checksums of worlds; versions, commit and
                            machine of each session
OUT/worlds.npz              the worlds, if they were given as Python objects
OUT/results.jsonl           one line per finished trial, on the disk before it counts,
                            in the order in which trials ended
OUT/tracks.jsonl            one line per trial that began: what the robot did; in the
                            order of trials once the run is complete
OUT/commands.jsonl          one line per trial that can be driven again: its commands
OUT/results.parquet, .csv   results in the order of trials, without wall-clock figures,
                            once the run is complete
OUT/timing.parquet, .csv    the wall-clock figures
OUT/bags/TRIAL_ID/          rosbag2 directories, if the run keeps them
OUT/losses/TRIAL_ID.txt     when attempts began, and what is known of those that gave no
                            result; deleted if the first attempt gave a score
OUT/tracebacks/TRIAL_ID.txt of planners that raised an exception in mode direct
OUT/logs/                   of mode ros: what the nodes printed
OUT/replays/                pages of replays, and bags made for them afterwards
"""

import fcntl
import os
import re
import shutil
from collections.abc import Iterable, Iterator, Mapping, Sequence
from contextlib import contextmanager, suppress
from dataclasses import dataclass, replace
from datetime import datetime, timezone
from pathlib import Path
from typing import Any

import numpy as np

from barn_eval.results.bags import BAGS
from barn_eval.results.row_table import column, take
from barn_eval.results.rows import (
    COMMANDS_FILE,
    ROWS_FILE,
    TABLE_FILES,
    TRACKS_FILE,
    RowFile,
    TrialLines,
    append_line,
    write_tables,
)
from barn_eval.results.run_file import RUN_FILE, WORLDS, WORLDS_MANIFEST, RunFile
from barn_eval.results.store import LOGS, TrialRecord
from barn_eval.trials.result import ENVIRONMENT, SIMULATOR, Rows, TrialResult
from barn_eval.trials.run_config import UNKNOWN_SOURCE, ExecutionConfig, RunConfig
from barn_eval.trials.spec import TrialSpec
from barn_eval.trials.system import ObservedTrial
from barn_worlds.base.errors import ConfigError, StoreError, convert_os_errors
from barn_worlds.base.files import PARTIAL_SUFFIX, remove_partial_files
from barn_worlds.formats.dataset_file import write_dataset_file
from barn_worlds.worlds.world import World

LOSSES = "losses"
_BEGUN = "begun"
REPLAYS = "replays"
TRACEBACKS = "tracebacks"
_LOCK = ".lock"


class ResultsFolder:
    """The results of one run, open for writing.

    Attributes:
        path: The folder.
        completed: Results that the folder had when it was opened, in the order of trials.
            Later ones are only in the files, so that memory does not grow.
    """

    def __init__(self, path: Path, specs: Sequence[TrialSpec], results: Rows):
        """Prepare a folder that `open` has locked, without reading or writing files.

        `results` are the scored rows that the folder has.
        """
        self.path = path
        self._stat = path.stat()
        self._rows = RowFile(path)
        self._places = {spec.trial_id: place for place, spec in enumerate(specs)}
        self.completed = self._in_order(results)
        self._completed_ids = set(column(results, "trial_id"))
        self._schedule = order_trials_fairly(specs)

    @classmethod
    @contextmanager
    def open(
        cls,
        path: Path,
        config: RunConfig,
        execution: ExecutionConfig,
        specs: Sequence[TrialSpec],
        worlds: Mapping[int, World] | None = None,
        *,
        isolation: str = "",
        overwrite: bool = False,
    ) -> "Iterator[ResultsFolder]":
        """Lock a folder, begin or resume its run, and delete what does not count.

        This writes run.json and removes rows that do not count, and tracks and commands
        of trials without a row. If no row counts, or with `overwrite`, everything that
        an earlier run has written is removed.

        Args:
            path: Folder, which need not exist.
            config: Configuration of the run.
            execution: How this session executes it.
            specs: Trials of the run.
            worlds: Worlds that the folder must keep, by number.
            isolation: What keeps planners' processes apart in this session, over ROS.
            overwrite: Remove the results of another run.

        Yields:
            The open folder.

        Raises:
            ConfigError: If the folder holds results of a different run, of other
                worlds, or anything else, or if another process works in it.
            StoreError: If the folder cannot be written.
        """
        run_file = RunFile.for_run(path, config, specs)
        # A folder with other content is refused before it gets a lock file.
        find_previous(path)
        with _lock(path):
            remove_partial_files(path)

            # Another process may have worked here until the lock was taken.
            completed = find_completed(run_file, specs, overwrite=overwrite)
            if not completed.results:
                # Logs of the same run describe trials of earlier sessions.
                is_same_run = not overwrite and run_file.path.exists()
                if is_same_run:
                    earlier_config = RunFile.read(path).deciding_config()
                    is_same_run = earlier_config == run_file.deciding_config()
                _remove_results(path, logs=not is_same_run)
            elif completed.dropped_count:
                RowFile(path).replace(completed.results)
            # Trials without a row run again, and may then write no line.
            completed_ids = set(column(completed.results, "trial_id"))
            for name in (TRACKS_FILE, COMMANDS_FILE):
                TrialLines(path / name).drop_others(completed_ids)

            if worlds is not None and not (path / WORLDS).exists():
                write_dataset_file(path / WORLDS, Path(WORLDS).stem, worlds)
            # Sessions whose results were removed have no part in the results.
            run_file = replace(run_file, sessions=completed.sessions)
            run_file.with_session(execution, isolation).write()
            yield cls(path, specs, completed.results)

    @property
    def remaining(self) -> list[TrialSpec]:
        """Trials without a scored row, easy and difficult worlds mixed."""
        return [
            spec for spec in self._schedule if spec.trial_id not in self._completed_ids
        ]

    @property
    def total(self) -> int:
        """Number of trials of the run, with or without a row."""
        return len(self._places)

    def results(self) -> Rows:
        """Return all rows so far in the order of trials; reads the file if any are new."""
        if len(self._completed_ids) == len(self.completed):
            return self.completed
        return self._in_order(self._rows.read())

    def _in_order(self, results: Rows) -> Rows:
        """Return rows sorted by the order of the run's trials."""
        trial_ids = column(results, "trial_id")
        return take(results, np.argsort([self._places[name] for name in trial_ids]))

    def append(self, record: TrialRecord) -> None:
        """Append a trial's commands, track and, last, row to disk; ValueError if twice.

        Raises:
            StoreError: If another folder has taken the place of this one.
            ValueError: If the trial has a row already.
        """
        with convert_os_errors(StoreError, f"{self.path}: cannot be written"):
            is_same = os.path.samestat(self.path.stat(), self._stat)
        # A planner that moves the folder away could repeat its trials.
        trial_id = record.result.trial_id
        if not is_same:
            raise StoreError(
                f"{self.path}: is not the folder of this run, which was moved; {trial_id} is lost"
            )
        if trial_id in self._completed_ids:
            raise ValueError(f"trial {trial_id} already has a result")
        if record.commands is not None:
            append_line(self.path / COMMANDS_FILE, record.commands)
        if record.track is not None:
            append_line(self.path / TRACKS_FILE, record.track)
        # The row comes last. If the process is killed before, the track does not count,
        # and the trial runs again.
        self._rows.append(record.result)
        self._completed_ids.add(trial_id)
        # A trial without a score runs again, which is a second attempt.
        if record.result.wall_clock.attempts == 1 and _scored([record.result]):
            (self.path / LOSSES / f"{trial_id}.txt").unlink(missing_ok=True)

    def write_note(self, kind: str, trial_id: str, text: str) -> None:
        """Append a text with UTC time to KIND/TRIAL_ID.txt; StoreError if that fails.

        Args:
            kind: Folder of such texts, LOSSES or TRACEBACKS.
            trial_id: Name of the trial.
            text: The text, one or more lines.

        Raises:
            StoreError: If the file cannot be written.
        """
        path = self.path / kind / f"{trial_id}.txt"
        now = datetime.now(timezone.utc).isoformat(timespec="seconds")
        with convert_os_errors(StoreError, f"{path}: cannot be written"):
            path.parent.mkdir(exist_ok=True)
            with path.open("a", encoding="utf-8") as file:
                file.write(f"{now} {text}\n")

    def begin_attempt(self, trial_id: str) -> None:
        """Note that an attempt begins; StoreError if that fails.

        Afterwards, no note might be possible: a planner that loses could use up all disk
        space or files, or end the run.
        """
        self.write_note(LOSSES, trial_id, _BEGUN)

    def count_attempts(self, trial_id: str) -> int:
        """Return the number of a trial's attempts so far, in all sessions; or StoreError."""
        path = self.path / LOSSES / f"{trial_id}.txt"
        with convert_os_errors(StoreError, f"{path}: cannot be read"):
            text = path.read_text("utf-8")
        # Each note begins with its time; other lines belong to a traceback.
        return len(re.findall(rf"^\S+ {_BEGUN}$", text, re.MULTILINE))

    def complete(self) -> Rows:
        """Write tables, sort tracks, return all rows; ValueError if one is missing.

        Raises:
            ValueError: If a trial has no result.
        """
        results = self.results()
        if len(results) != self.total:
            raise ValueError(f"{self.total - len(results)} trials have no result")
        write_tables(self.path, results)
        TrialLines(self.path / TRACKS_FILE).arrange(self._places)
        # It stays if it has notes, which belong to trials of more than one attempt.
        with suppress(OSError):
            (self.path / LOSSES).rmdir()
        return results


@contextmanager
def _lock(path: Path) -> Iterator[None]:
    """Create a folder if missing, and lock it; ConfigError if it is locked already."""
    with convert_os_errors(StoreError, f"{path}: cannot be written"):
        path.mkdir(parents=True, exist_ok=True)
        # Child programs do not inherit the lock, so planners that go on do not hold it.
        lock = (path / _LOCK).open("ab")
    with lock:
        try:
            # The kernel releases the lock if this process is killed.
            fcntl.flock(lock, fcntl.LOCK_EX | fcntl.LOCK_NB)
        except BlockingIOError:
            raise ConfigError(
                f"{path}: another process is working in this folder"
            ) from None
        yield


def order_trials_fairly(specs: Sequence[TrialSpec]) -> list[TrialSpec]:
    """Return all trials in an order in which any first part mixes easy and hard worlds.

    Trials are sorted by repetition and then by world in the order of
    `order_worlds_fairly`; all planners follow each other in a world.
    """
    worlds = order_worlds_fairly(spec.world_number for spec in specs)
    places = {world: place for place, world in enumerate(worlds)}
    return sorted(specs, key=lambda spec: (spec.repetition, places[spec.world_number]))


def order_worlds_fairly(worlds: Iterable[int]) -> list[int]:
    """Return distinct world numbers in an order whose first parts cover the whole range.

    The order is van der Corput's sequence. In data sets of the suite, numbers are ranks
    of difficulty.
    """
    ranked = sorted(set(worlds))
    bits = (len(ranked) - 1).bit_length()
    keys = {}
    for rank, world in enumerate(ranked):
        # With reversed bits of ranks, each half of the order covers all ranks evenly.
        reversed_bits = f"{rank:0{bits}b}"[::-1]
        keys[world] = int(reversed_bits, 2)
    return sorted(ranked, key=keys.__getitem__)


@dataclass(frozen=True)
class CompletedTrials:
    """Sessions and results that a run's folder already has."""

    sessions: tuple[Mapping[str, Any], ...] = ()
    results: Rows = ()
    # Number of trials that failed through no fault of the planner; they run again.
    dropped_count: int = 0


def find_previous(path: Path) -> RunFile | None:
    """Return a folder's run.json, None if empty; ConfigError if it has other files.

    Raises:
        ConfigError: If the folder holds anything else.
    """
    if (path / RUN_FILE).exists():
        return RunFile.read(path)
    # A killed process may leave a partially written file.
    for file in path.glob("*"):
        if file.name != _LOCK and not file.match(f".*{PARTIAL_SUFFIX}"):
            raise ConfigError(f"{path}: is not empty and holds no run")
    return None


def find_completed(
    run_file: RunFile, specs: Sequence[TrialSpec], *, overwrite: bool = False
) -> CompletedTrials:
    """Return this run's sessions and scored rows, or none; ConfigError if of another.

    Args:
        run_file: Expected content of the folder's run.json.
        specs: Trials of the run.
        overwrite: Ignore all results in the folder.

    Raises:
        ConfigError: If the folder holds results of a different run, or anything else.
    """
    path = run_file.path.parent
    previous = find_previous(path)
    if previous is None or overwrite:
        return CompletedTrials()
    rows = RowFile(path).read()
    results = _scored(rows)
    if not results:
        return CompletedTrials()

    previous.require_same_run(run_file)
    specs_by_id = {spec.trial_id: spec for spec in specs}
    for result in results:
        if result.trial_id not in specs_by_id:
            raise ConfigError(
                f"{path}: holds a result of {result.trial_id}, which is not a trial of"
                " this run"
            )
        spec = specs_by_id[result.trial_id]
        require_world_of_trial(result, spec, path)
        require_row_of_trial(result, spec, previous)
    for planner in previous.config["planners"]:
        # Otherwise nothing would show if another planner drove the rest.
        if planner["source"] == UNKNOWN_SOURCE and len(results) < len(specs):
            raise ConfigError(
                f"{path}: planner {planner['name']!r}: its source is unknown, so the"
                " run cannot be resumed; use a different folder"
            )
    dropped_count = len(rows) - len(results)
    return CompletedTrials(previous.sessions, results, dropped_count)


def require_world_of_trial(result: TrialResult, spec: TrialSpec, path: Path) -> None:
    """Raise ConfigError if a row of the folder `path` was run in another world."""
    if result.world_checksum != spec.world.checksum:
        raise ConfigError(
            f"{path}: world {result.world} has changed since {result.trial_id} ran in it"
        )


def require_row_of_trial(
    result: TrialResult, spec: TrialSpec, run_file: RunFile
) -> None:
    """Raise ConfigError if a row's mode, system, planner, seeds or task are wrong.

    The message names the first wrong field.

    Args:
        result: The row.
        spec: The trial with the row's name.
        run_file: The run.json of its folder.
    """
    path = run_file.path.parent
    observed = ObservedTrial.of(spec.system, "", None)
    if result.observed is not None:
        observed = ObservedTrial.of(
            spec.system,
            result.observed.clearance_by,
            result.observed.time_uncertainty_s,
        )
    columns = {
        # Nothing of an observed trial is driven again.
        "observed": observed,
        # The mode decides what a trial must have besides its row, such as commands.
        "mode": run_file.config.get("mode"),
        "world": spec.world_number,
        "planner": spec.planner,
        "repetition": spec.repetition,
        "campaign_seed": spec.run_seed,
        "simulator_seed": spec.simulator_seed,
        "planner_seed": spec.planner_seed,
    }
    for name, value in columns.items():
        row_value = getattr(result, name)
        if row_value != value:
            raise ConfigError(
                f"{path}: {result.trial_id} has {name} {row_value!r}, must have"
                f" {value!r}"
            )
    _require_task(result, run_file)


def _require_task(result: TrialResult, run_file: RunFile) -> None:
    """Raise ConfigError if a row has another task than run.json; old rows have none."""
    if not run_file.has_task(result.task):
        raise ConfigError(
            f"{run_file.path.parent}: {result.trial_id} was run as task {result.task},"
            f" but {RUN_FILE} describes {run_file.task_fingerprint}: one of them was"
            " changed"
        )


def default_folder() -> Path:
    """Return a new path named after the time, such as out/run_20250131_120000_000000."""
    # To the microsecond, because scripts start several runs within a second.
    return Path("out") / datetime.now().strftime("run_%Y%m%d_%H%M%S_%f")


def read_results(path: Path) -> Rows:
    """Return scored rows in order of trials' ends; ConfigError if none or another task.

    The run may be unfinished.

    Raises:
        ConfigError: If there are none, or one belongs to another task.
    """
    if path.is_file():
        raise ConfigError(f"{path}: must be a folder of results; name {path.parent}")
    rows = RowFile(path).read()
    if not _scored(rows):
        problem = "holds no results of a run"
        if rows:
            problem = f"has no scored trial; {rows[0].trial_id}: {rows[0].detail}"
        raise ConfigError(f"{path}: {problem}")
    return select_scored(RunFile.read(path), rows)


def select_scored(run_file: RunFile, rows: Rows) -> Rows:
    """Return the rows without outside faults; ConfigError if one is of another task.

    Args:
        run_file: The folder's run.json.
        rows: Rows of the folder.

    Raises:
        ConfigError: If a row belongs to another task.
    """
    results = _scored(rows)
    # It is enough to check the first row of each task.
    _, first = np.unique(column(results, "task").astype(str), return_index=True)
    for position in np.sort(first).tolist():
        _require_task(results[position], run_file)
    return results


def _scored(rows: Rows) -> Rows:
    """Return the rows that did not fail by a fault of simulator or environment."""
    faults = column(rows, "fault").astype(str)
    return take(rows, ~np.isin(faults, [SIMULATOR, ENVIRONMENT]))


def _remove_results(path: Path, *, logs: bool) -> None:
    """Delete all files of a run, but logs and notes of lost attempts only if `logs`."""
    lines = (ROWS_FILE, TRACKS_FILE, COMMANDS_FILE)
    for name in (RUN_FILE, *lines, *TABLE_FILES, WORLDS, WORLDS_MANIFEST):
        (path / name).unlink(missing_ok=True)

    folders = [BAGS, TRACEBACKS]
    trees = [REPLAYS]
    if logs:
        folders.append(LOSSES)
        trees.append(LOGS)
    for name in folders:
        # Only files with names of trials, because users may keep other files here.
        for entry in (path / name).glob("*_w[0-9]*_r[0-9]*"):
            # The target of a link does not belong to this run.
            if entry.is_dir() and not entry.is_symlink():
                shutil.rmtree(entry)
            else:
                entry.unlink()
        # The folder is missing, or holds files of the user.
        with suppress(OSError):
            (path / name).rmdir()

    for name in trees:
        if (path / name).is_dir():
            shutil.rmtree(path / name)
