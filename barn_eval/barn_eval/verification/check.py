"""Whether what is in the folder of an experiment belongs together: rows, tracks, bags, tables, worlds."""

from collections import Counter, deque
from collections.abc import Callable, Iterator, Mapping, Sequence
from contextlib import closing
from dataclasses import dataclass, field
from pathlib import Path
from secrets import randbits
from typing import TypeVar

import numpy as np
import pyarrow as pa
import pyarrow.parquet

from barn_eval.results.bags import BAGS
from barn_eval.results.folder import require_row_of_trial
from barn_eval.results.rows import (
    RESULTS,
    ROWS_FILE,
    TRACKS_FILE,
    csv_bytes,
    results_table,
    unseal_line,
)
from barn_eval.results.run_file import RunFile
from barn_eval.results.tracks import parse_track_line
from barn_eval.running.local_pool import LocalPool
from barn_eval.running.pool import InlinePool, JobRefusal, Notice, PartialResult
from barn_eval.trials import identity
from barn_eval.trials.protocol import check_protocol_name
from barn_eval.trials.result import TrialResult, from_json_line
from barn_eval.trials.run_config import ExecutionConfig, RunConfig
from barn_eval.trials.spec import TrialSpec
from barn_eval.verification.rerun import (
    COMMANDS_NAME,
    CheckWork,
    TrialCheck,
    TrialEvidence,
)
from barn_worlds.base.errors import BarnError, ConfigError, format_error
from barn_worlds.base.files import read_at_most
from barn_worlds.base.text_files import parse_json, read_lines

T = TypeVar("T")
_LARGEST_TABLE_BYTES = 1 << 28
_SHARE, _LIMIT_S = (
    8,
    300.0,
)  # trials that a worker checks at a time, and the longest that one may take


@dataclass
class FolderCheck:
    """What a check has found. driven: trials of which the recorded commands were driven again.

    problems: a line for each thing that is wrong; unchecked: for what could not be checked.
    """

    trials: int = 0
    rows: int = 0
    tracks: int = 0
    bags: int = 0
    driven: int = 0
    problems: list[str] = field(default_factory=list)
    unchecked: list[str] = field(default_factory=list)


def check_folder(folder: Path, *, sample: int | None = None) -> FolderCheck:
    """Return what is wrong with a folder of results, finished or not; BarnError where its run.json cannot be read.

    Every row is computed again from what was recorded. sample: the commands of so many trials, drawn anew, are driven
    again, None for all.
    """
    run = RunFile.read(folder)
    experiment = run.run_config()
    check_protocol_name(experiment.protocol, f"{run.path}: ")
    found = FolderCheck()
    specs = {spec.trial_id: spec for spec in _specs(experiment, found)}
    found.trials = len(specs)
    for index, checksum in {
        spec.world_number: spec.world.checksum for spec in specs.values()
    }.items():
        if run.worlds.get(str(index), checksum) != checksum:
            found.problems.append(
                f"{run.path}: world {index} of {experiment.dataset} is not the one it names"
            )
    rows = _rows(folder, specs, run.task_fingerprint(), found)
    path = folder / TRACKS_FILE
    tracks = {
        trial_id: track
        for _, trial_id, track in _read(path, specs, parse_track_line, found)
    }
    sent = folder / COMMANDS_NAME  # of a submission, in place of bags
    commands = (
        {name: line for _, name, line in _read(sent, specs, _named, found)}
        if sent.exists()
        else None
    )
    found.rows, found.tracks = len(rows), len(tracks)
    drawn = rows if sample is None else _drawn(sorted(rows), sample)
    trials = []
    for trial_id, row in rows.items():
        bag = folder / BAGS / trial_id
        kept = experiment.bags == "all" or (
            experiment.bags == "failed" and not row.scores.success
        )
        if (
            kept
            and commands is None
            and row.measures.driven_m > 0.0
            and not bag.is_dir()
        ):
            found.problems.append(
                f"{bag}: is missing, bags of {experiment.bags} trials are kept"
            )
        line = (commands or {}).get(trial_id, "")
        there = bag if bag.is_dir() else None
        trials.append(
            TrialEvidence(
                row,
                specs[trial_id],
                tracks.get(trial_id),
                there,
                line,
                trial_id in drawn,
            )
        )
    unchecked = Counter[str]()
    for told in _checked(trials):
        found.bags, found.driven = found.bags + told.bag, found.driven + told.driven
        found.problems += [
            f"{folder}: {told.trial_id}: {problem}" for problem in told.problems
        ]
        found.problems += [
            f"{folder / BAGS / told.trial_id}: {problem}" for problem in told.of_bag
        ]
        unchecked[told.unchecked] += 1
    found.unchecked += [
        f"{count} trials: {why}" for why, count in unchecked.items() if why
    ]
    if len(rows) == len(specs):
        found.problems += [
            f"{path}: {trial_id} has a track and no row"
            for trial_id in tracks.keys() - rows.keys()
        ]
        if commands is None or (folder / f"{RESULTS}.parquet").exists():
            found.problems += _tables(folder, [rows[trial_id] for trial_id in specs])
    return found


