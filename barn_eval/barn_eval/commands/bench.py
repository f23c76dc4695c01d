"""`barn bench`: how fast the suite is on this machine."""

from dataclasses import asdict
from importlib.util import find_spec

import click

from barn_eval.commands.options import console, json_option, print_json, say, table
from barn_eval.experiments.provenance import provenance


@click.command()
@click.option("--dataset", default="barn300", show_default=True, help="Data set that worlds are from.")
@click.option("--world", type=click.IntRange(0), help="World of the trials [default: the middle one].")
@click.option("--planners", default="dwa,eband", show_default=True, help="Planners to measure, joined by commas.")
@click.option(
    "--repeats", default=3, show_default=True, type=click.IntRange(1, 100), help="The best of so many counts."
)
@click.option("--ros/--no-ros", default=None, help="Measure a trial over ROS [default: if rclpy is installed].")
@json_option
def bench(dataset: str, world: int | None, planners: str, repeats: int, ros: bool | None, as_json: bool) -> None:
    """Measure the speed of the suite on this machine, as ratios that can be followed over time."""
    from barn_eval.studies import bench as measuring  # noqa: PLC0415 (loads all that it measures)
    from barn_planners.registry import planner_config  # noqa: PLC0415

    names = [name.strip() for name in planners.split(",")]
    for name in names:
        planner_config(name)
    figures = []
    over_ros = find_spec("rclpy") is not None if ros is None else ros
    for figure in measuring.bench(dataset, world, names, repeats, ros=over_ros):
        say(f"{figure.name}: {figure.value:.3g} {figure.unit}")
        figures.append(figure)
    about = provenance()
    if as_json:
        print_json({"schema_version": 1, "figures": [asdict(figure) for figure in figures], **about})
        return
    machine = about["machine"]
    rows = [(figure.name, f"{figure.value:.3g}", figure.unit) for figure in figures]
    console.print(table(("figure", ">value", "unit"), rows, title=f"{machine['processor']}, {machine['cores']} cores"))
