"""Train the difficulty model on trials and write its weights; needs `make extras`.

    python qa/studies/difficulty/train_difficulty.py out/more1 out/more2 --out mine.npz

`barn difficulty predict --weights mine.npz` uses them.
"""

from collections.abc import Sequence
from pathlib import Path

import click
from network_training import train_model
from trial_sources import load_trials

from barn_metrics.model import save_model
from barn_worlds.base.errors import BarnError


@click.command()
@click.argument("sources", nargs=-1, required=True, type=click.Path(path_type=Path))
@click.option(
    "--out", required=True, type=click.Path(path_type=Path), help="Weights, .npz."
)
@click.option("--planner", default="", help="Learn the times of this planner alone.")
@click.option("--dataset", default="", help="Data set, if not the one of the results.")
@click.option("--seed", default=0, show_default=True, help="Seed of all randomness.")
def main(
    sources: Sequence[Path], out: Path, planner: str, dataset: str, seed: int
) -> None:
    """Train on the trials of SOURCES, results folders."""
    try:
        worlds, trials = load_trials(sources, planner, dataset)
        save_model(train_model(worlds, trials, seed), out)
    except BarnError as error:
        raise click.ClickException(str(error)) from None
    click.echo(out)


if __name__ == "__main__":
    main()
