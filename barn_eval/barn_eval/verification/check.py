"""Check that the parts of a results folder agree and follow from its recordings."""

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
from barn_eval.results.commands import count_equal_commands
from barn_eval.results.folder import require_row_of_trial, require_world_of_trial
from barn_eval.results.rows import (
    COMMANDS_FILE,
    RESULTS,
    ROWS_FILE,
    TRACKS_FILE,
    RowParser,
    csv_bytes,
    results_table,
    unseal_line,
)
from barn_eval.results.run_file import SUBMISSION_FILE, RunFile
from barn_eval.results.store import LOGS
from barn_eval.results.tracks import parse_track_line, parse_trial_line
from barn_eval.running.local_pool import LocalPool
from barn_eval.running.pool import (
    InlinePool,
    JobLoss,
    JobRefusal,
    JobResult,
    WorkerPool,
)
from barn_eval.trials.identity import CODE_VERSIONS, fingerprint, task_content
from barn_eval.trials.protocol import check_protocol_name
from barn_eval.trials.result import SCHEMA_VERSION, TrialResult
from barn_eval.trials.run_config import ExecutionConfig, RunConfig
from barn_eval.trials.spec import TrialSpec
from barn_eval.verification.rerun import CheckWork, TrialCheck, TrialEvidence
from barn_worlds.base.errors import BarnError, ConfigError, format_error, format_value
from barn_worlds.base.files import read_at_most, read_lines

T = TypeVar("T")
_LARGEST_TABLE_BYTES = 1 << 28
_LIMIT_S = 300.0  # longest time that the check of a trial may take


@dataclass
class FolderCheck:
    """Problems of a folder, and how much of it was checked."""

    trials: int = 0  # planned in the run
    rows: int = 0
    tracks: int = 0
    bags: int = 0
    driven: int = 0  # trials whose commands were driven again
    problems: list[str] = field(default_factory=list)  # a line for each
    unchecked: list[str] = field(default_factory=list)  # what could not be checked
    notes: list[str] = field(default_factory=list)  # what is unusual but not wrong


def check_folder(folder: Path, *, sample: int | None = None) -> FolderCheck:
    """Recompute a folder's rows and drive its commands again; return all problems.

    The run may be unfinished. The folder is not changed.

    Args:
        folder: The folder.
        sample: Number of trials, drawn at random, whose commands are driven again.
            Default: all.

    Raises:
        BarnError: If the folder's run.json cannot be read.
    """
    return _Checker(folder).check(sample)


def describe_other_task(run_file: RunFile, config: RunConfig) -> str:
    """Return a text if run.json's task fingerprint is not this version's, else "".

    Args:
        run_file: The folder's run.json.
        config: Its configuration.
    """
    task = fingerprint(task_content(config.protocol, config.simulator, config.system))
    if task == run_file.task_fingerprint:
        return ""
    return (
        f"{run_file.path}: states task {run_file.task_fingerprint}, but this version"
        f" computes {task}"
    )


