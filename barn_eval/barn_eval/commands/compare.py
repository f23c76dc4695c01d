"""`barn compare`: planners on the same worlds and seeds."""

from pathlib import Path

import click

from barn_eval.analysis.compare import COMPARED, compare_folders, groups_of
from barn_eval.analysis.measures import measures_named
from barn_eval.analysis.paper import paper_table
from barn_eval.analysis.tables import comparison_table
from barn_eval.analysis.verdict import pair_verdict
from barn_eval.commands.options import FILE, PATH, console, json_option, keys_of, print_json, progress, say
from barn_eval.commands.tables import rich_table
from barn_eval.pages.template import write_page
from barn_eval.trials.identity import task_line
from barn_worlds.base.config import as_dict


@click.command("compare")
@click.argument("a", type=PATH)
@click.argument("b", type=PATH, required=False)
@click.option("--columns", default="", show_default=False, help="Measures, such as success,challenge.")
@click.option("--latex", type=FILE, help="Write the planners as a table of a paper, the best in bold.")
@json_option
def command(a: Path, b: Path | None, columns: str, latex: Path | None, as_json: bool) -> None:
    """Compare A with B: folders of experiments, finished or not. Without B, the planners of A with each other.

    FOLDER:PLANNER chooses one of several planners, FOLDER:PLANNER,PLANNER some. Where both folders hold several and
    none is chosen, planners of the same name are compared.
    """
    keys = measures_named(keys_of(columns))
    with progress("comparing") as share:
        found = compare_folders(a, b, keys=keys or COMPARED, progress=share)
    if latex is not None:
        write_page(latex, paper_table(groups_of(a, b), keys))
        say(latex)
    if as_json:
        print_json([as_dict(one) | {"verdict": str(pair_verdict(one))} for one in found])
        return
    console.print(task_line(found[0].protocol, found[0].task, found[0].robot), highlight=False)
    for one in found:
        for line in pair_verdict(one):
            console.print(line, markup=False, highlight=False)
        console.print(rich_table(comparison_table(one)))
