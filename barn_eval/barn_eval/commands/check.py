"""`barn check`: whether the results of an experiment follow from what was recorded."""

from pathlib import Path

import click

from barn_eval.commands.options import COUNT, PATH, console, json_option, notes, print_json
from barn_eval.experiments.check import FolderCheck, check_folder
from barn_eval.results import Results
from barn_worlds.base.config import as_dict


@click.command("check")
@click.argument("folder", type=PATH)
@click.option("--rerun", metavar="TRIAL", help="Run a trial again, by its name or number from 1, and compare.")
@click.option("--sample", type=COUNT, help="Drive the commands of so many trials again [default: of all].")
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
        found.problems += [f"{folder}: {rerun} is not reproduced: {other}"] if other else []
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