class _Checker:
    """Checks one folder and collects its problems."""

    def __init__(self, folder: Path):
        """Read run.json, make the run's trials and read their worlds, but no row yet.

        Raises:
            BarnError: If run.json cannot be read.
        """
        self._folder = folder
        self._run_file = RunFile.read(folder)
        self._config = self._run_file.run_config()
        check_protocol_name(self._config.protocol, f"{self._run_file.path}: ")
        self._parser = RowParser(folder)
        self._result = FolderCheck()
        self._specs = {spec.trial_id: spec for spec in self._read_specs()}
        # The trials of a run have one task. If an older run.json has another, an earlier
        # version drove them, possibly with other results. What a row states about
        # itself does not count.
        self._other_task = describe_other_task(self._run_file, self._config)
        self._is_older = self._other_task != "" and _is_older(self._run_file)

    def check(self, sample: int | None) -> FolderCheck:
        """Check the whole folder and return the result; call it only once.

        `sample` is the number of trials to drive again, None for all.
        """
        result = self._result
        result.trials = len(self._specs)
        self._check_worlds()
        rows = self._read_rows()
        tracks = self._read_trials(TRACKS_FILE, parse_track_line)
        commands = self._read_trials(COMMANDS_FILE, _name_trial)
        result.rows = len(rows)
        result.tracks = len(tracks)

        for path in self._folder.rglob("*"):
            # The target of a link can be changed without a trace in the folder.
            if path.is_symlink() and LOGS not in path.relative_to(self._folder).parts:
                result.problems.append(f"{path}: is a link, which is not allowed")

        is_submission = (self._folder / SUBMISSION_FILE).exists()
        if not self._run_file.sessions:
            result.problems.append(f"{self._run_file.path}: lists no session")
        # One planner may be in a run twice, under two names.
        self._compare_planners(
            rows, commands, result.problems if is_submission else result.notes
        )
        sampled_ids = (
            rows.keys() if sample is None else sample_trials(sorted(rows), sample)
        )
        trials = []
        missing_bags = []
        for trial_id, row in rows.items():
            bag = self._folder / BAGS / trial_id
            has_bag = bag.is_dir()
            result.bags += has_bag
            if not has_bag and not is_submission and self._keeps_bag(row):
                missing_bags.append(bag)
            evidence = TrialEvidence(
                row,
                self._specs[trial_id],
                tracks.get(trial_id),
                bag if has_bag else None,
                commands.get(trial_id, ""),
                trial_id in sampled_ids,
            )
            trials.append(evidence)
        self._check_bags(missing_bags)
        self._check_trials(trials)
        self._check_task()

        # Tables are written once all trials have rows.
        has_tables = (self._folder / f"{RESULTS}.parquet").exists()
        if len(rows) == len(self._specs) and (has_tables or not is_submission):
            ordered_rows = [rows[trial_id] for trial_id in self._specs]
            table_problems = list(_compare_tables(self._folder, ordered_rows))
            if not self._is_older:
                result.problems += table_problems
            elif table_problems:
                self._report(
                    f"{self._folder}: the tables differ from those that this version"
                    " makes from its rows"
                )
        return result

    def _check_bags(self, missing: Sequence[Path]) -> None:
        """Add a problem per missing bag or, if there is none at all, one unchecked line."""
        # A user may delete all bags to save space.
        if missing and not self._result.bags:
            self._result.unchecked.append(f"{len(missing)} trials: have no bag")
            return
        for bag in missing:
            self._result.problems.append(
                f"{bag}: is missing, though the run keeps bags of {self._config.bags}"
                " trials"
            )

    def _compare_planners(
        self,
        rows: Mapping[str, TrialResult],
        commands: Mapping[str, str],
        texts: list[str],
    ) -> None:
        """Append to `texts` a line per two planners with trials of equal commands."""
        trials = []
        for trial_id, line in commands.items():
            if trial_id in rows and rows[trial_id].scores.success:
                row = rows[trial_id]
                trials.append(((row.world, row.repetition), row.planner, line))
        for pair, count in count_equal_commands(trials).items():
            names = " and ".join(pair)
            texts.append(
                f"{self._folder}: {names} have equal commands in {count} trials"
            )

    def _read_specs(self) -> list[TrialSpec]:
        """Return the run's trials; note a ConfigError and omit planners' data then."""
        try:
            return self._config.trials()
        except ConfigError as error:
            self._result.unchecked.append(
                f"parameters and speed caps were not checked: {error}"
            )
            return self._config.trials(started_by_hand=True)

    def _check_task(self) -> None:
        """Report code versions that never existed, and a task unlike this version's."""
        run_file = self._run_file
        if not _has_known_versions(run_file):
            self._result.problems.append(
                f"{run_file.path}: code_versions {format_value(run_file.code_versions)}"
                f" belong to no version up to this one{run_file.origin_note()}"
            )
        if self._other_task:
            self._report(self._other_task)

    def _check_worlds(self) -> None:
        """Report worlds whose checksum differs from the one in run.json."""
        checksums = {
            spec.world_number: spec.world.checksum for spec in self._specs.values()
        }
        for number, checksum in checksums.items():
            # A world that run.json does not name is compared with its rows only.
            if self._run_file.worlds.get(str(number), checksum) != checksum:
                self._report(
                    f"{self._run_file.path}: names a different world {number} than"
                    f" {self._config.dataset} has"
                )

    def _read_rows(self) -> dict[str, TrialResult]:
        """Return valid rows by trial; report duplicates and rows unlike their trial."""
        rows: dict[str, TrialResult] = {}
        for where, trial_id, row in self._read(ROWS_FILE, self._parse_row):
            if trial_id in rows:
                self._result.problems.append(
                    f"{where}: trial {trial_id} is listed twice"
                )
            spec = self._specs[trial_id]
            report = self._result.problems.append
            try:
                require_row_of_trial(row, spec, self._run_file)
                # Another version may read the same file as a different world.
                report = self._report
                require_world_of_trial(row, spec, self._folder)
            except BarnError as error:
                report(str(error))
            else:
                rows[trial_id] = row
        return rows

    def _parse_row(self, line: str, where: str) -> tuple[str, TrialResult]:
        """Return (trial name, row) of a line without its checksum."""
        row = self._parser.parse(line, where)
        return row.trial_id, row

    def _read_trials(
        self, name: str, parse: Callable[[str, str], tuple[str, T]]
    ) -> dict[str, T]:
        """Return the parsed last line of each trial in a .jsonl file, by trial."""
        return {trial_id: content for _, trial_id, content in self._read(name, parse)}

    def _read(
        self, name: str, parse: Callable[[str, str], tuple[str, T]]
    ) -> Iterator[tuple[str, str, T]]:
        """Yield ("FILE, line N", trial name, content) of valid lines; report others.

        Damaged lines, and lines of trials that the run does not have, are reported and
        left out.
        """
        problems = self._result.problems
        try:
            for where, line in read_lines(self._folder / name):
                try:
                    trial_id, content = parse(unseal_line(line, where), where)
                except BarnError as error:
                    problems.append(str(error))
                    continue
                if trial_id in self._specs:
                    yield where, trial_id, content
                else:
                    problems.append(f"{where}: {trial_id} is not a trial of this run")
        except BarnError as error:
            problems.append(str(error))

    def _keeps_bag(self, row: TrialResult) -> bool:
        """Return whether the run keeps this bag; False if the robot never moved."""
        bags = self._config.bags
        is_kept = bags == "all" or (bags == "failed" and not row.scores.success)
        return is_kept and row.measures.driven_m > 0.0

    def _report(self, problem: str) -> None:
        """Add a line to `problems`, or to `unchecked` if an earlier version drove the run.

        Versions may compute different values, so a different old row is no forgery.
        """
        if self._is_older:
            self._result.unchecked.append(f"{problem}{self._run_file.origin_note()}")
        else:
            self._result.problems.append(problem)

    def _check_trials(self, trials: Sequence[TrialEvidence]) -> None:
        """Check trials in parallel; add problems, notes and counts in trial order."""
        result = self._result
        unchecked: Counter[str] = Counter()
        older: list[str] = []  # a line per different trial, with its first difference
        # Workers finish in any order; problems are listed in trial order.
        checks = {check.trial_id: check for check in _check_all(trials)}
        for trial in trials:
            trial_id = trial.row.trial_id
            check = checks[trial_id]
            result.driven += check.was_driven
            if not self._is_older:
                check.problems += check.differences
            elif check.differences:
                older.append(f"{trial_id}: {check.differences[0]}")
            where = f"{self._folder}: {trial_id}"
            if (trial.row.scores.efficiency or 0.0) > 1.0:
                # The bound assumes average slip of the tires.
                result.notes.append(f"{where}: was faster than the bound")
            result.problems += [f"{where}: {text}" for text in check.problems]
            if check.bag_problem:
                result.problems.append(f"{trial.bag}: {check.bag_problem}")
            if check.unchecked:
                unchecked[check.unchecked] += 1
        result.unchecked += [
            f"{count} trials: {reason}" for reason, count in unchecked.items()
        ]
        if older:
            self._report(
                f"{len(older)} trials: differ from what this version computes; the first"
                f" is {older[0]}"
            )


