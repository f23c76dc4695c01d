"""The folder of an experiment.

OUT/run.json                    configuration and checksums of worlds; versions, commit and machine of each session
OUT/worlds.npz                  the worlds, where they were given as Python objects
OUT/results.jsonl               one line per finished trial, on the disk before it counts, in the order they ended
OUT/tracks.jsonl                one line per trial that began: what the robot did; at the end in the plan's order
OUT/results.parquet, .csv       results in the order of the plan, without wall-clock figures; at the end
OUT/timing.parquet, .csv        the wall-clock figures
OUT/bags/TRIAL_ID/              rosbag2 directories, where asked for
OUT/losses/TRIAL_ID.txt         what is known of attempts that gave no result
OUT/tracebacks/TRIAL_ID.txt     of planners that raised an exception in mode direct
OUT/logs/                       of mode ros: what the nodes printed
OUT/replays/                    pages of replays, and bags made for them afterwards
"""

import fcntl
import os
import shutil
from collections.abc import Iterable, Iterator, Mapping, Sequence
from contextlib import contextmanager, suppress
from dataclasses import replace
from datetime import datetime, timezone
from pathlib import Path
from typing import Any, NamedTuple

from barn_eval.results.bags import BAGS
from barn_eval.results.rows import (
    FILE_NAME,
    TABLE_FILES,
    TRACKS_NAME,
    ResultRows,
    TrackRows,
    write_tables,
)
from barn_eval.results.run_file import RUN_FILE, WORLDS, RunFile
from barn_eval.results.store import LOGS, Record
from barn_eval.trials.result import Rows, TrialResult
from barn_eval.trials.run_config import NO_SOURCE, Execution, Experiment
from barn_eval.trials.spec import TrialSpec
from barn_eval.trials.trial import OF_SPEC
from barn_worlds.base.errors import ConfigError, StoreError, convert_os_errors
from barn_worlds.base.files import PARTIAL_SUFFIX, remove_partial_files
from barn_worlds.formats.own import write_own
from barn_worlds.worlds.world import World

LOSSES, REPLAYS, TRACEBACKS = "losses", "replays", "tracebacks"
_LOCK = ".lock"


class ExperimentFolder:
    """The results of one experiment.

    earlier: results that were there when it was opened, in the order of the plan. Those since are in the files
    alone, so that memory does not grow with them while an experiment runs.
    """

    def __init__(self, path: Path, specs: Sequence[TrialSpec], results: Rows) -> None:
        self.path = path
        self._rows = ResultRows(path)
        self._tracks = TrackRows(path)
        self._order = {spec.trial_id: place for place, spec in enumerate(specs)}
        self.earlier = self._in_order(results)
        self._done = {result.trial_id for result in results}
        self._fair = fair_order(specs)

    @property
    def remaining(self) -> list[TrialSpec]:
        """The trials that have no result yet, in fair order."""
        return [spec for spec in self._fair if spec.trial_id not in self._done]

    @property
    def total(self) -> int:
        """Number of trials of the whole experiment."""
        return len(self._order)

    def results(self) -> list[TrialResult]:
        """Return the results so far in the order of the plan."""
        return self._in_order(self._rows.read())

    def _in_order(self, results: Rows) -> list[TrialResult]:
        return sorted(results, key=lambda result: self._order[result.trial_id])

    def append(self, record: Record) -> None:
        """Keep a trial's result and, before it, the line of its track."""
        trial_id = record.result.trial_id
        if trial_id in self._done:
            raise ValueError(f"trial {trial_id} has a result already")
        if record.track is not None:
            self._tracks.append(record.track)
        self._rows.append(record.result)
        self._done.add(trial_id)

    def note(self, kind: str, trial_id: str, text: str) -> None:
        """Keep a text on a trial in the folder LOSSES or TRACEBACKS; StoreError if it cannot be written."""
        path = self.path / kind / f"{trial_id}.txt"
        with convert_os_errors(StoreError, f"{path}: cannot be written"):
            path.parent.mkdir(exist_ok=True)
            with path.open("a", encoding="utf-8") as file:
                file.write(
                    f"{datetime.now(timezone.utc).isoformat(timespec='seconds')} {text}\n"
                )

    def complete(self) -> list[TrialResult]:
        """Write the tables and put the tracks in order, now that no trial is missing, and return all results."""
        results = self.results()
        if len(results) != self.total:
            raise ValueError(f"{self.total - len(results)} trials have no result")
        write_tables(self.path, results)
        self._tracks.arrange(list(self._order))
        return results


