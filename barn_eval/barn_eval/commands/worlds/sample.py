"""`barn worlds sample`."""

from pathlib import Path

import click

from barn_eval import worlds as world_sets
from barn_eval.commands.options import FILE, SEED, say
from barn_worlds.base.errors import ConfigError


@click.command("sample")
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
def command(target: Path, wanted: str, source: str | None, count: int, seed: int, weights: Path | None) -> None:
    """Write COUNT worlds of a wanted difficulty to TARGET.npz, numbered from the easiest.

    Difficulty is the time per metre that the model predicts for a world.
    """
    low, high = parse_range(wanted)
    target = target.with_suffix(".npz")
    world_sets.sample(target, low, high, source=source, count=count, seed=seed, weights=weights)
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
