"""`barn metrics`: the five difficulty metrics of worlds."""

import click

from barn_eval.api.worlds import metrics_table
from barn_eval.commands.options import json_option, print_output, worlds_option
from barn_eval.commands.tables import table


@click.command("metrics")
@click.argument("source", default="barn300")
@worlds_option
@click.option(
    "--formula",
    default="corrected",
    help="corrected, published (the numbers in print) or paper_text.",
)
@click.option(
    "--robot",
    help="Whose C-space and path are measured: a name or a YAML file [default: the"
    " worlds' own].",
)
@json_option
def command(
    source: str, select: str, formula: str, robot: str | None, as_json: bool
) -> None:
    """Compute the five difficulty metrics of the worlds of SOURCE and their summary, as in the paper's Table II.

    Under protocol challenge they order worlds better than the learned difficulty does,
    under paper2020 less well.
    """
    metrics = metrics_table(source, select, formula, robot=robot or "")
    headings, rows = metrics.summary_cells()
    # All columns but the first are numbers.
    columns = [headings[0], *(f">{heading}" for heading in headings[1:])]
    title = f"{len(metrics.worlds)} worlds, {formula}"
    print_output(as_json, metrics.as_json(), table(columns, rows, title=title))
