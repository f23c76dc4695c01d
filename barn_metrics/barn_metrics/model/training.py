"""Training of difficulty models from trials."""

import hashlib
import math
from collections.abc import Iterable, Mapping, Sequence

import numpy as np
import numpy.typing as npt

from barn_metrics.model.inputs import inputs_of
from barn_metrics.model.predictor import DifficultyModel
from barn_metrics.model.trials import Trials, check_worlds
from barn_worlds.base.arrays import Floats
from barn_worlds.base.errors import ModelError
from barn_worlds.worlds.dataset import open_dataset
from barn_worlds.worlds.world import World

TITLE = "networks convolved along the clearance beside three routes, and all inputs"
FEWEST_WORLDS = 10
HELD_OUT = "barn_test"  # judges models; nothing is trained on it or chosen by it
_NETWORKS = 3
_CALIBRATION_FOLDS, _CALIBRATION_WORLDS = 5, 300

Mask = npt.NDArray[np.bool_]


def train(worlds: Mapping[int, World], trials: Trials, seed: int = 0) -> DifficultyModel:
    """Return a model trained on all worlds that every planner of the trials was tried in.

    The same arguments give the same model. Its uncertainty comes from further models, each trained without a fifth of
    the worlds: five, or as few as leave enough worlds out.
    Raises ModelError for too few worlds, for worlds of `HELD_OUT`, or where PyTorch is missing.
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
    try:
        from barn_metrics.model.torch_training import train_network  # noqa: PLC0415 (optional, and slow to load)
    except ImportError:
        raise ModelError("training of networks needs PyTorch: pip install torch") from None
    targets = np.concatenate([trials.times(), trials.failures()], axis=1)
    made = []
    for index, mask in enumerate(kept):
        seeds = np.random.SeedSequence([seed, 0, index]).generate_state(_NETWORKS)
        networks = tuple(train_network(inputs[mask], targets[mask], int(one)) for one in seeds)
        made.append(DifficultyModel(trials.planner_names, networks, 0.0, {}))
    return made


def trained_worlds(worlds: Mapping[int, World], trials: Trials) -> list[World]:
    """Return the worlds in the order of the trials' `world_numbers`; ModelError if one is missing or they are few."""
    numbers = trials.world_numbers
    check_worlds(worlds, numbers)
    if len(numbers) < FEWEST_WORLDS:
        raise ModelError(
            f"a model needs at least {FEWEST_WORLDS} worlds with trials of every planner, got {len(numbers)}"
        )
    return [worlds[number] for number in numbers]


def held_out(worlds: Iterable[World]) -> World | None:
    """Return the first world with the obstacles of a world of `HELD_OUT`, whatever it is called; None without any."""
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
