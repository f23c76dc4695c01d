"""`barn worlds move`."""

from pathlib import Path
from typing import Any

import click

from barn_eval import worlds
from barn_eval.commands.options import FILE, SEED, say, settings_option, worlds_option
from barn_worlds.moving.generate import class_named

CLASSES = "easy,medium,hard"


@click.command("move")
@click.argument("target", type=FILE)
@click.option("--class", "classes", default=CLASSES, show_default=True, help="Classes of motion, joined by commas.")
@click.option(
    "--per-class", default=20, show_default=True, type=click.IntRange(1, 10_000), help="Arenas of each class."
)
@click.option("--seed", default=0, show_default=True, type=SEED, help="Seed of all randomness.")
@settings_option("--set", "settings", "Parameter of the classes", class_named("easy"))
@click.option("--in", "source", help="Data set whose worlds get moving obstacles; without, arenas are made.")
@click.option("--crossing", is_flag=True, help="Obstacles go to and fro across the path, as people cross a corridor.")
@click.option("--obstacles", type=click.IntRange(1, 500), help="Obstacles of a world [default: drawn from the class].")
@worlds_option
def command(target: Path, classes: str, settings: dict[str, Any], spec: str, **options: Any) -> None:
    """Generate worlds in which obstacles move: TARGET.npz.

    Without --in they are arenas as in DynaBARN. With it, the worlds of a data set get moving obstacles of one class.
    """
    names = [name.strip() for name in classes.split(",")]
    made = worlds.generate_moving(target, names, parameters=settings, select=spec, **options)
    say(f"{len(made)} worlds in {target.with_suffix('.npz')}")