def fair_order(specs: Sequence[TrialSpec]) -> list[TrialSpec]:
    """Return trials in an order of which every beginning holds easy and difficult worlds alike.

    Repetition by repetition, worlds in the order of van der Corput's sequence over their numbers, which are ranks of
    difficulty in the data sets of the suite, and all planners in a world one after the other.
    """
    place = {
        world: number
        for number, world in enumerate(fair_worlds(spec.index for spec in specs))
    }
    return sorted(specs, key=lambda spec: (spec.repetition, place[spec.index]))


def fair_worlds(worlds: Iterable[int]) -> list[int]:
    """Return the numbers of worlds in the order of `fair_order`."""
    ranked = sorted(set(worlds))
    bits = (len(ranked) - 1).bit_length()
    return [
        one
        for _, one in sorted(
            (int(f"{rank:0{bits}b}"[::-1], 2), one) for rank, one in enumerate(ranked)
        )
    ]


@contextmanager
def opened(
    path: Path,
    experiment: Experiment,
    execution: Execution,
    specs: Sequence[TrialSpec],
    worlds: Mapping[int, World] | None = None,
    *,
    overwrite: bool = False,
) -> Iterator[ExperimentFolder]:
    """Begin an experiment in a folder, or resume it there, alone for as long as the context lasts.

    A folder of another experiment that has no result yet is taken over; one with results only with `overwrite`, which
    removes them. worlds: those that the folder is to keep. Raises ConfigError if it holds results of another
    experiment, of other worlds, or anything else; StoreError if it cannot be written.
    """
    asked = RunFile.of(
        path, experiment, {spec.index: spec.world.checksum for spec in specs}
    )
    earlier_results(asked, specs, overwrite=overwrite)
    with convert_os_errors(StoreError, f"{path}: cannot be written"):
        path.mkdir(parents=True, exist_ok=True)
        lock = os.open(path / _LOCK, os.O_RDWR | os.O_CREAT | os.O_CLOEXEC, 0o644)
    try:
        try:
            fcntl.flock(lock, fcntl.LOCK_EX | fcntl.LOCK_NB)
        except BlockingIOError:
            raise ConfigError(
                f"{path}: another process is working in this folder"
            ) from None
        remove_partial_files(path)
        sessions, results, dropped = earlier_results(asked, specs, overwrite=overwrite)
        if results and dropped:
            ResultRows(path).replace(results)
        elif not results:
            # the logs of the same experiment tell of trials that ended with a run before, in their midst
            same = (
                not overwrite
                and asked.path.exists()
                and RunFile.read(path).experiment == asked.experiment
            )
            _remove(path, logs=not same)
        if worlds is not None and not (path / WORLDS).exists():
            write_own(path / WORLDS, Path(WORLDS).stem, worlds)
        replace(asked, sessions=sessions).with_session(execution).write()
        yield ExperimentFolder(path, specs, results)
    finally:
        os.close(lock)


class EarlierResults(NamedTuple):
    """What an experiment finds in its folder: sessions, results that stay, and how many rows are to be run again."""

    sessions: tuple[Mapping[str, Any], ...] = ()
    results: Rows = ()
    dropped: int = 0


