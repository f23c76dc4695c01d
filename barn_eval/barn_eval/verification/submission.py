"""Results as one file that anybody can verify.

The file holds rows, tracks, commands, worlds, parameters, versions and machine.
"""

import hashlib
import json
import re
import zipfile
from collections.abc import Iterator
from pathlib import Path
from typing import Any

from barn_eval.results.provenance import SUITE, versions
from barn_eval.results.rows import (
    COMMANDS_FILE,
    ROWS_FILE,
    TRACKS_FILE,
    RowFile,
    write_tables,
)
from barn_eval.results.run_file import (
    CLAIMED,
    RUN_FILE,
    SUBMISSION_FILE,
    WORLDS,
    WORLDS_MANIFEST,
    RunFile,
)
from barn_eval.results.store import LOGS
from barn_eval.running.command_files import find_parameter_files
from barn_eval.trials.result import REAL_TIME, Rows
from barn_eval.trials.run_config import RunConfig
from barn_eval.verification.check import (
    FolderCheck,
    check_folder,
    describe_other_task,
    sample_trials,
)
from barn_eval.verification.plausibility import JUDGED_OUTCOMES
from barn_eval.verification.rerun import drive_by_planner
from barn_worlds.base.errors import ConfigError, FindingError, format_value
from barn_worlds.base.files import (
    ZIP_ERRORS,
    as_mapping,
    open_regular,
    pack_zip,
    parse_json,
    read_bytes,
    write_durably,
)
from barn_worlds.datasets.dataset import dataset_files

SCHEMA_VERSION = 1
_REQUIRED = (RUN_FILE, ROWS_FILE, TRACKS_FILE, COMMANDS_FILE)
_ALLOWED = (*_REQUIRED, WORLDS, WORLDS_MANIFEST)

# Copies of files that planners' commands name, and parameter files of their nodes.
_PARAMETERS = re.compile(r"parameters/[0-9a-f]{12}_[A-Za-z0-9_.-]{1,100}")
_CONTAINER = re.compile(r"(|([A-Za-z0-9_./:-]{1,200}@)?sha256:[0-9a-f]{64})")

# Limits of a submission: number of members, their bytes, and the highest compression
# ratio of a member that is not small.
_MAX_MEMBERS = 100
_MAX_BYTES = 1 << 29
_MAX_RATIO = 100
_SMALL_BYTES = 1 << 20
# Number of trials of each planner that `verify` drives again with the planner.
_RERUNS = 3


def submit(folder: str | Path, path: str | Path, container: str = "") -> FolderCheck:
    """Check, then zip a folder; FindingError if unsound, ConfigError if not public.

    Equal results give equal bytes.

    Args:
        folder: Folder of a run.
        path: File to write, .zip.
        container: Digest of the image that the planner ran in.

    Returns:
        What was checked.

    Raises:
        FindingError: If anything is wrong, missing or cannot be checked.
        ConfigError: If the worlds are from a file that others do not have.
    """
    folder = Path(folder)
    if not _CONTAINER.fullmatch(container):
        raise ConfigError(
            f"container {format_value(container)}: must have the form"
            " [NAME@]sha256:DIGITS, with 64 hexadecimal digits in lower case"
        )
    check = check_folder(folder)
    problems = list(check.problems)
    if check.rows != check.trials:
        problems.append(f"has {check.rows} of {check.trials} trials")
    run_file = RunFile.read(folder)
    # Trials of an earlier version cannot be checked, so `verify` would refuse them.
    config = run_file.run_config()
    config.require_own_names()
    if config.system.is_observed:
        problems.append(f"{config.system.label}: observed, not driven again")
    other_task = describe_other_task(run_file, config)
    if other_task:
        problems.append(f"{other_task}{run_file.origin_note()}")
    # `verify` counts what cannot be checked as wrong.
    problems += check.unchecked
    if problems:
        raise FindingError(f"{folder}: cannot be submitted: {problems[0]}")
    _require_available_worlds(run_file)

    files = {}
    for name in _ALLOWED:
        if (folder / name).is_file():
            files[name] = read_bytes(folder / name, _MAX_BYTES)
    if COMMANDS_FILE not in files:
        raise FindingError(
            f"{folder}: cannot be submitted: no {COMMANDS_FILE}{run_file.origin_note()}"
        )
    for file in _parameter_files(folder, config):
        files[f"parameters/{file.name}"] = file.read_bytes()

    contents = {
        "schema_version": SCHEMA_VERSION,
        "container": container,
        "claimed": CLAIMED,
        "files": {name: _sha256(content) for name, content in files.items()},
    }
    contents_text = json.dumps(contents, indent=1).encode()
    write_durably(Path(path), pack_zip({SUBMISSION_FILE: contents_text, **files}))
    return check


