"""`barn submit`: finished results as one file that anybody can verify."""

from pathlib import Path

import click

from barn_eval.commands.check import show_check
from barn_eval.commands.options import FILE, PATH, notes, say
from barn_eval.experiments.submission import submit


@click.command("submit")
@click.argument("folder", type=PATH)
@click.option("--out", type=FILE, help="File to write [default: the folder's name, .barn.zip].")
@click.option("--container", default="", metavar="DIGEST", help="Of the image that the planner ran in, sha256:...")
def command(folder: Path, out: Path | None, container: str) -> None:
    """Write the results in FOLDER, once they have been checked, as one file that `barn verify` checks anywhere.

    It holds rows, tracks, the commands in the bags (which `barn run --bags all` keeps), parameter files, versions and
    machine.
    """
    path = out or Path(f"{folder.resolve().name}.barn.zip")
    with notes.status("checking"):
        found = submit(folder, path, container)
    show_check(found)
    say(path)
