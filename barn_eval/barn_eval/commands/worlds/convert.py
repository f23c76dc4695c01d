"""`barn worlds convert`."""

from pathlib import Path

import click

from barn_eval import worlds as world_sets
from barn_eval.commands.options import PATH, say, worlds_option
from barn_eval.commands.worlds import robot_option
from barn_eval.worlds.sets import FORMATS, Form, require_new
from barn_worlds.base.errors import ConfigError


@click.command("convert")
@click.argument("source")
@click.argument("target", type=PATH)
@click.option(
    "--format",
    "form",
    type=click.Choice(FORMATS),
    help="What to write [default: npz for TARGET.npz, else original].",
)
@click.option("--movable", is_flag=True, help="Obstacles of Gazebo worlds can be pushed, as in the paper's trials.")
@worlds_option
@robot_option
@click.option("--resize", is_flag=True, help="Make the cells of the grids as large as `generate` does for the robot.")
@click.option(
    "--order",
    metavar="FILE:COLUMN",
    help="Number the worlds by rising score, of a CSV file with a column `world`; rows of one world are averaged. An"
    " experiment's results.csv is one.",
)
def command(
    source: str, target: Path, form: Form | None, movable: bool, spec: str, robot: str, resize: bool, order: str | None
) -> None:
    """Read worlds of any known format and write them for the suite or other programs, or in another order.

    npz is a data set in one file, original the layout of the original data set. sdf (current Gazebo), sdf_classic
    (Gazebo Classic), map (map_server's pgm and yaml), yaml, tracks (CSV of moving obstacles) and png write a file per
    world into the folder TARGET.
    """
    form = form or ("npz" if target.suffix == ".npz" or order else "original")
    if movable and not form.startswith("sdf"):
        raise ConfigError(f"--movable is for Gazebo worlds, not for {form}")
    if order is not None:
        if form != "npz" or spec != "all" or resize:
            raise ConfigError("--order is for whole data sets, written as npz")
        scores, colon, column = order.rpartition(":")
        if not colon:
            raise ConfigError(f"--order {order}: must be FILE:COLUMN")
        target = target.with_suffix(".npz")
        written = world_sets.order(source, target, scores, column)
    else:
        require_new(target)
        written = world_sets.load(source, spec, robot=robot)
        if resize:
            written = world_sets.resize(written, robot)
        world_sets.save(written, target, form, movable=movable)
    say(f"{len(written)} worlds in {target}")
