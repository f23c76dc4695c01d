"""`barn worlds`: generate, convert and list worlds; `barn metrics`: measure them."""

from pathlib import Path
from typing import Any

import click

from barn_eval.api import worlds
from barn_eval.api.worlds import FORMATS, Form
from barn_eval.commands.options import (
    DATASET,
    ROBOT,
    count_option,
    json_option,
    parameters_option,
    path_argument,
    print_notes,
    print_output,
    progress_bar,
    robot_option,
    source_argument,
    worlds_option,
)
from barn_eval.commands.tables import decimals_text, table
from barn_worlds.datasets.dataset import open_dataset
from barn_worlds.datasets.generate import WorldParameters


@click.group("worlds")
def command() -> None:
    """Generate, convert, and list worlds."""


@command.command()
@path_argument("target")
@click.option(
    "--seed",
    default=2020,
    type=click.IntRange(0, 2**62),
    help="Seed of all random numbers.",
)
@count_option("--per-set", default=25, help="Worlds per parameter set.")
@parameters_option(
    "--set", "parameters", "Parameter of your own parameter set", WorldParameters()
)
@robot_option
@click.option(
    "--keep",
    default=0,
    show_default=False,
    type=click.IntRange(0),
    help="Number of worlds to keep, spread evenly from wide to narrow worlds [default: all].",
)
def generate(target: Path, **options: Any) -> None:
    """Generate a data set and write it to TARGET, an .npz file or a folder in the original layout.

    Without --set, the command uses the twelve parameter sets of the paper's Table I.
    """
    with progress_bar("worlds") as progress:
        generated = worlds.generate(
            target,
            **options,
            progress=lambda count, total: progress(count / total),
        )
    print_notes(f"{len(generated)} worlds in {target}")


@command.command()
@click.argument("source", type=DATASET)
@path_argument("target")
@click.option(
    "--format",
    "form",
    type=click.Choice(FORMATS),
    help="Format to write [default: npz for TARGET.npz, otherwise original].",
)
@worlds_option
@robot_option
def convert(
    source: str, target: Path, form: Form | None, select: str, robot: str
) -> None:
    """Convert worlds between formats of the suite and of other programs.

    The format npz is a data set in one file, and original is the layout of the original
    data set. The formats sdf (current Gazebo), sdf_classic (Gazebo Classic), map
    (map_server's pgm and yaml), yaml and png write one file per world to the folder
    TARGET.
    """
    if form is None:
        # The same rule as in `generate`.
        form = "npz" if target.suffix == ".npz" else "original"
    converted = worlds.load(source, select, robot=robot)
    path = worlds.save(converted, target, form)
    print_notes(f"{len(converted)} worlds in {path}")


@command.command("list")
@click.argument("source", type=DATASET, required=False)
@worlds_option
@json_option
def show_list(source: str | None, select: str, as_json: bool) -> None:
    """List the data sets that come with the suite, or the worlds of SOURCE."""
    # Keys are the headings of the table and the names in JSON.
    entries: list[dict[str, Any]] = []
    if source is None:
        for dataset in map(open_dataset, worlds.datasets()):
            entries.append(
                {
                    "data set": dataset.name,
                    "worlds": len(dataset.world_numbers),
                    "checksum": dataset.checksum[:16],
                }
            )
    else:
        for number, world in worlds.load(source, select).items():
            entries.append(
                {
                    "world": number,
                    "name": world.name,
                    "cells": f"{world.rows} x {world.cols}",
                    "filled": int(world.grid.sum()),
                    "path [m]": world.path_length_m,
                    "source": world.provenance.source,
                    "checksum": world.checksum[:16],
                }
            )
    rows = [list(map(decimals_text, entry.values())) for entry in entries]
    print_output(as_json, entries, table(list(entries[0]), rows))


@click.command("metrics")
@source_argument
@worlds_option
@click.option(
    "--formula",
    default="corrected",
    help="Formulas: corrected, published (which reproduce the printed numbers) or"
    " paper_text (as the paper's text states them).",
)
@click.option(
    "--robot",
    type=ROBOT,
    help="Robot whose C-space and path are measured: a name or a YAML file [default: the worlds' robot].",
)
@json_option
def metrics(
    source: str, select: str, formula: str, robot: str | None, as_json: bool
) -> None:
    """Compute the five difficulty metrics of the worlds of SOURCE and their summary.

    The summary has the form of the paper's Table II. The metrics order worlds better
    than `barn difficulty predict` does under protocol challenge, but worse under
    paper2020.
    """
    content = worlds.metrics_table(source, select, formula, robot=robot or "")
    headings, rows = content.summary_cells()
    # All columns but the first are numbers.
    columns = [headings[0], *(f">{heading}" for heading in headings[1:])]
    title = f"{len(content.worlds)} worlds, {formula}"
    print_output(as_json, content.as_json(), table(columns, rows, title=title))
