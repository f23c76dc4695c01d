"""`barn metrics` and `barn show`: the five difficulty metrics of worlds, and a world as a picture."""

from pathlib import Path

import click

from barn_eval.commands.options import FILE, PATH, console, json_option, say, worlds_option
from barn_eval.commands.tables import table
from barn_worlds.base.errors import WorldError
from barn_worlds.robots.files import load_robot
from barn_worlds.worlds.dataset import open_dataset
from barn_worlds.worlds.selection import select_worlds


@click.command()
@click.argument("world", required=False)
@click.option("--dataset", default="barn300", show_default=True, help="Data set that a number is looked up in.")
@click.option("--out", type=FILE, help="Picture, with trials also .svg or .pdf [default: world_N.png, trials_wN.png].")
@click.option("--metrics", "with_metrics", is_flag=True, help="Draw a map of each difficulty metric as well.")
@click.option("--world", "number", type=int, help="Number of the world; the same as WORLD.")
@click.option("--trials", multiple=True, type=PATH, help="Draw the trials of this folder in it; may be repeated.")
@click.option("--by", type=click.Choice(("planner", "speed")), help="What trials are coloured by [default: planner].")
@click.option("--planner", "planners", help="Only trials of these planners, such as dwa,eband.")
@click.option("--outcome", help="Only trials that ended so, such as collision.")
def show(
    world: str | None,
    dataset: str,
    out: Path | None,
    with_metrics: bool,
    number: int | None,
    trials: tuple[Path, ...],
    by: str | None,
    planners: str | None,
    outcome: str | None,
) -> None:
    """Draw a world, or trials over it: WORLD is a number in the data set, or a file with one world."""
    if (world is None) == (number is None):
        raise click.UsageError("give one world, as WORLD or as --world N")
    world = str(number) if world is None else world
    if trials:
        if not world.isdecimal():
            raise click.UsageError(f"--trials needs the number of a world, got {world!r}")
        show_trials(trials, int(world), out, by or "planner", planners, outcome or "")
        return
    for option, value in (("--by", by), ("--planner", planners), ("--outcome", outcome)):
        if value:
            raise click.UsageError(f"{option} needs --trials")
    show_world(world, dataset, out, with_metrics)


def show_trials(
    folders: tuple[Path, ...], world: int, out: Path | None, by: str, planners: str | None, outcome: str
) -> None:
    """Draw the trials of folders in a world."""
    from barn_eval.results import overlay  # noqa: PLC0415 (matplotlib)

    target = out or Path(f"trials_w{world:04d}.png")
    if target.suffix not in (".png", ".svg", ".pdf"):
        raise click.UsageError(f"--out {target}: must end in .png, .svg or .pdf")
    chosen = planners.split(",") if planners else ()
    overlay(folders, world, by=by, planners=chosen, outcome=outcome).save(target)
    say(target)


def show_world(world: str, dataset: str, out: Path | None, with_metrics: bool) -> None:
    """Draw a world and print what it is."""
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
        from barn_eval.world_sets import figure_of  # noqa: PLC0415 (compiled kernels)
        from barn_worlds.drawing.files import write_png  # noqa: PLC0415 (matplotlib)

        write_png(figure_of(found), target)
    rows = (
        ("grid", f"{found.rows} x {found.cols} cells of {found.resolution_m:g} m"),
        ("filled cells", str(int(found.grid.sum()))),
        ("path", f"{found.path_length_m:.2f} m from cell {found.start_cell} to {found.goal_cell}"),
        *([("moving obstacles", str(len(found.moving)))] if found.moving else []),
        ("source", found.provenance.source),
        ("checksum", found.checksum),
    )
    console.print(table((found.name, ""), rows))
    say(target)


@click.command()
@click.argument("source", default="barn300")
@worlds_option
@click.option(
    "--formula",
    default="corrected",
    show_default=True,
    help="corrected, published (the numbers in print) or paper_text.",
)
@click.option("--robot", help="Whose C-space and path are measured: a name or a YAML file [default: the worlds' own].")
@click.option("--csv", "csv_path", type=FILE, help="Write a line per world here.")
@click.option("--figure", type=FILE, help="Draw the metrics of one world here.")
@json_option
def metrics(
    source: str, spec: str, formula: str, robot: str | None, csv_path: Path | None, figure: Path | None, as_json: bool
) -> None:
    """Compute the five difficulty metrics of the worlds of SOURCE and their summary, as in the paper's Table II."""
    from barn_eval.world_sets import load_for, metrics_table  # noqa: PLC0415 (compiled kernels)
    from barn_metrics.formula import as_formula  # noqa: PLC0415

    chosen = as_formula(formula)
    opened = open_dataset(source)
    numbers = select_worlds(spec, opened.indices)
    if figure is not None and len(numbers) != 1:
        raise click.UsageError(f"--figure draws one world; --worlds chooses {len(numbers)}")
    result = metrics_table(opened, spec, formula, robot=robot or "")
    if csv_path is not None:
        result.to_csv(csv_path)
        say(csv_path)
    if figure is not None:
        from barn_metrics.world_figure import draw_world_figure  # noqa: PLC0415 (matplotlib)

        driven = load_robot(robot) if robot else None
        draw_world_figure(load_for(opened, numbers[0], driven), figure, chosen)
        say(figure)
    if as_json:
        click.echo(result.to_json(), nl=False)
        return
    headings, lines = result.summary_cells()
    columns = [headings[0], *(f">{heading}" for heading in headings[1:])]
    console.print(table(columns, lines, title=f"{len(numbers)} worlds, {formula}"))
