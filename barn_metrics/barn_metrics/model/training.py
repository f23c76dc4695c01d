"""Training of difficulty models from trials."""

from __future__ import annotations

import hashlib
import math
from collections.abc import Mapping, Sequence
from dataclasses import replace

import numpy as np
import numpy.typing as npt

from barn_metrics.model.errors import ModelError
from barn_metrics.model.inputs import inputs_of
from barn_metrics.model.predictor import DifficultyModel
from barn_metrics.model.recipes import RECIPES, recipe_named, targets_of, train_members
from barn_metrics.model.trials import Trials
from barn_worlds.world import World

__all__ = ["RECIPES", "fold_masks", "joined", "train"]

Floats = npt.NDArray[np.float64]

_CALIBRATION_FOLDS, _CALIBRATION_WORLDS = 5, 300
FEWEST_WORLDS = 10


def train(recipe: str, worlds: Mapping[int, World], trials: Trials, seed: int = 0) -> DifficultyModel:
    """Return a model trained on all worlds that every planner of the trials was tried in.

    The same arguments give the same model. More models, each without a fifth of the worlds, tell its uncertainty: five,
    or as few as leave enough worlds out.
    Raises ModelError for too few worlds, or where a library for training is missing.
    """
    chosen = recipe_named(recipe)
    numbers = trained_worlds(worlds, trials)
    inputs = inputs_of([worlds[number] for number in numbers], chosen.inputs)
    targets, difficulty = targets_of(chosen, trials), trials.difficulty()
    enough = math.ceil(_CALIBRATION_WORLDS * _CALIBRATION_FOLDS / len(numbers))
    folds = fold_masks(len(numbers), _CALIBRATION_FOLDS, seed)[:enough]
    kept = np.concatenate([np.ones((1, len(numbers)), np.bool_), folds])
    planners = trials.planner_names if chosen.per_planner else ()
    models = [
        DifficultyModel(recipe, chosen.inputs, planners, members, 0.0, {})
        for members in train_members(chosen, inputs, targets, kept, seed)
    ]
    about = {
        "title": chosen.title,
        "seed": seed,
        "planners": list(trials.planner_names),
        "training_worlds": len(numbers),
        "training_trials": len(trials.only(numbers)),
        "worlds_sha256": _checksum([worlds[number] for number in numbers]),
        "training_mse": float(np.mean((models[0].difficulty(inputs) - difficulty) ** 2)),
    }
    spread = _relative_std(models[1:], folds, inputs, difficulty)
    return DifficultyModel(recipe, chosen.inputs, planners, models[0].members, spread, about)


def joined(parts: Sequence[tuple[Mapping[int, World], Trials]]) -> tuple[dict[int, World], Trials]:
    """Return the worlds and trials of several campaigns, worlds numbered anew; the same world counts as one.

    ModelError if a campaign has trials of a world that it does not have.
    """
    numbers: dict[str, int] = {}
    worlds: dict[int, World] = {}
    renumbered = []
    for mine, trials in parts:
        _check_there(mine, trials.worlds.tolist())
        new = {number: numbers.setdefault(world.checksum, len(numbers)) for number, world in mine.items()}
        worlds |= {new[number]: world for number, world in mine.items()}
        renumbered.append(replace(trials, worlds=np.array([new[int(number)] for number in trials.worlds], np.int64)))
    return worlds, Trials(
        np.concatenate([one.worlds for one in renumbered]),
        tuple(planner for one in renumbered for planner in one.planners),
        np.concatenate([one.normalised_s_per_m for one in renumbered]),
        np.concatenate([one.succeeded for one in renumbered]),
    )


def trained_worlds(worlds: Mapping[int, World], trials: Trials) -> tuple[int, ...]:
    """Return the numbers of the worlds that can be trained on; ModelError if one is missing or they are too few."""
    numbers = trials.world_numbers
    _check_there(worlds, numbers)
    if len(numbers) < FEWEST_WORLDS:
        raise ModelError(
            f"a model needs at least {FEWEST_WORLDS} worlds with trials of every planner, got {len(numbers)}"
        )
    return numbers


def _check_there(worlds: Mapping[int, World], numbers: Sequence[int]) -> None:
    missing = next((number for number in numbers if number not in worlds), None)
    if missing is not None:
        raise ModelError(f"there are trials of world {missing}, but not the world itself")


def fold_masks(worlds: int, folds: int, seed: int) -> npt.NDArray[np.bool_]:
    """Return which worlds (folds, worlds) are trained on in each fold; each world is left out in exactly one."""
    order = np.random.default_rng(seed).permutation(worlds)
    kept = np.ones((folds, worlds), np.bool_)
    for fold, part in enumerate(np.array_split(order, folds)):
        kept[fold, part] = False
    return kept


def _checksum(worlds: list[World]) -> str:
    """Return SHA-256 of the worlds' own checksums, whatever the order of the worlds."""
    return hashlib.sha256("\n".join(sorted(world.checksum for world in worlds)).encode()).hexdigest()


def _relative_std(
    models: list[DifficultyModel], folds: npt.NDArray[np.bool_], inputs: Floats, difficulty: Floats
) -> float:
    """Return by what share of it a prediction is off in worlds that were left out, beyond the members' disagreement."""
    beyond = []
    for model, kept in zip(models, folds, strict=True):
        predicted = model.difficulty(inputs[~kept])
        squared = (predicted - difficulty[~kept]) ** 2 - model.spread(inputs[~kept]) ** 2
        beyond.append(squared / predicted**2)
    return float(np.sqrt(max(np.concatenate(beyond).mean(), 0.0)))
