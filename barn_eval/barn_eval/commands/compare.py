"""`barn compare`: two planners, or two campaigns of one planner, on the worlds and seeds that they share."""

from pathlib import Path

import click

from barn_eval.commands.options import PATH, console, json_option, print_json, rich_table
from barn_worlds.config import as_dict


@click.command()
@click.argument("a", type=PATH)
@click.argument("b", type=PATH)
@json_option
def compare(a: Path, b: Path, as_json: bool) -> None:
    """Compare A with B: folders of runs or campaigns, finished or not.

    FOLDER:PLANNER chooses one of several planners. Where both folders hold several and none is chosen, planners of
    the same name are compared.
    """
    from barn_eval.analysis.compare import compare_folders  # noqa: PLC0415 (scipy)
    from barn_eval.analysis.tables import comparison_table  # noqa: PLC0415
    from barn_eval.analysis.verdict import pair_verdict  # noqa: PLC0415

    found = compare_folders(a, b)
    if as_json:
        print_json([as_dict(one) | {"verdict": pair_verdict(one)} for one in found])
        return
    for one in found:
        console.print(pair_verdict(one), markup=False, highlight=False)
        console.print(rich_table(comparison_table(one)))
