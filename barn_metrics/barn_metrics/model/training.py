"""Training of difficulty models from trials."""

import hashlib
import math
from collections.abc import Iterable, Mapping, Sequence

import numpy as np

from barn_metrics.model.inputs import inputs_of
from barn_metrics.model.network_training import Mask
from barn_metrics.model.predictor import DifficultyModel
from barn_metrics.model.recipes import recipe_named, targets_of, train_members
from barn_metrics.model.trials import Trials, check_worlds
from barn_worlds.base.arrays import Floats
from barn_worlds.base.errors import ModelError
from barn_worlds.worlds.dataset import open_dataset
from barn_worlds.worlds.world import World

_CALIBRATION_FOLDS, _CALIBRATION_WORLDS = 5, 300
FEWEST_WORLDS = 10
HELD_OUT = "barn_test"  # judges models; nothing is trained on it or chosen by it


def train(recipe: str, worlds: Mapping[int, World], trials: Trials, seed: int = 0) -> DifficultyModel:
    """Return a model trained on all worlds that every planner of the trials was tried in.

    The same arguments give the same model. Its uncertainty comes from further models, each trained without a fifth of
    the worlds: five, or as few as leave enough worlds out.
    Raises ModelError for too few worlds, for worlds of `HELD_OUT`, or where a library for training is missing.
    """
    chosen = recipe_named(recipe)
    used = trained_worlds(worlds, trials)
    refuse_held_out(used)
    inputs = inputs_of(used, chosen.inputs)
    targets, difficulty = targets_of(chosen, trials), trials.difficulty()
    enough = math.ceil(_CALIBRATION_WORLDS * _CALIBRATION_FOLDS / len(used))
    folds = fold_masks(len(used), _CALIBRATION_FOLDS, seed)[:enough]
    kept = np.concatenate([np.ones((1, len(used)), np.bool_), folds])
    planners = trials.planner_names if chosen.per_planner else ()
    whole, *others = (
        DifficultyModel(recipe, chosen.inputs, planners, members, 0.0, {})
        for members in train_members(chosen, inputs, targets, kept, seed)
    )
    about = {
        "title": chosen.title,
        "seed": seed,
        "planners": list(trials.planner_names),
        "training_worlds": len(used),
        "training_trials": len(trials.only(trials.world_numbers)),
        # Of the worlds' own checksums, whatever the order of the worlds.
        "worlds_sha256": hashlib.sha256("\n".join(sorted(world.checksum for world in used)).encode()).hexdigest(),
        "training_mse": float(np.mean((whole.difficulty(inputs)[0] - difficulty) ** 2)),
    }
    spread = _relative_std(others, folds, inputs, difficulty)
    return DifficultyModel(recipe, chosen.inputs, planners, whole.members, spread, about)


def trained_worlds(worlds: Mapping[int, World], trials: Trials) -> list[World]:
    """Return the worlds in the order of the trials' `world_numbers`; ModelError if one is missing or they are few."""
    numbers = trials.world_numbers
    check_worlds(worlds, numbers)
    if len(numbers) < FEWEST_WORLDS:
        raise ModelError(
            f"a model needs at least {FEWEST_WORLDS} worlds with trials of every planner, got {len(numbers)}"
        )
    return [worlds[number] for number in numbers]


def refuse_held_out(worlds: Iterable[World]) -> None:
    """Raise ModelError for a world of `HELD_OUT`, whatever it is called and wherever its path runs."""
    if (found := held_out(worlds)) is not None:
        raise ModelError(f"{found.name} is a world of {HELD_OUT}, which judges models and is never trained on")


def held_out(worlds: Iterable[World]) -> World | None:
    """Return the first world whose obstacles are those of a world of `HELD_OUT`, None without any."""
    kept_apart = open_dataset(HELD_OUT)
    grids = {kept_apart.load(index).grid.tobytes() for index in kept_apart.indices}
    return next((world for world in worlds if world.grid.tobytes() in grids), None)


def fold_masks(worlds: int, folds: int, seed: int) -> Mask:
    """Return which worlds (folds, worlds) are trained on in each fold; each world is left out in exactly one."""
    order = np.random.default_rng(seed).permutation(worlds)
    kept = np.ones((folds, worlds), np.bool_)
    for fold, part in enumerate(np.array_split(order, folds)):
        kept[fold, part] = False
    return kept


def _relative_std(models: Sequence[DifficultyModel], folds: Mask, inputs: Floats, difficulty: Floats) -> float:
    """Return by what share of it a prediction is off in worlds that were left out, beyond the members' disagreement."""
    beyond = []
    for model, kept in zip(models, folds, strict=True):
        predicted, spread = model.difficulty(inputs[~kept])
        beyond.append(((predicted - difficulty[~kept]) ** 2 - spread**2) / predicted**2)
    return float(np.sqrt(max(np.concatenate(beyond).mean(), 0.0)))