def _require_available_worlds(run_file: RunFile) -> None:
    """Raise ConfigError unless the worlds are the suite's or copied into the folder."""
    dataset = run_file.config.get("dataset")
    is_in_folder = dataset == str((run_file.path.parent / WORLDS).absolute())
    # Others do not have the worlds of a file on this machine.
    if dataset not in dataset_files() and not is_in_folder:
        raise ConfigError(
            f"{run_file.path}: dataset {format_value(dataset)} is not one that comes"
            " with the suite"
        )


def _parameter_files(folder: Path, config: RunConfig) -> Iterator[Path]:
    """Yield paths in a folder's logs: node parameters, copies of files in commands."""
    for planner in config.planners:
        yield from find_parameter_files(folder / LOGS, planner.name)
        for name, sha256 in planner.files.items():
            yield from (folder / LOGS).rglob(f"{sha256[:12]}_{Path(name).name}")


def _sha256(content: bytes) -> str:
    """Return the SHA-256 of bytes as hexadecimal digits."""
    return hashlib.sha256(content).hexdigest()


def verify(path: str | Path, folder: str | Path) -> tuple[FolderCheck, dict[str, Any]]:
    """Unpack a submission, check it, write tables; return (check, origin); or raise.

    Nothing in the file is trusted. If it has one row per trial, result tables are
    written.

    Args:
        path: File that `submit` has written.
        folder: Folder to unpack it into. It must be empty, which is not checked.

    Returns:
        The check, whose problems include what could not be checked; and the origin of
        the results: task, versions, machine and so on.

    Raises:
        ConfigError: If the file is not a submission or is damaged, is from another
            release, has worlds that are not available, or has too few rows.
    """
    path = Path(path)
    folder = Path(folder)
    container = _unpack(path, folder)
    run_file = RunFile.read(folder)
    config = run_file.run_config()
    config.require_own_names()
    _require_available_worlds(run_file)
    _require_release(path, run_file)

    rows = RowFile(folder).read()
    if not rows or len(rows) < len(config.planners) * config.repetitions:
        raise ConfigError(f"{path}: has {len(rows)} rows, too few for its planners")
    check = check_folder(folder)
    problems = [*check.problems, *check.unchecked]
    if not problems:
        problems += _find_impostors(config, rows)
    names = [planner.name for planner in config.planners]
    if check.rows != check.trials:
        problems.append(f"{path}: has {check.rows} of {check.trials} trials")
    # Extra rows belong to no trial; the check reports them.
    elif len(rows) == check.trials:
        ordered = sorted(
            rows, key=lambda row: (row.world, row.repetition, names.index(row.planner))
        )
        write_tables(folder, ordered)
    # The folder may be temporary, so problems name the user's file.
    check.problems = [line.replace(str(folder), str(path)) for line in problems]

    session = run_file.sessions[-1] if run_file.sessions else {}
    origin = {
        "task": run_file.task_fingerprint,
        "protocol": config.protocol.name,
        "dataset": Path(config.dataset).name,
        "worlds": config.worlds,
        "repetitions": config.repetitions,
        "seed": config.seed,
        "mode": config.mode,
        "planners": names,
        "versions": session.get("versions", {}),
        "commit": session.get("commit", ""),
        "machine": session.get("machine", {}),
        "container": container,
        "claimed": list(CLAIMED),
    }
    return check, origin


def _find_impostors(config: RunConfig, rows: Rows) -> Iterator[str]:
    """Drive up to 3 random trials per suite planner by the planner; yield differences.

    A submitter cannot know which trials are drawn.
    """
    specs = {spec.trial_id: spec for spec in config.trials()}
    for planner in config.planners:
        trials = {}
        for row in rows:
            is_repeatable = row.outcome in JUDGED_OUTCOMES and row.compute != REAL_TIME
            if row.planner == planner.name and planner.registered and is_repeatable:
                trials[row.trial_id] = row
        for trial_id in sample_trials(sorted(trials), _RERUNS):
            difference = drive_by_planner(specs[trial_id], trials[trial_id])
            if difference:
                yield f"{trial_id}: {planner.name} drives otherwise: {difference}"


