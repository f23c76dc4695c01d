"""Whether what is in the folder of an experiment belongs together: rows, tracks, bags, tables, worlds."""

from collections.abc import Iterator, Mapping
from dataclasses import dataclass, field
from pathlib import Path

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

_LARGEST_TABLE_BYTES = 1 << 28


@dataclass
class FolderCheck:
    """What a check has found.

    trials: planned; rows, tracks, bags: that are there and were looked at. problems: a line each.
    """

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
    for spec in {spec.index: spec for spec in specs.values()}.values():
        known = run.worlds.get(str(spec.index), spec.world.checksum)
        if known != spec.world.checksum:
            found.problems.append(f"{run.path}: world {spec.index} of {experiment.dataset} is not the one it names")
    rows = _rows(folder, specs, run.written_task(), found)
    tracks = _tracks(folder, specs, found)
    for trial_id, row in rows.items():
        found.problems += _differences(row, tracks.get(trial_id), folder / TRACKS_NAME)
    for trial_id in tracks.keys() - rows.keys():
        if len(rows) == len(specs):
            found.problems.append(f"{folder / TRACKS_NAME}: {trial_id} has a track and no row")
    found.problems += _bags(folder, experiment, rows, found)
    found.problems += _tables(folder, [rows[trial_id] for trial_id in specs if trial_id in rows], len(specs))
    return found


def difference(row: TrialResult, again: TrialResult) -> str:
    """Return the first thing in which a row and that of the same trial run again differ, empty if they do not."""
    found = identity.first_difference(row.repeatable(), again.repeatable())
    return "" if found is None else f"{found[0]} is {found[1]!r} in the row, {found[2]!r} now"


def _lines(path: Path, found: FolderCheck) -> Iterator[tuple[str, str]]:
    """Yield place and content of each line; one that is damaged is a problem, and left out."""
    try:
        for where, line in read_lines(path):
            try:
                content = unsealed(line, where)
            except BarnError as error:
                found.problems.append(str(error))
                continue
            yield where, content
    except BarnError as error:
        found.problems.append(str(error))


def _rows(folder: Path, specs: Mapping[str, TrialSpec], task: str, found: FolderCheck) -> dict[str, TrialResult]:
    rows: dict[str, TrialResult] = {}
    for where, line in _lines(folder / FILE_NAME, found):
        try:
            row = from_json_line(line, where)
            if row.trial_id not in specs:
                found.problems.append(f"{where}: {row.trial_id} is no trial of this experiment")
                continue
            if row.trial_id in rows:
                found.problems.append(f"{where}: trial {row.trial_id} is there already")
            require_of(row, specs[row.trial_id], task, folder)
        except BarnError as error:
            found.problems.append(str(error))
            continue
        rows[row.trial_id] = row
    found.rows = len(rows)
    return rows


def _tracks(folder: Path, specs: Mapping[str, TrialSpec], found: FolderCheck) -> dict[str, Track]:
    tracks: dict[str, Track] = {}
    for where, line in _lines(folder / TRACKS_NAME, found):
        try:
            trial_id, track = from_track_line(line, where)
        except BarnError as error:
            found.problems.append(str(error))
            continue
        if trial_id not in specs:
            found.problems.append(f"{where}: {trial_id} is no trial of this experiment")
        tracks[trial_id] = track
    found.tracks = len(tracks)
    return tracks


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


def _tables(folder: Path, rows: list[TrialResult], planned: int) -> Iterator[str]:
    """Yield whether a table of results does not say what the rows say."""
    if len(rows) < planned:
        return
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
    table = pyarrow.parquet.ParquetFile(pa.BufferReader(content)).read(use_threads=False)
    if len(table) != len(expected):
        return f"has {len(table)} rows, {FILE_NAME} has {len(expected)}"
    if table.column_names != expected.column_names:
        return "has not the columns of its rows"
    for name in expected.column_names:
        pairs = zip(table.column(name).to_pylist(), expected.column(name).to_pylist(), strict=True)
        other = next((place for place, (there, here) in enumerate(pairs) if there != here), None)
        if other is not None:
            return f"{name} of {expected.column('trial_id')[other].as_py()} is not that of its row"
    return ""


def _csv_problem(content: bytes, expected: pa.Table) -> str:
    return "" if content == csv_bytes(expected) else "is not the table of its rows"
