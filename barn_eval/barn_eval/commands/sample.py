"""`barn worlds sample`: worlds of a wanted difficulty, drawn from a data set or generated."""

from __future__ import annotations

from collections.abc import Callable, Iterator, Sequence
from pathlib import Path
from typing import TYPE_CHECKING, Any

import click

from barn_eval.commands.options import FILE, SEED, say
from barn_eval.world_sets import require_new
from barn_worlds.errors import ConfigError

if TYPE_CHECKING:
    import numpy as np

    from barn_worlds.formats.own import Order
    from barn_worlds.world import World


@click.command()
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
    import numpy as np  # noqa: PLC0415

    from barn_metrics.model import load_model  # noqa: PLC0415
    from barn_worlds.formats.own import Order  # noqa: PLC0415

    limits = parse_range(wanted)
    target = target.with_suffix(".npz")
    require_new(target)
    model = load_model(weights)

    def difficulty(world: World) -> float:
        return float(model.predict(world).difficulty_s_per_m)

    chosen = list(_chosen(difficulty, limits, source, count, np.random.default_rng(seed)))
    order = Order("predicted time per metre, s/m", tuple(value for _, value in chosen))
    write_ordered(target, [world for world, _ in chosen], order, {"seed": seed, "source": source or "generated"})


def write_ordered(target: Path, worlds: Sequence[World], order: Order, about: dict[str, Any]) -> None:
    """Write a data set whose worlds are numbered by rising score; its manifest has the order after `about`."""
    from barn_worlds.formats.own import write_own  # noqa: PLC0415
    from barn_worlds.generate import reordered  # noqa: PLC0415 (compiled kernels)

    described = {"by": order.by, "scores": sorted(order.scores)}
    write_own(target, target.stem, reordered(worlds, order), about | {"order": described})
    say(f"{len(worlds)} worlds in {target}")


def parse_range(text: str) -> tuple[float, float]:
    """Return the limits of LOW:HIGH, infinite where one is left out; ConfigError for anything else."""
    low, colon, high = map(str.strip, text.partition(":"))
    try:
        if not colon:
            raise ValueError
        return float(low or "-inf"), float(high or "inf")
    except ValueError:
        raise ConfigError(f"--difficulty must be LOW:HIGH, got {text!r}") from None


def _chosen(
    difficulty: Callable[[World], float],
    limits: tuple[float, float],
    source: str | None,
    count: int,
    generator: np.random.Generator,
) -> Iterator[tuple[World, float]]:
    from barn_eval.learning.curriculum import draw_worlds_of, generate_world_of  # noqa: PLC0415
    from barn_worlds.dataset import open_dataset  # noqa: PLC0415

    if source is None:
        for _ in range(count):
            yield generate_world_of(difficulty, limits, generator)
        return
    dataset = open_dataset(source)
    drawn = draw_worlds_of(dataset, difficulty, limits, count, generator)
    yield from ((dataset.load(index), value) for index, value in drawn.items())
