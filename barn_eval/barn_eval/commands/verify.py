"""`barn verify`: whether the results in a file of `barn submit` hold."""

from pathlib import Path
from tempfile import TemporaryDirectory

import click

from barn_eval.commands.check import show_check
from barn_eval.commands.options import FILE, FOLDER, console, json_option, notes, print_json
from barn_eval.experiments.submission import verify
from barn_worlds.base.config import as_dict
from barn_worlds.base.files import new_folder


@click.command("verify")
@click.argument("file", type=FILE)
@click.option("--out", type=FOLDER, help="Folder to unpack into what holds, such as for `barn leaderboard`.")
@json_option
def command(file: Path, out: Path | None, as_json: bool) -> None:
    """Check a FILE of `barn submit` as `barn check` does, on any machine with the same release.

    Every score is computed and every trial is driven again from its commands. What cannot be is wrong here, too. Exit
    code 1 if anything is, with a line for each, and then --out is not written.
    """
    with TemporaryDirectory() if out is None else new_folder(out) as folder:
        with notes.status("verifying"):
            found, about = verify(file, Path(folder))
        holds = not found.problems
        if as_json:
            print_json({"holds": holds, **about, **as_dict(found)})
        else:
            for key in ("protocol", "task", "dataset", "worlds", "seed", "mode", "planners", "container", "machine"):
                console.print(f"{key}: {about[key]}", highlight=False, markup=False, soft_wrap=True)
            show_check(found)
            console.print("holds" if holds else "does not hold", highlight=False)
        if not holds:
            click.get_current_context().exit(1)
