"""Judge the difficulty model by trials, beside ridge regression on the five metrics.

    python qa/studies/difficulty/judge_difficulty.py weights out/paper
    python qa/studies/difficulty/judge_difficulty.py networks out/paper --repeats 2

`weights` judges a file of weights, the shipped ones by default, in worlds that it was
not trained in. `networks` trains networks on folds of the worlds and judges each in the
worlds left out; that needs PyTorch (`make extras`). Errors are in (s/m)^2, intervals 95
% over worlds.
"""

import json
from collections.abc import Mapping, Sequence
from pathlib import Path

import click
from evaluation import (
    EvaluationConfig,
    ModelScore,
    cross_validate,
    evaluate,
    score_predictions,
    score_ridge,
)
from rich.console import Console
from rich.table import Table
from trial_sources import Trials, load_trials, worlds_with_trials

from barn_metrics.model import load_model
from barn_metrics.model.inputs import inputs_of
from barn_worlds.base.arrays import Bools, Floats
from barn_worlds.base.config import as_dict
from barn_worlds.base.errors import BarnError
from barn_worlds.base.files import make_json_safe
from barn_worlds.worlds.world import World

NETWORKS = "routes"

_sources = click.argument(
    "sources", nargs=-1, required=True, type=click.Path(path_type=Path)
)
_planner = click.option("--planner", default="", help="Trials of this planner alone.")
_dataset = click.option(
    "--dataset", default="", help="Data set, if not the one of the results."
)
_seed = click.option("--seed", default=0, show_default=True)
_folds = click.option("--folds", default=10, show_default=True)
_repeats = click.option("--repeats", default=5, show_default=True)


def judge_networks(
    worlds: Mapping[int, World], trials: Trials, config: EvaluationConfig
) -> tuple[ModelScore, ModelScore]:
    """Judge ridge regression and networks on the same folds.

    Args:
        worlds: Worlds by number.
        trials: Trials in these worlds.
        config: Folds, repeats and seed.

    Returns:
        Scores of ridge regression and of the networks.

    Raises:
        ModelError: If there are too few worlds, or one is reserved for judging weights.
    """
    # PyTorch is optional, and judging weights does without it.
    from network_training import TITLE, require_trainable, train_models  # noqa: PLC0415

    trial_worlds = worlds_with_trials(worlds, trials)
    require_trainable(trial_worlds)
    trials = trials.in_worlds(trials.world_numbers)
    inputs = inputs_of(trial_worlds)

    def predict(training_masks: Bools, seed: int) -> list[Floats]:
        models = train_models(inputs, trials, training_masks, seed)
        return [model.evaluate(inputs)[1] for model in models]

    ridge_score = score_ridge(inputs, trials, config)
    difficulty = trials.difficulty()
    predicted, training_mse = cross_validate(predict, difficulty, config)
    network_score = score_predictions(
        NETWORKS, TITLE, training_mse, predicted, difficulty, ridge_score
    )
    return ridge_score, network_score


def score_table(scores: Sequence[ModelScore]) -> Table:
    """Return a table with a row per kind of model."""
    table = Table(
        "model",
        "training error",
        "held-out error",
        "R2",
        "Spearman",
        "better than ridge by",
        "within 1 std [%]",
    )
    for score in scores:
        within_std = score.within_std
        table.add_row(
            score.name,
            f"{score.training_mse:.3f}",
            score.mse.text(),
            score.r2.text(),
            score.spearman.text(),
            score.gain.text() if score.gain else "",
            "" if within_std is None else f"{100.0 * within_std:.0f}",
        )
    return table


@click.group()
def main() -> None:
    """Judge the difficulty model by trials."""


@main.command()
@_sources
@click.option("--weights", type=click.Path(path_type=Path), help="[default: shipped]")
@_planner
@_dataset
@_seed
@_folds
@_repeats
@click.option("--json", "as_json", is_flag=True, help="Print everything as JSON.")
def weights(
    sources: Sequence[Path],
    weights: Path | None,
    planner: str,
    dataset: str,
    seed: int,
    folds: int,
    repeats: int,
    as_json: bool,
) -> None:
    """Judge weights by the trials of SOURCES, results folders."""
    try:
        worlds, trials = load_trials(sources, planner, dataset)
        config = EvaluationConfig(folds, repeats, seed)
        evaluation = evaluate(worlds, trials, load_model(weights), config)
    except BarnError as error:
        raise click.ClickException(str(error)) from None

    if as_json:
        click.echo(json.dumps(make_json_safe(as_dict(evaluation)), indent=2))
        return
    click.echo(f"{evaluation.worlds} worlds, {evaluation.trials} trials")
    Console(width=140).print(score_table(evaluation.scores))
    if evaluation.ceiling is not None:
        click.echo(f"highest R2 that these trials allow: {evaluation.ceiling.text()}")


@main.command()
@_sources
@_planner
@_dataset
@_seed
@_folds
@_repeats
def networks(
    sources: Sequence[Path],
    planner: str,
    dataset: str,
    seed: int,
    folds: int,
    repeats: int,
) -> None:
    """Judge networks trained on folds of the worlds of SOURCES, results folders."""
    try:
        worlds, trials = load_trials(sources, planner, dataset)
        scores = judge_networks(worlds, trials, EvaluationConfig(folds, repeats, seed))
    except BarnError as error:
        raise click.ClickException(str(error)) from None
    Console(width=140).print(score_table(scores))


if __name__ == "__main__":
    main()
