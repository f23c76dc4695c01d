"""`barn worlds sample`: worlds of a wanted difficulty, drawn from a data set or generated."""

from __future__ import annotations

import re
from pathlib import Path

import click

from barn_eval.commands.options import notes
from barn_worlds.errors import ConfigError

_RANGE = re.compile(r"([^:]*):([^:]*)")


@click.command()
@click.argument("target", type=click.Path(path_type=Path, dir_okay=False))
@click.option(
    "--difficulty",
    "wanted",
    required=True,
    metavar="LOW:HIGH",
    help="Predicted time per metre [s/m]; one of them may be left out.",
)
@click.option("--from", "source", help="Data set to draw from; without, worlds are generated.")
@click.option("--count", default=10, show_default=True, type=click.IntRange(1, 100_000), help="Number of worlds.")
@click.option("--seed", default=0, show_default=True, type=click.IntRange(0, 2**62), help="Seed of the draw.")
@click.option(
    "--weights", type=click.Path(path_type=Path, dir_okay=False), help="Difficulty model [default: the shipped one]."
)
def sample(target: Path, wanted: str, source: str | None, count: int, seed: int, weights: Path | None) -> None:
    """Write COUNT worlds of a wanted difficulty to TARGET.npz, numbered from the easiest.

    Difficulty is the time per metre that the model predicts for a world.
    """
    from barn_eval.world_sets import sample_worlds  # noqa: PLC0415 (worlds and their kernels)

    low, high = parse_range(wanted)
    target = target.with_suffix(".npz")
    sample_worlds(target, low, high, source=source, count=count, seed=seed, weights=weights)
    notes.print(f"{count} worlds in {target}", markup=False, soft_wrap=True)


def parse_range(text: str) -> tuple[float, float]:
    """Return the limits of LOW:HIGH, infinite where one is left out; ConfigError for anything else."""
    match = _RANGE.fullmatch(text)
    try:
        if match is None:
            raise ValueError
        low, high = (float(part) if part.strip() else None for part in match.groups())
    except ValueError:
        raise ConfigError(f"--difficulty must be LOW:HIGH, got {text!r}") from None
    return (-float("inf") if low is None else low), (float("inf") if high is None else high)
