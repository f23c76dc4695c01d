"""A result in one file that a stranger can verify: rows, tracks, commands, worlds, parameters, versions, machine."""

import hashlib
import json
import re
import zipfile
from collections.abc import Iterator, Mapping
from pathlib import Path
from typing import Any

from barn_eval.results.bags import BAGS
from barn_eval.results.bags.bagfile import BagFile
from barn_eval.results.provenance import SUITE, versions
from barn_eval.results.rows import (
    ROWS_FILE,
    TRACKS_FILE,
    RowFile,
    seal_line,
    write_tables,
)
from barn_eval.results.run_file import RUN_FILE, WORLDS, RunFile
from barn_eval.results.store import LOGS
from barn_eval.results.tracks import pack_arrays
from barn_eval.running.command_files import find_parameter_files
from barn_eval.verification.check import FolderCheck, check_folder
from barn_eval.verification.rerun import COMMANDS_NAME, read_bag
from barn_worlds.base.errors import ConfigError, format_value
from barn_worlds.base.files import (
    ZIP_ERRORS,
    open_regular,
    pack_zip,
    read_bytes,
    write_durably,
)
from barn_worlds.base.text_files import parse_json
from barn_worlds.datasets.dataset import dataset_files

SCHEMA_VERSION = 1
ABOUT = "submission.json"
_NEEDED = (RUN_FILE, ROWS_FILE, TRACKS_FILE, COMMANDS_NAME)
_ALLOWED = (*_NEEDED, WORLDS, f"{Path(WORLDS).stem}.manifest.json")
_PARAMETERS = re.compile(
    r"parameters/[0-9a-f]{12}_[A-Za-z0-9_.-]{1,100}"
)  # of files that planners' commands name
_DIGEST = re.compile(r"(|([A-Za-z0-9_./:-]{1,200}@)?sha256:[0-9a-f]{64})")
_MOST_MEMBERS, _LARGEST, _RATIO = (
    100,
    1 << 29,
    100,
)  # bytes of all members; unpacked by packed of a large one
_SMALL = 1 << 20


def submit(folder: str | Path, path: str | Path, container: str = "") -> FolderCheck:
    """Write the finished results of a folder, once they are checked, as one file; equal results give equal bytes.

    Args:
        folder: Of an experiment.
        path: File to write, .zip.
        container: Digest of the image that the planner ran in.

    Returns:
        What the check has found.

    Raises:
        ConfigError: Anything is wrong, or the worlds are those of a file that nobody else has.
    """
    folder, path = Path(folder), Path(path)
    if not _DIGEST.fullmatch(container):
        raise ConfigError(
            f"container {format_value(container)}: must be sha256: and 64 digits, after a name and @ if wanted"
        )
    found, run = check_folder(folder), RunFile.read(folder)
    if found.problems or found.rows != found.trials:
        why = (
            found.problems[0]
            if found.problems
            else f"has {found.rows} of {found.trials} trials"
        )
        raise ConfigError(f"{folder}: is not to be submitted: {why}")
    _require_worlds(run, folder)
    files = {
        name: read_bytes(folder / name, _LARGEST)
        for name in _ALLOWED
        if (folder / name).is_file()
    }
    if COMMANDS_NAME not in files:  # of one that was unpacked
        files[COMMANDS_NAME] = "".join(
            f"{seal_line(line)}\n" for line in _command_lines(folder)
        ).encode()
    for planner in run.run_config().planners:
        files |= {
            f"parameters/{one.name}": one.read_bytes()
            for one in find_parameter_files(folder / LOGS, planner.name)
        }
        for name, digest in planner.files.items():
            kept = f"{digest[:12]}_{Path(name).name}"
            files |= {
                f"parameters/{kept}": one.read_bytes()
                for one in (folder / LOGS).rglob(kept)
            }
    digests = {name: _digest(content) for name, content in files.items()}
    about = {"schema_version": SCHEMA_VERSION, "container": container, "files": digests}
    write_durably(
        path, pack_zip({ABOUT: json.dumps(about, indent=1).encode(), **files})
    )
    return found


def _require_worlds(run: RunFile, folder: Path) -> None:
    dataset = run.config.get("dataset")
    if dataset not in dataset_files() and dataset != str((folder / WORLDS).absolute()):
        raise ConfigError(
            f"{run.path}: dataset {format_value(dataset)} is not one that comes with the suite"
        )


def _command_lines(folder: Path) -> Iterator[str]:
    for row in RowFile(folder).read():
        bag = folder / BAGS / row.trial_id
        driven = read_bag(BagFile(bag))[0] if bag.is_dir() else None
        if driven is not None and (driven.exact or row.mode == "direct"):
            packed = pack_arrays({"commands": driven.trajectory.command.ravel()})
            yield json.dumps({"trial_id": row.trial_id} | packed, separators=(",", ":"))


def _digest(content: bytes) -> str:
    return hashlib.sha256(content).hexdigest()


