"""`barn worlds move` and `barn worlds motion`: worlds in which obstacles move, and figures of their motion."""

from dataclasses import asdict
from pathlib import Path

import click

from barn_eval import moving_sets
from barn_eval.commands.options import FILE, SEED, console, json_option, parse_settings, print_json, say, worlds_option
from barn_eval.commands.tables import table

_CLASSES = "easy,medium,hard"
_HEADINGS = ("class", "n", "obstacles", "m/s", "from", "to", "period [s]", "crossings /min", "occupied")


@click.command()
@click.argument("target", type=FILE)
@click.option("--class", "classes", default=_CLASSES, show_default=True, help="Classes of motion, joined by commas.")
@click.option(
    "--per-class", default=20, show_default=True, type=click.IntRange(1, 10_000), help="Arenas of each class."
)
@click.option("--seed", default=0, show_default=True, type=SEED, help="Seed of all randomness.")
@click.option(
    "--set", "settings", multiple=True, metavar="KEY=VALUE", help="Parameter of the classes; may be repeated."
)
@click.option("--in", "source", help="Data set whose worlds get moving obstacles; without, arenas are made.")
@click.option("--crossing", is_flag=True, help="Obstacles go to and fro across the path, as people cross a corridor.")
@click.option("--obstacles", type=click.IntRange(1, 500), help="Obstacles of a world [default: drawn from the class].")
@worlds_option
def move(
    target: Path,
    classes: str,
    per_class: int,
    seed: int,
    settings: tuple[str, ...],
    source: str | None,
    crossing: bool,
    obstacles: int | None,
    spec: str,
) -> None:
    """Generate worlds in which obstacles move: TARGET.npz.

    Without --in they are arenas as in DynaBARN. With it, the worlds of a data set get moving obstacles of one class.
    """
    names = [name.strip() for name in classes.split(",")]
    changes = parse_settings(settings, "--set")
    made = moving_sets.generate_moving(
        target,
        names,
        per_class=per_class,
        seed=seed,
        parameters=changes,
        source=source,
        select=spec,
        crossing=crossing,
        obstacles=obstacles,
    )
    say(f"{len(made)} worlds in {target.with_suffix('.npz')}")


@click.command()
@click.argument("source")
@worlds_option
@json_option
def motion(source: str, spec: str, *, as_json: bool) -> None:
    """Say how obstacles move in the worlds of SOURCE, by class: means over the worlds, first 100 s.

    Crossings are of the straight line from start to goal by the centres of obstacles; occupied is the share of that
    line that obstacles cover.
    """
    found = moving_sets.motion_table(source, spec)
    if as_json:
        print_json([{"class": name, "worlds": count, **asdict(figures)} for name, count, figures in found])
        return
    rows = [
        [
            name,
            str(count),
            f"{one.obstacles:.1f}",
            f"{one.mean_speed_mps:.2f}",
            f"{one.slowest_mps:.2f}",
            f"{one.fastest_mps:.2f}",
            f"{one.period_s:.1f}",
            f"{one.crossings_per_min:.1f}",
            f"{one.occupied_share:.3f}",
        ]
        for name, count, one in found
    ]
    console.print(table(_HEADINGS, rows))
