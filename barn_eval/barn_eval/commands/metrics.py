"""`barn metrics`: the five difficulty metrics of worlds."""

from pathlib import Path

import click

from barn_eval.commands.options import FILE, console, json_option, say, worlds_option
from barn_eval.commands.tables import table
from barn_eval.worlds.measured import load_for, metrics_table
from barn_metrics.formula import as_formula
from barn_metrics.world_figure import draw_world_figure
from barn_worlds.robots.files import load_robot
from barn_worlds.worlds.dataset import open_dataset
from barn_worlds.worlds.selection import select_worlds


@click.command("metrics")
@click.argument("source", default="barn300")
@worlds_option
@click.option(
    "--formula",
    default="corrected",
    show_default=True,
    help="corrected, published (the numbers in print) or paper_text.",
)
@click.option("--robot", help="Whose C-space and path are measured: a name or a YAML file [default: the worlds' own].")
@click.option(
    "--out", type=FILE, multiple=True, help="A line per world (.csv), or the maps of one world (.png); repeatable."
)
@json_option
def command(source: str, spec: str, formula: str, robot: str | None, out: tuple[Path, ...], as_json: bool) -> None:
    """Compute the five difficulty metrics of the worlds of SOURCE and their summary, as in the paper's Table II."""
    chosen = as_formula(formula)
    opened = open_dataset(source)
    numbers = select_worlds(spec, opened.indices)
    figures = [path for path in out if path.suffix != ".csv"]
    if figures and len(numbers) != 1:
        raise click.UsageError(f"--out {figures[0]} draws one world; --worlds chooses {len(numbers)}")
    result = metrics_table(opened, spec, formula, robot=robot or "")
    for path in out:
        if path in figures:
            driven = load_robot(robot) if robot else None
            draw_world_figure(load_for(opened, numbers[0], driven), path, chosen)
        else:
            result.to_csv(path)
        say(path)
    if as_json:
        click.echo(result.to_json(), nl=False)
        return
    headings, lines = result.summary_cells()
    columns = [headings[0], *(f">{heading}" for heading in headings[1:])]
    console.print(table(columns, lines, title=f"{len(numbers)} worlds, {formula}"))
