"""`barn check`: whether the files of an experiment belong together."""

from pathlib import Path

import click

from barn_eval.commands.options import PATH, console, json_option, print_json
from barn_eval.experiments.check import check_folder
from barn_eval.results import Results
from barn_worlds.base.config import as_dict


@click.command("check")
@click.argument("folder", type=PATH)
@click.option("--rerun", metavar="TRIAL", help="Run a trial again, by its name or number from 1, and compare.")
@json_option
def command(folder: Path, rerun: str | None, as_json: bool) -> int:
    """Check that rows, tracks, bags, tables, worlds and configuration in FOLDER belong together.

    FOLDER is of an experiment, finished or not. Exit code 1 if anything is wrong, with a line for each.
    """
    found = check_folder(folder)
    reproduced = None
    if rerun is not None and not found.problems:
        results = Results(folder)
        places = {str(number): number - 1 for number in range(1, len(results) + 1)}
        other = results.rerun(places.get(rerun, rerun))
        reproduced = not other
        found.problems += [f"{folder}: {rerun} is not reproduced: {other}"] if other else []
    if as_json:
        print_json(as_dict(found) | {"reproduced": reproduced})
    else:
        of = f"{found.rows} of {found.trials} rows, {found.tracks} tracks, {found.bags} bags"
        console.print(of, highlight=False)
        if reproduced:
            console.print(f"{rerun} is reproduced", highlight=False)
        for line in found.problems:
            click.echo(line, err=True)
    return int(bool(found.problems))
