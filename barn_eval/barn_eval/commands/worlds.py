"""`barn worlds`: generate, import, export, show and list worlds."""

from pathlib import Path
from typing import Any

import click

from barn_eval import world_sets
from barn_eval.commands.motion import motion, move
from barn_eval.commands.options import (
    FILE,
    PATH,
    SEED,
    console,
    json_option,
    parse_settings,
    print_json,
    progress,
    say,
    worlds_option,
)
from barn_eval.commands.tables import table
from barn_worlds.base.errors import ConfigError
from barn_worlds.worlds.dataset import open_dataset
from barn_worlds.worlds.world import World

robot_option = click.option(
    "--robot",
    default="jackal",
    show_default=True,
    help="Robot that paths are planned for: a name (see barn robots list) or a YAML file.",
)


@click.group()
def worlds() -> None:
    """Generate, sample, move, import, export, order, show and list worlds."""


@worlds.command()
@click.argument("target", type=PATH)
@click.option("--seed", default=2020, show_default=True, type=SEED, help="Seed of the data set.")
@click.option("--per-set", default=25, show_default=True, type=click.IntRange(1), help="Worlds per parameter set.")
@click.option(
    "--set", "settings", multiple=True, metavar="KEY=VALUE", help="One parameter set of your own; may be repeated."
)
@robot_option
@click.option(
    "--keep", default=0, type=click.IntRange(0), help="Keep so many, evenly spread from wide to narrow [default: all]."
)
def generate(target: Path, seed: int, per_set: int, settings: tuple[str, ...], robot: str, keep: int) -> None:
    """Generate a data set: TARGET.npz, or a folder in the original layout.

    Without --set the twelve parameter sets of the paper's Table I are used.
    """
    changes = parse_settings(settings, "--set")
    with progress("worlds") as (_, share):
        made = world_sets.generate_worlds(
            target,
            per_set=per_set,
            seed=seed,
            parameters=changes,
            robot=robot,
            keep=keep,
            progress=lambda made, total: share(made / total),
        )
    say(f"{len(made)} worlds in {target}")


@worlds.command()
@click.argument("target", type=FILE)
@click.option(
    "--difficulty",
    "wanted",
    required=True,
    metavar="LOW:HIGH",
    help="Predicted time per metre [s/m]; one of them may be left out.",
)
@click.option("--from", "source", help="Data set to draw from; without, worlds are generated.")
@click.option("--count", default=10, show_default=True, type=click.IntRange(1, 100_000), help="Number of worlds.")
@click.option("--seed", default=0, show_default=True, type=SEED, help="Seed of the draw.")
@click.option("--weights", type=FILE, help="Difficulty model [default: the shipped one].")
def sample(target: Path, wanted: str, source: str | None, count: int, seed: int, weights: Path | None) -> None:
    """Write COUNT worlds of a wanted difficulty to TARGET.npz, numbered from the easiest.

    Difficulty is the time per metre that the model predicts for a world.
    """
    from barn_eval.world_sets import sample_worlds  # noqa: PLC0415 (worlds and their kernels)

    low, high = parse_range(wanted)
    target = target.with_suffix(".npz")
    sample_worlds(target, low, high, source=source, count=count, seed=seed, weights=weights)
    say(f"{count} worlds in {target}")


def parse_range(text: str) -> tuple[float, float]:
    """Return the limits of LOW:HIGH, infinite where one is left out; ConfigError for anything else."""
    low, colon, high = map(str.strip, text.partition(":"))
    try:
        if not colon:
            raise ValueError
        return float(low or "-inf"), float(high or "inf")
    except ValueError:
        raise ConfigError(f"--difficulty must be LOW:HIGH, got {text!r}") from None


