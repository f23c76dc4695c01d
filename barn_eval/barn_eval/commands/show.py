"""`barn show`: one world as a picture."""

from pathlib import Path

import click

from barn_eval.commands.options import FILE, console, say, table
from barn_worlds.dataset import open_dataset
from barn_worlds.errors import WorldError


@click.command()
@click.argument("world")
@click.option("--dataset", default="barn300", show_default=True, help="Data set that a number is looked up in.")
@click.option("--out", type=FILE, help="Picture [default: world_N.png].")
@click.option("--metrics", "with_metrics", is_flag=True, help="Draw a map of each difficulty metric as well.")
def show(world: str, dataset: str, out: Path | None, with_metrics: bool) -> None:
    """Draw a world: WORLD is a number in the data set, or a file with one world."""
    opened = open_dataset(dataset if world.isdecimal() else world)
    index = int(world) if world.isdecimal() else opened.indices[0]
    if not world.isdecimal() and len(opened.indices) > 1:
        raise WorldError(f"{world}: holds {len(opened.indices)} worlds; give a number and --dataset {world}")
    found = opened.load(index)
    target = out or Path(f"world_{index}.png")
    if with_metrics:
        from barn_metrics.world_figure import draw_world_figure  # noqa: PLC0415 (matplotlib)

        draw_world_figure(found, target)
    else:
        from barn_worlds.render import world_figure, write_png  # noqa: PLC0415 (matplotlib)

        write_png(world_figure(found), target)
    rows = (
        ("grid", f"{found.rows} x {found.cols} cells of {found.resolution_m:g} m"),
        ("filled cells", str(int(found.grid.sum()))),
        ("path", f"{found.path_length_m:.2f} m from cell {found.start_cell} to {found.goal_cell}"),
        ("source", found.provenance.source),
        ("checksum", found.checksum),
    )
    console.print(table((found.name, ""), rows))
    say(target)
