"""`barn worlds`: generate, convert and list worlds."""

from pathlib import Path
from typing import Any

import click

from barn_eval.api import worlds
from barn_eval.api.worlds.sets import FORMATS, Form
from barn_eval.commands.options import (
    COUNT,
    PATH,
    json_option,
    parameters_option,
    print_notes,
    print_output,
    progress_bar,
    seed_option,
    worlds_option,
)
from barn_eval.commands.tables import table
from barn_worlds.datasets.dataset import open_dataset
from barn_worlds.datasets.generate import WorldParameters

robot_option = click.option(
    "--robot",
    default="jackal",
    help="Robot that paths are planned for: a name (see barn robots) or a YAML file.",
)


@click.group("worlds")
def command() -> None:
    """Generate, convert and list worlds."""


@command.command()
@click.argument("target", type=PATH)
@seed_option(2020)
@click.option("--per-set", default=25, type=COUNT, help="Worlds per parameter set.")
@parameters_option(
    "--set", "parameters", "One parameter set of your own", WorldParameters()
)
@robot_option
@click.option(
    "--keep",
    default=0,
    show_default=False,
    type=click.IntRange(0),
    help="Keep so many, evenly spread from wide to narrow [default: all].",
)
def generate(target: Path, **options: Any) -> None:
    """Generate a data set: TARGET.npz, or a folder in the original layout.

    Without --set the twelve parameter sets of the paper's Table I are used.
    """
    with progress_bar("worlds") as share:
        made = worlds.generate(
            target, **options, progress=lambda made, total: share(made / total)
        )
    print_notes(f"{len(made)} worlds in {target}")


@command.command()
@click.argument("source")
@click.argument("target", type=PATH)
@click.option(
    "--format",
    "form",
    type=click.Choice(FORMATS),
    help="What to write [default: npz for TARGET.npz, else original].",
)
@worlds_option
@robot_option
def convert(
    source: str, target: Path, form: Form | None, select: str, robot: str
) -> None:
    """Read worlds of any known format and write them for the suite or other programs.

    npz is a data set in one file, original the layout of the original data set. sdf (current Gazebo), sdf_classic
    (Gazebo Classic), map (map_server's pgm and yaml), yaml and png write a file per world into the folder TARGET.
    """
    written = worlds.load(source, select, robot=robot)
    target = worlds.save(
        written, target, form or ("npz" if target.suffix == ".npz" else "original")
    )
    print_notes(f"{len(written)} worlds in {target}")


@command.command("list")
@click.argument("source", required=False)
@worlds_option
@json_option
def show_list(source: str | None, select: str, as_json: bool) -> None:
    """List the data sets that come with the suite, or the worlds of SOURCE."""
    entries: list[dict[str, Any]]
    if source is None:
        opened = map(open_dataset, worlds.datasets())
        entries = [
            {
                "data set": one.name,
                "worlds": len(one.world_numbers),
                "checksum": one.checksum[:16],
            }
            for one in opened
        ]
    else:
        entries = [
            {
                "world": number,
                "name": one.name,
                "cells": f"{one.rows} x {one.cols}",
                "filled": int(one.grid.sum()),
            }
            | {
                "path [m]": one.path_length_m,
                "source": one.provenance.source,
                "checksum": one.checksum[:16],
            }
            for number, one in worlds.load(source, select).items()
        ]
    rows = [
        tuple(f"{one:.2f}" if isinstance(one, float) else one for one in entry.values())
        for entry in entries
    ]
    return print_output(as_json, entries, table(tuple(entries[0]), rows))