def _is_older(run_file: RunFile) -> bool:
    """Return whether run.json is of known code or schema before this version's."""
    versions = run_file.code_versions
    is_earlier = versions != CODE_VERSIONS or run_file.schema_version < SCHEMA_VERSION
    return is_earlier and _has_known_versions(run_file)


def _has_known_versions(run_file: RunFile) -> bool:
    """Return whether run.json's code versions are of this suite or an earlier one."""
    versions = run_file.code_versions
    # Schema 2 had no code versions.
    if not versions:
        return run_file.schema_version == 2
    return all(
        # True and 1.0 equal 1, but the suite never writes them.
        type(number) is int and 1 <= number <= CODE_VERSIONS.get(key, 0)
        for key, number in versions.items()
    )


def _check_all(trials: Sequence[TrialEvidence]) -> Iterator[TrialCheck]:
    """Check trials in a process per CPU; yield checks as they end, failed if lost."""
    waiting = deque(trials)
    running = 0
    processes = min(ExecutionConfig().processes, len(trials))
    pool: WorkerPool = InlinePool(CheckWork())
    if processes > 1:
        pool = LocalPool(CheckWork(), processes, _LIMIT_S)
    with closing(pool):
        while waiting or running:
            while waiting and running < pool.slots:
                trial = waiting.popleft()
                pool.submit(trial.row.trial_id, trial)
                running += 1
            for report in pool.wait(1.0):
                match report:
                    case JobResult():
                        yield report.result
                    case JobLoss():
                        yield _failed_check(report.key, report.reason)
                    case JobRefusal():
                        yield _failed_check(report.key, report.message)
                    case _:  # from a job that is still running
                        continue
                running -= 1


