"""Whether what is in the folder of an experiment belongs together: rows, tracks, bags, tables, worlds."""

from collections.abc import Callable, Iterator, Mapping
from dataclasses import dataclass, field
from pathlib import Path
from typing import TypeVar

import numpy as np
import pyarrow as pa
import pyarrow.parquet

from barn_eval.bags import BAGS
from barn_eval.bags.bagfile import BagFile
from barn_eval.experiments.experiment import Experiment
from barn_eval.experiments.folder import require_of
from barn_eval.experiments.rows import FILE_NAME, RESULTS, TRACKS_NAME, csv_bytes, results_table, unsealed
from barn_eval.experiments.run_file import RunFile
from barn_eval.experiments.track import CHANNELS, Track, from_track_line
from barn_eval.trials import identity
from barn_eval.trials.result import TrialResult, from_json_line
from barn_eval.trials.spec import TrialSpec
from barn_worlds.base.errors import BarnError, one_line
from barn_worlds.base.files import read_at_most
from barn_worlds.base.text_files import parse_json, read_lines

T = TypeVar("T")
_LARGEST_TABLE_BYTES = 1 << 28


@dataclass
class FolderCheck:
    """What a check has found."""

    trials: int = 0
    rows: int = 0
    tracks: int = 0
    bags: int = 0
    problems: list[str] = field(default_factory=list)


def check_folder(folder: Path) -> FolderCheck:
    """Return what is wrong with a folder of results, finished or not; BarnError where its run.json cannot be read."""
    run = RunFile.read(folder)
    experiment = run.configuration()
    specs = {spec.trial_id: spec for spec in experiment.trials()}
    found = FolderCheck(trials=len(specs))
    for index, checksum in {spec.index: spec.world.checksum for spec in specs.values()}.items():
        if run.worlds.get(str(index), checksum) != checksum:
            found.problems.append(f"{run.path}: world {index} of {experiment.dataset} is not the one it names")
    rows = _rows(folder, specs, run.written_task(), found)
    path = folder / TRACKS_NAME
    tracks = {trial_id: track for _, trial_id, track in _read(path, specs, from_track_line, found)}
    found.rows, found.tracks = len(rows), len(tracks)
    for trial_id, row in rows.items():
        found.problems += _differences(row, tracks.get(trial_id), path)
    if len(rows) == len(specs):
        found.problems += [f"{path}: {trial_id} has a track and no row" for trial_id in tracks.keys() - rows.keys()]
        found.problems += _tables(folder, [rows[trial_id] for trial_id in specs])
    found.problems += _bags(folder, experiment, rows, found)
    return found


def difference(row: TrialResult, again: TrialResult) -> str:
    """Return the first thing in which a row and that of the same trial run again differ, empty if they do not."""
    found = identity.first_difference(row.repeatable(), again.repeatable())
    return "" if found is None else f"{found[0]} is {found[1]!r} in the row, {found[2]!r} now"


def _read(
    path: Path, specs: Mapping[str, TrialSpec], parse: Callable[[str, str], tuple[str, T]], found: FolderCheck
) -> Iterator[tuple[str, str, T]]:
    """Yield place, trial and content of each line of trials; what is damaged is a problem, and left out."""
    try:
        for where, line in read_lines(path):
            try:
                trial_id, content = parse(unsealed(line, where), where)
            except BarnError as error:
                found.problems.append(str(error))
                continue
            if trial_id in specs:
                yield where, trial_id, content
            else:
                found.problems.append(f"{where}: {trial_id} is no trial of this experiment")
    except BarnError as error:
        found.problems.append(str(error))


def _row(line: str, where: str) -> tuple[str, TrialResult]:
    row = from_json_line(line, where)
    return row.trial_id, row


def _rows(folder: Path, specs: Mapping[str, TrialSpec], task: str, found: FolderCheck) -> dict[str, TrialResult]:
    rows: dict[str, TrialResult] = {}
    for where, trial_id, row in _read(folder / FILE_NAME, specs, _row, found):
        if trial_id in rows:
            found.problems.append(f"{where}: trial {trial_id} is there already")
        try:
            require_of(row, specs[trial_id], task, folder)
        except BarnError as error:
            found.problems.append(str(error))
        else:
            rows[trial_id] = row
    return rows


