"""Training of the difficulty model on trials; it needs PyTorch."""

import hashlib
import math
from collections.abc import Mapping, Sequence

import numpy as np

from barn_metrics.model.inputs import inputs_of
from barn_metrics.model.predictor import DifficultyModel
from barn_metrics.model.torch_training import train_network
from barn_metrics.model.trials import HELD_OUT, Trials, fold_masks, held_out, trained_worlds
from barn_worlds.base.arrays import Bools, Floats
from barn_worlds.base.errors import ModelError
from barn_worlds.worlds.world import World

TITLE = "networks convolved along the clearance beside three routes, and all inputs"
_NETWORKS = 3
_CALIBRATION_FOLDS, _CALIBRATION_WORLDS = 5, 300


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


def train_models(inputs: Floats, trials: Trials, kept: Bools, seed: int) -> list[DifficultyModel]:
    """Return a model per row of `kept` (b, w), trained on the worlds kept there, from inputs (w, d)."""
    targets = np.concatenate([trials.times(), trials.failures()], axis=1)
    made = []
    for index, mask in enumerate(kept):
        seeds = np.random.SeedSequence([seed, 0, index]).generate_state(_NETWORKS)
        networks = tuple(train_network(inputs[mask], targets[mask], int(one)) for one in seeds)
        made.append(DifficultyModel(trials.planner_names, networks, 0.0, {}))
    return made


def _relative_std(models: Sequence[DifficultyModel], folds: Bools, inputs: Floats, difficulty: Floats) -> float:
    """Return by what share of it a prediction is off beyond the members' disagreement, in 68.3 % of worlds left out."""
    beyond = []
    for model, kept in zip(models, folds, strict=True):
        predicted, spread = model.difficulty(inputs[~kept])
        off = np.maximum((predicted - difficulty[~kept]) ** 2 - spread**2, 0.0)
        beyond.append(np.sqrt(off) / predicted)
    return float(np.quantile(np.concatenate(beyond), math.erf(math.sqrt(0.5))))