def _failed_check(trial_id: str, reason: str) -> TrialCheck:
    """Return a check whose only problem is why the trial could not be checked."""
    return TrialCheck(trial_id, [f"cannot be checked: {reason}"])


def sample_trials(trial_ids: list[str], count: int) -> set[str]:
    """Return `count` of the names, or all if fewer, drawn anew without a seed.

    A forger must not know which trials are drawn.
    """
    order = np.random.default_rng(randbits(128)).permutation(len(trial_ids))
    return {trial_ids[k] for k in order[:count]}


def _name_trial(line: str, where: str) -> tuple[str, str]:
    """Return (trial name, the line itself) for a line of commands.jsonl."""
    trial_id, _ = parse_trial_line(line, where, "commands")
    return trial_id, line


def _compare_tables(folder: Path, rows: list[TrialResult]) -> Iterator[str]:
    """Yield a problem for results.parquet, .csv, each if missing or unlike the rows."""
    expected = results_table(rows)
    comparisons = {"parquet": _compare_parquet, "csv": _compare_csv}
    for ending, compare in comparisons.items():
        path = folder / f"{RESULTS}.{ending}"
        try:
            problem = compare(read_at_most(path, _LARGEST_TABLE_BYTES), expected)
        except FileNotFoundError:
            problem = (
                "is missing, though all trials have rows; type the command of the run"
                " again to write it"
            )
        except (OSError, pa.ArrowException, ValueError) as error:
            problem = format_error(error)
        if problem:
            yield f"{path}: {problem}"


def _compare_parquet(content: bytes, expected: pa.Table) -> str:
    """Return how a Parquet file differs from the table, or ""; raise if unreadable."""
    file = pyarrow.parquet.ParquetFile(pa.BufferReader(content))

    # Before reading, because a kilobyte of run lengths may stand for any number of rows.
    row_count = file.metadata.num_rows
    has_columns = file.schema_arrow.names == expected.column_names
    if row_count != len(expected) or not has_columns:
        return f"has {row_count} rows, and rows or columns differ from {ROWS_FILE}"

    table = file.read(use_threads=False)
    for row, expected_row in zip(table.to_pylist(), expected.to_pylist(), strict=True):
        for name, value in expected_row.items():
            if row[name] != value:
                trial_id = expected_row["trial_id"]
                return f"{name} of {trial_id} differs from its row"
    return ""


def _compare_csv(content: bytes, expected: pa.Table) -> str:
    """Return "" if a CSV file's bytes are those of the table, else a problem."""
    return "" if content == csv_bytes(expected) else f"differs from {ROWS_FILE}"
