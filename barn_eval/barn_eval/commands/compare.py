"""`barn compare`: planners on the same worlds and seeds."""

from pathlib import Path

import click

from barn_eval.analysis.compare import compare_folders
from barn_eval.analysis.tables import comparison_table
from barn_eval.analysis.verdict import pair_verdict
from barn_eval.commands.options import PATH, console, json_option, print_json, progress
from barn_eval.commands.tables import rich_table
from barn_eval.trials.identity import task_line
from barn_worlds.base.config import as_dict


@click.command("compare")
@click.argument("a", type=PATH)
@click.argument("b", type=PATH, required=False)
@json_option
def command(a: Path, b: Path | None, as_json: bool) -> None:
    """Compare A with B: folders of experiments, finished or not. Without B, the planners of A with each other.

    FOLDER:PLANNER chooses one of several planners, FOLDER:PLANNER,PLANNER some. Where both folders hold several and
    none is chosen, planners of the same name are compared.
    """
    with progress("comparing") as share:
        found = compare_folders(a, b, progress=share)
    if as_json:
        print_json([as_dict(one) | {"verdict": pair_verdict(one)} for one in found])
        return
    console.print(task_line(found[0].protocol, found[0].task, found[0].robot), highlight=False)
    for one in found:
        console.print(pair_verdict(one), markup=False, highlight=False)
        console.print(rich_table(comparison_table(one)))
