"""`barn worlds generate`."""

from pathlib import Path
from typing import Any

import click

from barn_eval import worlds as world_sets
from barn_eval.commands.options import COUNT, PATH, SEED, progress, say, settings_option
from barn_eval.commands.worlds import robot_option
from barn_worlds.worlds.parameters import WorldParameters


@click.command("generate")
@click.argument("target", type=PATH)
@click.option("--seed", default=2020, show_default=True, type=SEED, help="Seed of the data set.")
@click.option("--per-set", default=25, show_default=True, type=COUNT, help="Worlds per parameter set.")
@settings_option("--set", "settings", "One parameter set of your own", WorldParameters())
@robot_option
@click.option(
    "--keep", default=0, type=click.IntRange(0), help="Keep so many, evenly spread from wide to narrow [default: all]."
)
def command(target: Path, seed: int, per_set: int, settings: dict[str, Any], robot: str, keep: int) -> None:
    """Generate a data set: TARGET.npz, or a folder in the original layout.

    Without --set the twelve parameter sets of the paper's Table I are used.
    """
    with progress("worlds") as share:
        made = world_sets.generate(
            target,
            per_set=per_set,
            seed=seed,
            parameters=settings,
            robot=robot,
            keep=keep,
            progress=lambda made, total: share(made / total),
        )
    say(f"{len(made)} worlds in {target}")
