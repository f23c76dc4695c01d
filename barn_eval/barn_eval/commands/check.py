"""`barn check`, `submit` and `verify`: whether results follow from what was recorded, here or in a file of others."""

from pathlib import Path
from tempfile import TemporaryDirectory

import click

from barn_eval.api.results import Results
from barn_eval.commands.options import (
    COUNT,
    FILE,
    FOLDER,
    PATH,
    console,
    json_option,
    notes,
    print_json,
    print_notes,
)
from barn_eval.verification.check import FolderCheck, check_folder
from barn_eval.verification.submission import submit as write_submission
from barn_eval.verification.submission import verify as verify_submission
from barn_worlds.base.config import as_dict
from barn_worlds.base.files import create_folder


@click.command("check")
@click.argument("folder", type=PATH)
@click.option(
    "--rerun",
    metavar="TRIAL",
    help="Run a trial again, by its name or number from 1, and compare.",
)
@click.option(
    "--sample",
    type=COUNT,
    help="Drive the commands of so many trials again [default: of all].",
)
@json_option
def command(folder: Path, rerun: str | None, sample: int | None, as_json: bool) -> int:
    """Check the results in FOLDER: nothing is believed, all is computed again.

    Scores, times, clearances, contacts and outcomes follow from tracks and bags by the referee's own code; the commands
    in bags, driven again without their planner, must give the recorded trajectory. Rows, tables, worlds and
    configuration must belong together. FOLDER is of an experiment, finished or not. Exit code 1 if anything is wrong,
    with a line for each.
    """
    with notes.status("checking"):
        found = check_folder(folder, sample=sample)
    reproduced = None
    if rerun is not None and not found.problems:
        results = Results(folder)
        places = {str(number): number - 1 for number in range(1, len(results) + 1)}
        other = results.rerun(places.get(rerun, rerun))
        reproduced = not other
        found.problems += (
            [f"{folder}: {rerun} is not reproduced: {other}"] if other else []
        )
    if as_json:
        print_json(as_dict(found) | {"reproduced": reproduced})
    else:
        show_check(found)
        if reproduced:
            console.print(f"{rerun} is reproduced", highlight=False)
    return int(bool(found.problems))


def show_check(found: FolderCheck) -> None:
    """Print what a check has looked at and could not check, and, to standard error, what is wrong."""
    of = f"{found.rows} of {found.trials} rows, {found.tracks} tracks, {found.bags} bags, {found.driven} driven again"
    for line in (of, *found.unchecked):
        console.print(line, highlight=False, markup=False, soft_wrap=True)
    for line in found.problems:
        click.echo(line, err=True)


@click.command("submit")
@click.argument("folder", type=PATH)
@click.option(
    "--out", type=FILE, help="File to write [default: the folder's name, .barn.zip]."
)
@click.option(
    "--container",
    default="",
    metavar="DIGEST",
    help="Of the image that the planner ran in, sha256:...",
)
def submit(folder: Path, out: Path | None, container: str) -> None:
    """Write the results in FOLDER, once they have been checked, as one file that `barn verify` checks anywhere.

    It holds rows, tracks, the commands in the bags (which `barn run --bags all` keeps), parameter files, versions and
    machine.
    """
    path = out or Path(f"{folder.resolve().name}.barn.zip")
    with notes.status("checking"):
        found = write_submission(folder, path, container)
    show_check(found)
    print_notes(path)


@click.command("verify")
@click.argument("file", type=FILE)
@click.option(
    "--out",
    type=FOLDER,
    help="Folder to unpack into what holds, such as for `barn leaderboard`.",
)
@json_option
def verify(file: Path, out: Path | None, as_json: bool) -> None:
    """Check a FILE of `barn submit` as `barn check` does, on any machine with the same release.

    Every score is computed and every trial is driven again from its commands. What cannot be is wrong here, too. Exit
    code 1 if anything is, with a line for each, and then --out is not written.
    """
    with TemporaryDirectory() if out is None else create_folder(out) as folder:
        with notes.status("verifying"):
            found, about = verify_submission(file, Path(folder))
        holds = not found.problems
        if as_json:
            print_json({"holds": holds, **about, **as_dict(found)})
        else:
            for key in (
                "protocol",
                "task",
                "dataset",
                "worlds",
                "seed",
                "mode",
                "planners",
                "container",
                "machine",
            ):
                console.print(
                    f"{key}: {about[key]}",
                    highlight=False,
                    markup=False,
                    soft_wrap=True,
                )
            show_check(found)
            console.print("holds" if holds else "does not hold", highlight=False)
        if not holds:
            click.get_current_context().exit(1)