def _require_release(path: Path, run_file: RunFile) -> None:
    """Raise ConfigError if a session used another release than the installed one."""
    current = versions()
    for session in run_file.sessions:
        session_versions = as_mapping(session.get("versions"))
        for package in SUITE:
            version = session_versions.get(package)
            if version != current[package]:
                raise ConfigError(
                    f"{path}: was made with {package} {format_value(version)}, but"
                    f" {current[package]} is installed"
                )


def _unpack(path: Path, folder: Path) -> str:
    """Unpack a submission and return its container's digest; ConfigError if it is none.

    Raises:
        ConfigError: If the file is not a submission, or is damaged.
    """
    try:
        with open_regular(path) as file, zipfile.ZipFile(file) as archive:
            # Before anything is unpacked.
            _require_members(path, archive.infolist())
            where = f"{path}: {SUBMISSION_FILE}"
            contents_text = _read_member(archive, SUBMISSION_FILE)
            contents = as_mapping(parse_json(contents_text, where))
            files = contents.get("files")
            is_known = contents.get("schema_version") == SCHEMA_VERSION
            if not is_known or not isinstance(files, dict):
                raise ConfigError(
                    f"{where}: schema_version must be {SCHEMA_VERSION}, with files"
                )
            if files.keys() != set(archive.namelist()) - {SUBMISSION_FILE}:
                raise ConfigError(
                    f"{where}: its list of files does not match the archive"
                )
            for name, sha256 in files.items():
                content = _read_member(archive, name)
                if _sha256(content) != sha256:
                    raise ConfigError(
                        f"{path}: the SHA-256 of {name} differs from that in"
                        f" {SUBMISSION_FILE}"
                    )
                # `_require_members` allows no name that leads out of the folder.
                (folder / name).parent.mkdir(exist_ok=True)
                (folder / name).write_bytes(content)
            (folder / SUBMISSION_FILE).write_bytes(contents_text)
    except ZIP_ERRORS as error:
        raise ConfigError(
            f"{path}: is not a submission, or is damaged: {error}"
        ) from None

    container = contents.get("container")
    if not isinstance(container, str) or not _CONTAINER.fullmatch(container):
        raise ConfigError(
            f"{where}: container {format_value(container)} is not a digest"
        )
    return container


def _require_members(path: Path, members: list[zipfile.ZipInfo]) -> None:
    """Raise ConfigError unless members are a submission's, once each, and not too big."""
    # One more than allowed shows that there are too many.
    names = [member.filename for member in members[: _MAX_MEMBERS + 1]]
    for name in names:
        if name not in (SUBMISSION_FILE, *_ALLOWED) and not _PARAMETERS.fullmatch(name):
            raise ConfigError(
                f"{path}: holds {format_value(name)}, which is not part of a submission"
            )
    missing = {SUBMISSION_FILE, *_REQUIRED}.difference(names)
    if missing:
        raise ConfigError(f"{path}: is not a submission: no {min(missing)}")
    if len(names) > _MAX_MEMBERS or len(set(names)) < len(names):
        raise ConfigError(
            f"{path}: holds a file twice, or more than {_MAX_MEMBERS} files"
        )
    for member in members:
        size = member.file_size
        if size > max(_SMALL_BYTES, _MAX_RATIO * member.compress_size):
            raise ConfigError(
                f"{path}: {member.filename} of {member.compress_size} bytes unpacks to"
                f" {size}"
            )
    total = sum(member.file_size for member in members)
    if total > _MAX_BYTES:
        raise ConfigError(
            f"{path}: unpacks to {total} bytes, more than the allowed {_MAX_BYTES}"
        )


def _read_member(archive: zipfile.ZipFile, name: str) -> bytes:
    """Return a member's content; ValueError if its size is not the one it states."""
    # A member may unpack to more than it states.
    size = archive.getinfo(name).file_size
    with archive.open(name) as file:
        content = file.read(size + 1)
    if len(content) != size:
        raise ValueError(f"{name} does not unpack to its declared {size} bytes")
    return content