def _specs(experiment: RunConfig, found: FolderCheck) -> list[TrialSpec]:
    """Return the trials of an experiment, of planners that are not installed here as well."""
    try:
        return experiment.trials()
    except ConfigError as error:
        found.unchecked.append(f"parameters and speed caps are as stated: {error}")
        return experiment.trials(started_by_hand=True)


def _drawn(names: list[str], count: int) -> list[str]:
    """Return so many names, others each time: who forges must not know which."""
    return [
        names[k]
        for k in np.random.default_rng(randbits(128)).permutation(len(names))[:count]
    ]


def describe_difference(row: TrialResult, again: TrialResult) -> str:
    """Return the first thing in which a row and that of the same trial run again differ, empty if they do not."""
    found = identity.first_difference(row.repeatable(), again.repeatable())
    return (
        ""
        if found is None
        else f"{found[0]} is {found[1]!r} in the row, {found[2]!r} now"
    )


def _read(
    path: Path,
    specs: Mapping[str, TrialSpec],
    parse: Callable[[str, str], tuple[str, T]],
    found: FolderCheck,
) -> Iterator[tuple[str, str, T]]:
    """Yield place, trial and content of each line of trials; what is damaged is a problem, and left out."""
    try:
        for where, line in read_lines(path):
            try:
                trial_id, content = parse(unseal_line(line, where), where)
            except BarnError as error:
                found.problems.append(str(error))
                continue
            if trial_id in specs:
                yield where, trial_id, content
            else:
                found.problems.append(
                    f"{where}: {trial_id} is no trial of this experiment"
                )
    except BarnError as error:
        found.problems.append(str(error))


def _row(line: str, where: str) -> tuple[str, TrialResult]:
    row = from_json_line(line, where)
    return row.trial_id, row


def _rows(
    folder: Path, specs: Mapping[str, TrialSpec], task: str, found: FolderCheck
) -> dict[str, TrialResult]:
    rows: dict[str, TrialResult] = {}
    for where, trial_id, row in _read(folder / ROWS_FILE, specs, _row, found):
        if trial_id in rows:
            found.problems.append(f"{where}: trial {trial_id} is there already")
        try:
            require_row_of_trial(row, specs[trial_id], task, folder)
        except BarnError as error:
            found.problems.append(str(error))
        else:
            rows[trial_id] = row
    return rows


def _named(line: str, where: str) -> tuple[str, str]:
    content = parse_json(line, where)
    return str(content.get("trial_id") if isinstance(content, dict) else ""), line


def _checked(trials: Sequence[TrialEvidence]) -> Iterator[TrialCheck]:
    """Yield what there is to say of trials, looked at by a process per processor."""
    waiting = deque(
        trials[first : first + _SHARE] for first in range(0, len(trials), _SHARE)
    )
    out: dict[str, Sequence[TrialEvidence]] = {}
    processes = min(ExecutionConfig().processes, len(waiting))
    engine = (
        LocalPool(CheckWork(), processes, _LIMIT_S)
        if processes > 1
        else InlinePool(CheckWork())
    )
    with closing(engine):
        while waiting or out:
            while waiting and len(out) < engine.slots:
                job = waiting.popleft()
                engine.submit(job[0].row.trial_id, job)
                out[job[0].row.trial_id] = job
            for report in engine.wait(1.0):
                if isinstance(report, PartialResult):
                    trial_id, told = report.result
                    out[report.key] = [
                        one for one in out[report.key] if one.row.trial_id != trial_id
                    ]
                    yield told
                elif not isinstance(report, Notice):
                    left = out.pop(report.key)
                    if left:  # the first of them was not to be checked
                        why = (
                            report.message
                            if isinstance(report, JobRefusal)
                            else getattr(report, "reason", "")
                        )
                        yield TrialCheck(
                            left[0].row.trial_id, (f"cannot be checked: {why}",)
                        )
                        waiting.extend([left[1:]] if left[1:] else [])


def _tables(folder: Path, rows: list[TrialResult]) -> Iterator[str]:
    """Yield whether a table of results does not say what the rows say."""
    expected = results_table(rows)
    for path, problem in (
        (folder / f"{RESULTS}.parquet", _parquet_problem),
        (folder / f"{RESULTS}.csv", _csv_problem),
    ):
        try:
            found = problem(read_at_most(path, _LARGEST_TABLE_BYTES), expected)
        except FileNotFoundError:
            found = "is missing, though all trials have rows; the same command again writes it"
        except (OSError, pa.ArrowException, ValueError) as error:
            found = format_error(error)
        if found:
            yield f"{path}: {found}"


def _parquet_problem(content: bytes, expected: pa.Table) -> str:
    file = pyarrow.parquet.ParquetFile(pa.BufferReader(content))
    # before it is read: run lengths let a kilobyte stand for any number of rows
    if (
        file.metadata.num_rows != len(expected)
        or file.schema_arrow.names != expected.column_names
    ):
        return f"has {file.metadata.num_rows} rows or columns that are not those of {ROWS_FILE}"
    table = file.read(use_threads=False)
    for there, here in zip(table.to_pylist(), expected.to_pylist(), strict=True):
        for name, value in here.items():
            if there[name] != value:
                return f"{name} of {here['trial_id']} is not that of its row"
    return ""


def _csv_problem(content: bytes, expected: pa.Table) -> str:
    return "" if content == csv_bytes(expected) else "is not the table of its rows"
