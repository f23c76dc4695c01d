"""Judge what the difficulty model learns from trials, in worlds held out, beside ridge regression on the five metrics.

    python qa/studies/judge_difficulty.py out/paper --repeats 2

Sources are folders of experiments or tables of published times, .csv. Networks are trained on folds of the worlds. It
needs PyTorch: make extras.
"""

from collections.abc import Mapping, Sequence
from pathlib import Path

import click
from rich.console import Console
from rich.table import Table

from barn_eval.api.difficulty import joined_trials
from barn_metrics.model.evaluation import (
    EvaluationConfig,
    ModelScore,
    on_folds,
    ridge_score,
    score_of,
)
from barn_metrics.model.inputs import inputs_of
from barn_metrics.model.training import TITLE, train_models
from barn_metrics.model.trials import (
    RESERVED_DATASET,
    Trials,
    find_reserved_world,
    worlds_with_trials,
)
from barn_worlds.base.arrays import Bools, Floats
from barn_worlds.base.errors import BarnError, ModelError
from barn_worlds.worlds.world import World

ROUTES = "routes"


def judged(
    worlds: Mapping[int, World], trials: Trials, config: EvaluationConfig
) -> tuple[ModelScore, ModelScore]:
    """Return the errors of ridge regression and of networks, on the same folds; ModelError for too few worlds."""
    own, known = worlds_with_trials(worlds, trials), trials.only(trials.world_numbers)
    if (apart := find_reserved_world(own)) is not None:
        raise ModelError(
            f"{apart.name} is a world of {RESERVED_DATASET}, which is never trained on; it judges weights"
        )
    inputs, difficulty = inputs_of(own), known.difficulty()

    def fitted(kept: Bools, seed: int) -> list[Floats]:
        return [
            model.difficulty(inputs)[0]
            for model in train_models(inputs, known, kept, seed)
        ]

    ridge = ridge_score(inputs, known, config)
    predicted, training_mse = on_folds(fitted, difficulty, config)
    return ridge, score_of(ROUTES, TITLE, training_mse, predicted, difficulty, ridge)


@click.command()
@click.argument("sources", nargs=-1, required=True, type=click.Path(path_type=Path))
@click.option(
    "--planner",
    default="",
    help="Learn the times of this one alone, not the mean of all.",
)
@click.option(
    "--dataset", default="", help="Where the worlds are, if not where the results say."
)
@click.option("--seed", default=0, show_default=True)
@click.option("--folds", default=10, show_default=True)
@click.option("--repeats", default=5, show_default=True)
def main(
    sources: Sequence[Path],
    planner: str,
    dataset: str,
    seed: int,
    folds: int,
    repeats: int,
) -> None:
    """Train on folds, and judge."""
    try:
        worlds, trials = joined_trials(sources, planner, dataset)
        scores = judged(worlds, trials, EvaluationConfig(folds, repeats, seed))
    except BarnError as error:
        raise click.ClickException(str(error)) from None
    table = Table(
        "model",
        "training error",
        "held-out error",
        "R2",
        "Spearman",
        "better than ridge by",
    )
    for one in scores:
        held_out_figures = (
            "" if it is None else it.text()
            for it in (one.mse, one.r2, one.spearman, one.gain)
        )
        table.add_row(one.name, f"{one.training_mse:.3f}", *held_out_figures)
    Console(width=140).print(table)


if __name__ == "__main__":
    main()
