"""Train the difficulty model on trials and write its weights, or judge what is trained in worlds held out.

    python qa/train_difficulty.py out/more1 out/more2 out/more3 --out difficulty.npz
    python qa/train_difficulty.py out/paper --repeats 2

Sources are folders of experiments or tables of published times, .csv. Without --out, networks trained on folds of the
worlds are judged beside ridge regression on the five metrics. It needs PyTorch: make extras.
"""

import hashlib
import math
from collections.abc import Mapping, Sequence
from pathlib import Path

import click
import numpy as np
from difficulty_network import train_network
from rich.console import Console
from rich.table import Table

from barn_eval.difficulty import read_trials
from barn_metrics.model import DifficultyModel, save_model
from barn_metrics.model.evaluation import EvaluationConfig, ModelScore, on_folds, ridge_score, score_of
from barn_metrics.model.inputs import inputs_of
from barn_metrics.model.trials import HELD_OUT, Mask, Trials, check_worlds, fold_masks, held_out, trained_worlds
from barn_worlds.base.arrays import Floats
from barn_worlds.base.errors import BarnError, ModelError
from barn_worlds.worlds.world import World

TITLE = "networks convolved along the clearance beside three routes, and all inputs"
ROUTES = "routes"
_NETWORKS = 3
_CALIBRATION_FOLDS, _CALIBRATION_WORLDS = 5, 300


def joined(parts: Sequence[tuple[Mapping[int, World], Trials]]) -> tuple[dict[int, World], Trials]:
    """Return worlds and trials of several campaigns, renumbered, equal worlds as one; ModelError for missing ones."""
    numbers: dict[str, int] = {}
    worlds: dict[int, World] = {}
    renumbered = []
    for mine, trials in parts:
        check_worlds(mine, trials.worlds.tolist())
        new = {number: numbers.setdefault(world.checksum, len(numbers)) for number, world in mine.items()}
        worlds |= {new[number]: world for number, world in mine.items()}
        renumbered.append(np.array([new[int(number)] for number in trials.worlds], np.int64))
    return worlds, Trials(
        np.concatenate(renumbered),
        tuple(planner for _, one in parts for planner in one.planners),
        np.concatenate([one.normalised_s_per_m for _, one in parts]),
        np.concatenate([one.succeeded for _, one in parts]),
    )


def train(worlds: Mapping[int, World], trials: Trials, seed: int = 0) -> DifficultyModel:
    """Return a model trained on all worlds that every planner of the trials was tried in.

    The same arguments give the same model. Its uncertainty comes from further models, each trained without a fifth of
    the worlds: five, or as few as leave enough worlds out.
    Raises ModelError for too few worlds, or for worlds of `HELD_OUT`.
    """
    used = trained_worlds(worlds, trials)
    if (found := held_out(used)) is not None:
        raise ModelError(f"{found.name} is a world of {HELD_OUT}, which judges models and is never trained on")
    inputs, difficulty = inputs_of(used), trials.difficulty()
    enough = math.ceil(_CALIBRATION_WORLDS * _CALIBRATION_FOLDS / len(used))
    folds = fold_masks(len(used), _CALIBRATION_FOLDS, seed)[:enough]
    kept = np.concatenate([np.ones((1, len(used)), np.bool_), folds])
    whole, *others = train_models(inputs, trials, kept, seed)
    about = {
        "title": TITLE,
        "seed": seed,
        "planners": list(trials.planner_names),
        "training_worlds": len(used),
        "training_trials": len(trials.only(trials.world_numbers)),
        # Of the worlds' own checksums, whatever the order of the worlds.
        "worlds_sha256": hashlib.sha256("\n".join(sorted(world.checksum for world in used)).encode()).hexdigest(),
        "training_mse": float(np.mean((whole.difficulty(inputs)[0] - difficulty) ** 2)),
    }
    return DifficultyModel(whole.planners, whole.networks, _relative_std(others, folds, inputs, difficulty), about)


def train_models(inputs: Floats, trials: Trials, kept: Mask, seed: int) -> list[DifficultyModel]:
    """Return a model per row of `kept` (b, w), trained on the worlds kept there, from inputs (w, d)."""
    targets = np.concatenate([trials.times(), trials.failures()], axis=1)
    made = []
    for index, mask in enumerate(kept):
        seeds = np.random.SeedSequence([seed, 0, index]).generate_state(_NETWORKS)
        networks = tuple(train_network(inputs[mask], targets[mask], int(one)) for one in seeds)
        made.append(DifficultyModel(trials.planner_names, networks, 0.0, {}))
    return made


def judged(worlds: Mapping[int, World], trials: Trials, config: EvaluationConfig) -> tuple[ModelScore, ModelScore]:
    """Return the errors of ridge regression and of networks, on the same folds; ModelError for too few worlds."""
    own, known = trained_worlds(worlds, trials), trials.only(trials.world_numbers)
    if (apart := held_out(own)) is not None:
        raise ModelError(f"{apart.name} is a world of {HELD_OUT}, which is never trained on; it judges weights")
    inputs, difficulty = inputs_of(own), known.difficulty()

    def fitted(kept: Mask, seed: int) -> list[Floats]:
        return [model.difficulty(inputs)[0] for model in train_models(inputs, known, kept, seed)]

    ridge = ridge_score(inputs, known, config)
    predicted, training_mse = on_folds(fitted, difficulty, config)
    return ridge, score_of(ROUTES, TITLE, training_mse, predicted, difficulty, ridge)


def _relative_std(models: Sequence[DifficultyModel], folds: Mask, inputs: Floats, difficulty: Floats) -> float:
    """Return by what share of it a prediction is off beyond the members' disagreement, in 68.3 % of worlds left out."""
    beyond = []
    for model, kept in zip(models, folds, strict=True):
        predicted, spread = model.difficulty(inputs[~kept])
        off = np.maximum((predicted - difficulty[~kept]) ** 2 - spread**2, 0.0)
        beyond.append(np.sqrt(off) / predicted)
    return float(np.quantile(np.concatenate(beyond), math.erf(math.sqrt(0.5))))


@click.command()
@click.argument("sources", nargs=-1, required=True, type=click.Path(path_type=Path))
@click.option("--out", type=click.Path(path_type=Path), help="Weights to write, .npz; without, models are judged.")
@click.option("--planner", default="", help="Learn the times of this one alone, not the mean of all.")
@click.option("--dataset", default="", help="Where the worlds are, if not where the results say.")
@click.option("--seed", default=0, show_default=True)
@click.option("--folds", default=10, show_default=True)
@click.option("--repeats", default=5, show_default=True)
def main(
    sources: Sequence[Path], out: Path | None, planner: str, dataset: str, seed: int, folds: int, repeats: int
) -> None:
    """Train, or judge."""
    try:
        parts = [read_trials(source, dataset) for source in sources]
        worlds, trials = parts[0] if len(parts) == 1 else joined(parts)
        trials = trials.of(planner) if planner else trials
        if out is not None:
            save_model(train(worlds, trials, seed), out)
            return
        scores = judged(worlds, trials, EvaluationConfig(folds, repeats, seed))
    except BarnError as error:
        raise click.ClickException(str(error)) from None
    table = Table("model", "training error", "held-out error", "R2", "Spearman", "better than ridge by")
    for one in scores:
        held_out_figures = ("" if it is None else it.text() for it in (one.mse, one.r2, one.spearman, one.gain))
        table.add_row(one.name, f"{one.training_mse:.3f}", *held_out_figures)
    Console(width=140).print(table)


if __name__ == "__main__":
    main()