def earlier_results(
    asked: RunFile, specs: Sequence[TrialSpec], *, overwrite: bool = False
) -> EarlierResults:
    """Return what an experiment has in its folder already; ConfigError if the folder is another's.

    Trials that failed by no fault of the planner have no result: they are to be run again. Nothing is written. asked:
    what the folder's run.json is to say.
    """
    path = asked.path.parent
    if not asked.path.exists():
        # A kill may leave a file of which only the beginning was written.
        left = path.iterdir() if path.is_dir() else ()
        if any(
            one.name != _LOCK
            and not (one.name.startswith(".") and one.name.endswith(PARTIAL_SUFFIX))
            for one in left
        ):
            raise ConfigError(f"{path}: is not empty and holds no experiment")
        return EarlierResults()
    there = RunFile.read(path)
    rows = [] if overwrite else ResultRows(path).read()
    results = [result for result in rows if result.counts]
    if not results:
        return EarlierResults()
    there.require_same(asked)
    known, task = {spec.trial_id: spec for spec in specs}, there.written_task()
    for result in results:
        if result.trial_id not in known:
            raise ConfigError(
                f"{path}: holds a result of {result.trial_id}, which is no trial of this experiment"
            )
        require_of(result, known[result.trial_id], task, path)
    for planner in there.experiment["planners"]:
        if planner["source"] == NO_SOURCE and len(results) < len(specs):
            told = "has no source, so that whether it is the same cannot be told; use another folder"
            raise ConfigError(f"{path}: planner {planner['name']!r} {told}")
    return EarlierResults(there.sessions, results, len(rows) - len(results))


def require_of(result: TrialResult, spec: TrialSpec, task: str, path: Path) -> None:
    """Raise ConfigError naming the first field by which a row in a folder is not of the trial of its name."""
    if result.world_checksum != spec.world.checksum:
        raise ConfigError(
            f"{path}: world {result.world} is not the one that {result.trial_id} was run in"
        )
    for name, value in [
        ("world", spec.index),
        *((name, getattr(spec, name)) for name in OF_SPEC),
    ]:
        if getattr(result, name) != value:
            raise ConfigError(
                f"{path}: {result.trial_id} has {name} {getattr(result, name)!r}, must have {value!r}"
            )
    _require_task(result, task, path)


def _require_task(result: TrialResult, task: str, path: Path) -> None:
    if result.task not in ("", task):
        told = f"was run as task {result.task}, but {RUN_FILE} describes {task}: one of them was changed"
        raise ConfigError(f"{path}: {result.trial_id} {told}")


def new_folder() -> Path:
    """Return the path of a folder under out/ for an experiment without one of its own, named by the time."""
    return Path("out") / datetime.now().strftime("run_%Y%m%d_%H%M%S_%f")


def read_results(path: Path) -> list[TrialResult]:
    """Return the results of a run or campaign, finished or not; ConfigError as `results_of`, or if there are none."""
    rows = ResultRows(path).read()
    if not any(row.counts for row in rows):
        raise ConfigError(f"{path}: holds no results of a run or campaign")
    return results_of(RunFile.read(path), path, rows)


def results_of(run: RunFile, path: Path, rows: Rows) -> list[TrialResult]:
    """Return those among the rows of a folder that are not to be run again; ConfigError for one of another task."""
    results, written = [row for row in rows if row.counts], run.written_task()
    for result in results:
        _require_task(result, written, path)
    return results


def _remove(path: Path, *, logs: bool) -> None:
    """Remove what an experiment has written, its logs where that is asked for, and nothing else."""
    for name in (
        RUN_FILE,
        FILE_NAME,
        TRACKS_NAME,
        *TABLE_FILES,
        WORLDS,
        f"{Path(WORLDS).stem}.manifest.json",
    ):
        (path / name).unlink(missing_ok=True)
    for name in (BAGS, LOSSES, TRACEBACKS):
        for one in (path / name).glob("*_w[0-9]*_r[0-9]*"):
            shutil.rmtree(
                one
            ) if one.is_dir() and not one.is_symlink() else one.unlink()
        with suppress(
            OSError
        ):  # it is not there, or holds what somebody else has put into it
            (path / name).rmdir()
    for name in (*((LOGS,) if logs else ()), REPLAYS):
        if (path / name).is_dir():
            shutil.rmtree(path / name)
