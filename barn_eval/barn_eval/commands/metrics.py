"""`barn metrics`: the five difficulty metrics of worlds."""

from pathlib import Path

import click

from barn_eval.commands.options import FILE, console, json_option, say, table, worlds_option
from barn_worlds.dataset import open_dataset
from barn_worlds.spec import select_worlds


@click.command()
@click.argument("source", default="barn300")
@worlds_option
@click.option(
    "--formula",
    default="corrected",
    show_default=True,
    help="corrected, published (the numbers in print) or paper_text.",
)
@click.option("--csv", "csv_path", type=FILE, help="Write a line per world here.")
@click.option("--figure", type=FILE, help="Draw the metrics of one world here.")
@json_option
def metrics(source: str, spec: str, formula: str, csv_path: Path | None, figure: Path | None, as_json: bool) -> None:
    """Compute the five difficulty metrics of the worlds of SOURCE and their summary, as in the paper's Table II."""
    from barn_eval.world_sets import metrics_table  # noqa: PLC0415 (compiled kernels)
    from barn_metrics.formula import as_formula  # noqa: PLC0415

    chosen = as_formula(formula)
    opened = open_dataset(source)
    numbers = select_worlds(spec, opened.indices)
    if figure is not None and len(numbers) != 1:
        raise click.UsageError(f"--figure draws one world; --worlds chooses {len(numbers)}")
    result = metrics_table(source, spec, formula)
    if csv_path is not None:
        result.to_csv(csv_path)
        say(csv_path)
    if figure is not None:
        from barn_metrics.world_figure import draw_world_figure  # noqa: PLC0415 (matplotlib)

        draw_world_figure(opened.load(numbers[0]), figure, chosen)
        say(figure)
    if as_json:
        click.echo(result.to_json(), nl=False)
        return
    headings, lines = result.summary_cells()
    columns = [headings[0], *(f">{heading}" for heading in headings[1:])]
    console.print(table(columns, lines, title=f"{len(numbers)} worlds, {formula}"))