@worlds.command("import")
@click.argument("source")
@click.argument("target", type=PATH)
@worlds_option
@robot_option
@click.option("--resize", is_flag=True, help="Make the cells of the grids as large as `generate` does for the robot.")
def import_worlds(source: str, target: Path, spec: str, robot: str, *, resize: bool) -> None:
    """Read worlds of any known format and write them as a data set: TARGET.npz, or an original layout folder."""
    world_sets.require_new(target)
    chosen = world_sets.worlds(source, spec, robot=robot)
    if resize:
        chosen = world_sets.resize_worlds(chosen, robot)
    world_sets.save_worlds(chosen, target, "npz" if target.suffix == ".npz" else "original")
    say(f"{len(chosen)} worlds in {target}")


@worlds.command()
@click.argument("source")
@click.argument("target", type=PATH)
@click.option(
    "--format", "form", type=click.Choice(world_sets.FORMATS), default="sdf", show_default=True, help="What to write."
)
@click.option("--movable", is_flag=True, help="Obstacles of Gazebo worlds can be pushed, as in the paper's trials.")
@worlds_option
def export(source: str, target: Path, form: str, movable: bool, spec: str) -> None:
    """Write worlds for other programs.

    sdf (current Gazebo), sdf_classic (Gazebo Classic), map (map_server's pgm and yaml), yaml, tracks (CSV of moving
    obstacles) and png write a file per world into the folder TARGET; original writes the layout of the original data
    set; npz a single file.
    """
    if movable and not form.startswith("sdf"):
        raise ConfigError(f"--movable is for Gazebo worlds, not for {form}")
    world_sets.require_new(target)
    chosen = world_sets.worlds(source, spec)
    world_sets.save_worlds(chosen, target, form, movable=movable)
    say(f"{len(chosen)} worlds in {target}")


@worlds.command()
@click.argument("source")
@click.argument("target", type=FILE)
@worlds_option
def show(source: str, target: Path, spec: str) -> None:
    """Draw the worlds of a data set on one sheet, TARGET.png.

    Moving obstacles are drawn at time 0, with their tracks and arrows along them. TARGET.gif is an animation of one
    world in which obstacles move.
    """
    world_sets.draw_to_file(world_sets.worlds(source, spec), target)
    say(target)


@worlds.command()
@click.argument("source")
@click.argument("target", type=FILE)
@click.option(
    "--scores",
    required=True,
    type=FILE,
    help="CSV file with a column `world`; rows of one world are averaged. A campaign's results.csv is one.",
)
@click.option("--by", required=True, metavar="COLUMN", help="Column of the scores; the lowest score comes first.")
def order(source: str, target: Path, scores: Path, by: str) -> None:
    """Write the worlds of SOURCE to TARGET.npz, numbered by rising difficulty, measured or predicted."""
    target = target.with_suffix(".npz")
    numbered = world_sets.order_worlds(source, target, scores, by)
    say(f"{len(numbered)} worlds in {target}")


@worlds.command("list")
@click.argument("source", required=False)
@worlds_option
@json_option
def list_worlds(source: str | None, spec: str, as_json: bool) -> None:
    """List the data sets that come with the suite, or the worlds of SOURCE."""
    entries = _datasets() if source is None else [_entry(*one) for one in world_sets.worlds(source, spec).items()]
    if as_json:
        print_json(entries)
        return
    rows = [[f"{one:.2f}" if isinstance(one, float) else str(one) for one in entry.values()] for entry in entries]
    console.print(table(list(entries[0]) if entries else ["nothing there"], rows))


worlds.add_command(move)
worlds.add_command(motion)


def _datasets() -> list[dict[str, Any]]:
    opened = [open_dataset(name) for name in world_sets.datasets()]
    return [{"data set": one.name, "worlds": len(one.indices), "checksum": one.checksum[:16]} for one in opened]


def _entry(index: int, world: World) -> dict[str, Any]:
    return {
        "world": index,
        "name": world.name,
        "cells": f"{world.rows} x {world.cols}",
        "filled": int(world.grid.sum()),
        "path [m]": world.path_length_m,
        "source": world.provenance.source,
        "checksum": world.checksum[:16],
    }