def verify(path: str | Path, folder: str | Path) -> tuple[FolderCheck, dict[str, Any]]:
    """Unpack a submission into an empty folder and check it there: nothing in it is believed.

    Args:
        path: Of a file of `submit`.
        folder: Where it is unpacked.

    Returns:
        What was found, where what could not be checked is wrong as well; and what the results are of: release, machine,
        task and so on.

    Raises:
        ConfigError: The file is no submission, is damaged, or of another release.
    """
    path, folder = Path(path), Path(folder)
    container = _unpack(path, folder)
    run = RunFile.read(folder)
    experiment, here = run.run_config(), versions()
    _require_worlds(run, folder)
    for session in run.sessions:
        made = session.get("versions")
        made = made if isinstance(made, dict) else {}
        for name in SUITE:
            if made.get(name) != here[name]:
                raise ConfigError(
                    f"{path}: was made with {name} {format_value(made.get(name))}, this is {here[name]}"
                )
    rows = RowFile(folder).read()
    if not rows or len(experiment.planners) * experiment.repetitions > len(rows):
        raise ConfigError(f"{path}: has {len(rows)} rows, too few for its planners")
    found = check_folder(folder)
    if found.rows == found.trials:
        place = {
            planner.name: number for number, planner in enumerate(experiment.planners)
        }
        write_tables(
            folder,
            sorted(
                rows, key=lambda row: (row.world, row.repetition, place[row.planner])
            ),
        )
    else:
        found.problems.append(f"{path}: has {found.rows} of {found.trials} trials")
    found.problems = [
        line.replace(str(folder), str(path))
        for line in (*found.problems, *found.unchecked)
    ]
    last: Mapping[str, Any] = run.sessions[-1] if run.sessions else {}
    about = {
        "task": run.task_fingerprint(),
        "protocol": experiment.protocol.name,
        "dataset": Path(experiment.dataset).name,
        **{
            key: getattr(experiment, key)
            for key in ("worlds", "repetitions", "seed", "mode")
        },
        "planners": [planner.name for planner in experiment.planners],
        "versions": last.get("versions", {}),
        "commit": last.get("commit", ""),
        "machine": last.get("machine", {}),
        "container": container,
    }
    return found, about


def _unpack(path: Path, folder: Path) -> str:
    """Write the members of a submission into a folder and return the container; ConfigError for any other file."""
    try:
        with open_regular(path) as file, zipfile.ZipFile(file) as archive:
            members = {one.filename: one for one in archive.infolist()}
            _require_members(path, archive.infolist())
            about = parse_json(
                _content(archive, members[ABOUT]).decode(), f"{path}: {ABOUT}"
            )
            files = about.get("files") if isinstance(about, dict) else None
            if (
                not isinstance(files, dict)
                or about.get("schema_version") != SCHEMA_VERSION
            ):
                raise ConfigError(
                    f"{path}: {ABOUT}: schema_version must be {SCHEMA_VERSION}, with files"
                )
            if files.keys() != members.keys() - {ABOUT}:
                raise ConfigError(
                    f"{path}: {ABOUT} does not name the files that there are"
                )
            for name in files:
                content = _content(archive, members[name])
                if _digest(content) != files[name]:
                    raise ConfigError(
                        f"{path}: {name} has not the SHA-256 that {ABOUT} states"
                    )
                (folder / name).parent.mkdir(exist_ok=True)
                (folder / name).write_bytes(content)
    except ZIP_ERRORS as error:
        raise ConfigError(
            f"{path}: not a submission, or a damaged one: {error}"
        ) from None
    container = about.get("container")
    if not isinstance(container, str) or not _DIGEST.fullmatch(container):
        raise ConfigError(
            f"{path}: {ABOUT}: container {format_value(container)} is no digest"
        )
    return container


def _require_members(path: Path, members: list[zipfile.ZipInfo]) -> None:
    """Raise ConfigError unless members are those of a submission, once each, and of a size that is to be unpacked."""
    names = [one.filename for one in members[: _MOST_MEMBERS + 1]]
    for name in names:
        if name not in (ABOUT, *_ALLOWED) and not _PARAMETERS.fullmatch(name):
            raise ConfigError(
                f"{path}: holds {format_value(name)}, which is no part of a submission"
            )
    if missing := {ABOUT, *_NEEDED}.difference(names):
        raise ConfigError(f"{path}: not a submission: has no {min(missing)}")
    if len(names) > _MOST_MEMBERS or len(set(names)) < len(names):
        raise ConfigError(
            f"{path}: holds a file twice, or more than {_MOST_MEMBERS} files"
        )
    for one in members:
        if one.file_size > max(_SMALL, _RATIO * one.compress_size):
            raise ConfigError(
                f"{path}: {one.filename} of {one.compress_size} bytes unpacks to {one.file_size}"
            )
    if (total := sum(one.file_size for one in members)) > _LARGEST:
        raise ConfigError(
            f"{path}: unpacks to {total} bytes, more than the allowed {_LARGEST}"
        )


def _content(archive: zipfile.ZipFile, member: zipfile.ZipInfo) -> bytes:
    with archive.open(member) as file:
        content = file.read(member.file_size + 1)
    if len(content) != member.file_size:
        raise ValueError(
            f"{member.filename} is not of the {member.file_size} bytes that it states"
        )
    return content