def _differences(row: TrialResult, track: Track | None, path: Path) -> Iterator[str]:
    """Yield what of a row is not what its track says, as far as its rounding allows to tell."""
    if track is None:
        if row.measures.driven_m > 0.0:
            yield f"{path}: has no track of {row.trial_id}, which drove {row.measures.driven_m:.2f} m"
        return
    clearance = track.samples[:, CHANNELS.index("clearance")]
    nearest, stated = np.nanmin(clearance, initial=np.inf), row.measures.min_clearance_m
    if stated is not None and np.isfinite(nearest) and abs(nearest - stated) > _slack(track, "clearance"):
        yield f"{path}: {row.trial_id} came as near as {nearest:.3f} m by its track, {stated:.3f} m by its row"
    if bool(track.contact.any()) != bool(row.measures.contacts):
        yield f"{path}: {row.trial_id} has {row.measures.contacts} contacts by its row, by its track not so"
    straight = np.hypot(*np.diff(track.samples[:, 1:3], axis=0).T).sum()
    slack = 2.0 * _slack(track, "x") * len(track.samples)
    if straight > row.measures.driven_m + slack:
        yield f"{path}: {row.trial_id} drove {straight:.2f} m by its track, {row.measures.driven_m:.2f} m by its row"


def _slack(track: Track, channel: str) -> float:
    return float(track.steps[CHANNELS.index(channel)])


def _bags(folder: Path, experiment: Experiment, rows: Mapping[str, TrialResult], found: FolderCheck) -> Iterator[str]:
    for trial_id, row in rows.items():
        path = folder / BAGS / trial_id
        kept = experiment.bags == "all" or (experiment.bags == "failed" and not row.scores.success)
        if not path.is_dir():
            if kept and row.measures.driven_m > 0.0:
                yield f"{path}: is missing, bags of {experiment.bags} trials are kept"
            continue
        found.bags += 1
        try:
            bag = BagFile(path)
            count = sum(1 for _ in bag.messages())
            written = parse_json(bag.metadata.get("barn.result", {}).get("result", "{}"), f"{path}: barn.result")
        except BarnError as error:
            yield str(error)
            continue
        empty = "the bag is empty" if not count and row.measures.driven_m > 0.0 else ""
        if bag.problem or empty:
            yield f"{path}: {bag.problem or empty}"
        elif (other := identity.first_difference(row.repeatable(), written)) is not None and written:
            yield f"{path}: {other[0]} is {other[1]!r} in the row, {other[2]!r} in the bag"


def _tables(folder: Path, rows: list[TrialResult]) -> Iterator[str]:
    """Yield whether a table of results does not say what the rows say."""
    expected = results_table(rows)
    for path, problem in ((folder / f"{RESULTS}.parquet", _parquet_problem), (folder / f"{RESULTS}.csv", _csv_problem)):
        try:
            found = problem(read_at_most(path, _LARGEST_TABLE_BYTES), expected)
        except FileNotFoundError:
            found = "is missing, though all trials have rows; the same command again writes it"
        except (OSError, pa.ArrowException, ValueError) as error:
            found = one_line(error)
        if found:
            yield f"{path}: {found}"


def _parquet_problem(content: bytes, expected: pa.Table) -> str:
    file = pyarrow.parquet.ParquetFile(pa.BufferReader(content))
    # before it is read: run lengths let a kilobyte stand for any number of rows
    if file.metadata.num_rows != len(expected) or file.schema_arrow.names != expected.column_names:
        return f"has {file.metadata.num_rows} rows or columns that are not those of {FILE_NAME}"
    table = file.read(use_threads=False)
    for there, here in zip(table.to_pylist(), expected.to_pylist(), strict=True):
        for name, value in here.items():
            if there[name] != value:
                return f"{name} of {here['trial_id']} is not that of its row"
    return ""


def _csv_problem(content: bytes, expected: pa.Table) -> str:
    return "" if content == csv_bytes(expected) else "is not the table of its rows"
