"""`barn check`, `submit` and `verify`: check results against their recordings."""

from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path
from tempfile import TemporaryDirectory

import click

from barn_eval.api.results import Results
from barn_eval.commands.options import (
    console,
    count_option,
    file_option,
    folder_argument,
    folder_option,
    json_option,
    notes,
    print_json,
    print_notes,
)
from barn_eval.results.run_file import RUN_FILE
from barn_eval.verification.check import FolderCheck, check_folder
from barn_eval.verification.submission import submit as write_submission
from barn_eval.verification.submission import verify as verify_submission
from barn_worlds.base.config import as_dict
from barn_worlds.base.errors import BarnError, ExitCode, FindingError
from barn_worlds.base.files import create_folder

# What `barn verify` prints of a submission.
_SUBMISSION_KEYS = (
    "protocol",
    "task",
    "dataset",
    "worlds",
    "seed",
    "mode",
    "planners",
    "container",
    "machine",
    "claimed",
)


@click.command("check")
@folder_argument
@click.option(
    "--rerun",
    metavar="TRIAL",
    help="Trial to run again with its planner and compare: a name, or a number from 1.",
)
@count_option(
    "--sample",
    help="Number of trials to simulate again from their commands [default: all].",
)
@json_option
def command(folder: Path, rerun: str | None, sample: int | None, as_json: bool) -> int:
    """Check the results in FOLDER by recomputing them from the recordings.

    The command recomputes scores, times, clearances, contacts and outcomes from tracks
    and bags. It simulates each trial again from the recorded commands and compares the
    trajectory with the recorded one. It also checks that rows, tables, worlds and
    configuration match. The run may be unfinished. Each fault is printed on one line.
    The exit code is 1 if there is a fault.
    """
    with _findings_in(folder / RUN_FILE, "checking"):
        check = check_folder(folder, sample=sample)
    # None in the JSON output says that no trial was to be run again.
    is_reproduced = None
    if rerun is not None and not check.problems:
        results = Results(folder)
        # A name, or a number from 1.
        is_number = rerun.isdecimal() and 1 <= int(rerun) <= len(results)
        difference = results.rerun(int(rerun) - 1 if is_number else rerun)
        is_reproduced = not difference
        if difference:
            # Like any other problem, a difference decides the exit code.
            check.problems.append(f"{folder}: {rerun} is not reproduced: {difference}")

    if as_json:
        print_json(as_dict(check) | {"reproduced": is_reproduced})
    else:
        print_check(check)
        if is_reproduced:
            console.print(f"{rerun} is reproduced")
    return ExitCode.FINDINGS if check.problems else ExitCode.DONE


@contextmanager
def _findings_in(path: Path, status: str) -> Iterator[None]:
    """Show a status; turn any BarnError into a FindingError if `path` exists."""
    try:
        with notes.status(status):
            yield
    except BarnError as error:
        if not path.exists():
            raise
        raise FindingError(str(error)) from None


def print_check(check: FolderCheck) -> None:
    """Print what a check covered to standard output, problems to standard error."""
    counts = (
        f"{check.rows} of {check.trials} rows, {check.tracks} tracks,"
        f" {check.bags} bags, {check.driven} driven again"
    )
    for line in (counts, *check.unchecked, *check.notes):
        console.print(line, soft_wrap=True)
    for line in check.problems:
        click.echo(line, err=True)


@click.command("submit")
@folder_argument
@file_option("--out", help="File to write [default: FOLDER.barn.zip].")
@click.option(
    "--container",
    default="",
    metavar="DIGEST",
    help="Digest of the container image that the planner ran in, such as sha256:...",
)
def submit(folder: Path, out: Path | None, container: str) -> None:
    """Check the results in FOLDER and write them to one file for `barn verify`.

    The file holds rows, tracks, commands, parameter files, versions, and a description
    of the machine. Anyone can verify the file on another machine.
    """
    # resolve() gives "." a name.
    path = out or Path(f"{folder.resolve().name}.barn.zip")
    with notes.status("checking"):
        check = write_submission(folder, path, container)
    print_check(check)
    print_notes(path)


@click.command("verify")
@click.argument("file", type=click.Path(exists=True, dir_okay=False, path_type=Path))
@folder_option(
    "--out", help="Folder for the verified results, for example for `barn leaderboard`."
)
@json_option
def verify(file: Path, out: Path | None, as_json: bool) -> None:
    """Verify a FILE that `barn submit` wrote.

    Any machine with the same release can do so. The command recomputes every score and
    simulates every trial again from its commands. Anything that cannot be checked
    counts as a failure. Each failure is printed on one line. If there is a failure, the
    exit code is 1 and --out is not written.
    """
    # Results that failed must not stay in a folder that others then rank.
    with TemporaryDirectory() if out is None else create_folder(out) as folder:
        with _findings_in(file, "verifying"):
            check, submission = verify_submission(file, Path(folder))
        is_valid = not check.problems
        if as_json:
            print_json({"holds": is_valid, **submission, **as_dict(check)})
        else:
            for key in _SUBMISSION_KEYS:
                console.print(f"{key}: {submission[key]}", soft_wrap=True)
            print_check(check)
            console.print("holds" if is_valid else "does not hold")
        # Leaving the context by an exception keeps the folder from being created.
        if not is_valid:
            click.get_current_context().exit(ExitCode.FINDINGS)
