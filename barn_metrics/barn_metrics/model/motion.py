"""Difficulty of worlds whose obstacles move: ridge regression on features of their tracks, and the simplest rival.

The rival is a straight line through the number of obstacles times their mean speed.
"""

from collections.abc import Mapping
from dataclasses import dataclass, fields

import numpy as np

from barn_metrics.bootstrap import Interval
from barn_metrics.model.recipes import train_ridge
from barn_metrics.model.scores import Errors, errors_of, paired_gain
from barn_metrics.model.training import trained_worlds
from barn_metrics.model.trials import Trials
from barn_metrics.motion_features import FEATURES, motion_features
from barn_worlds.base.arrays import Floats
from barn_worlds.base.errors import ModelError
from barn_worlds.robots.robot import Robot
from barn_worlds.worlds.world import World

RIVAL = "count_times_speed"
MODELS = {"features": FEATURES, "count times speed": (RIVAL,)}


@dataclass(frozen=True)
class ModelErrors(Errors):
    """Errors of one model in the worlds that it is judged on; predictions of each, s/m."""

    name: str
    predictions: tuple[float, ...]


@dataclass(frozen=True)
class MotionJudged:
    """How models of motion do in worlds that they were not trained on.

    gain: by how much the mean squared error of the features is lower than that of the rival, (s/m)^2. better: whether
    its interval lies above 0. weights: of each feature, z-scored in the training worlds, s/m.
    """

    training_worlds: int
    training_trials: int
    worlds: tuple[int, ...]
    trials: int
    planners: tuple[str, ...]
    measured_s_per_m: tuple[float, ...]
    models: tuple[ModelErrors, ...]
    gain: Interval
    better: bool
    weights: Mapping[str, float]


def judge_motion(
    training: tuple[Mapping[int, World], Trials],
    judged: tuple[Mapping[int, World], Trials],
    robot: Robot | None = None,
) -> MotionJudged:
    """Return how models trained on some trials do on others, both of one robot and the planners that both have.

    ModelError where there is no such planner, or where they share a world.
    """
    planners = sorted({*training[1].planner_names} & {*judged[1].planner_names})
    if not planners:
        named = [", ".join(trials.planner_names) for _, trials in (training, judged)]
        raise ModelError(f"trained on trials of {named[0]}, judged on trials of {named[1]}: no planner is in both")
    training, judged = ((worlds, trials.among(planners)) for worlds, trials in (training, judged))
    worlds, others = (trained_worlds(*one) for one in (training, judged))
    shared = {one.checksum for one in worlds} & {one.checksum for one in others}
    if shared:
        raise ModelError(f"{len(shared)} worlds are trained on and judged on as well")
    inputs, unseen = features_of(worlds, robot), features_of(others, robot)
    targets, measured = training[1].difficulty(), judged[1].difficulty()
    seen = {name: [FEATURES.index(column) for column in columns] for name, columns in MODELS.items()}
    fitted = {name: train_ridge(inputs[:, columns], targets[:, None]) for name, columns in seen.items()}
    low, high = targets.min(), targets.max()  # failures count as one time, which no prediction should pass
    predictions = {name: np.clip(fitted[name](unseen[:, columns])[:, 0], low, high) for name, columns in seen.items()}
    features, rival = predictions.values()
    gain = paired_gain(rival, features, measured)
    ((weights, _),) = fitted["features"].layers
    found = [
        ModelErrors(**vars(errors_of(one[None], measured)), name=name, predictions=tuple(one.tolist()))
        for name, one in predictions.items()
    ]
    return MotionJudged(
        training_worlds=len(worlds),
        training_trials=len(training[1]),
        worlds=judged[1].world_numbers,
        trials=len(judged[1]),
        planners=tuple(planners),
        measured_s_per_m=tuple(measured.tolist()),
        models=tuple(found),
        gain=gain,
        better=gain.low is not None and gain.low > 0.0,
        weights=dict(zip(FEATURES, weights[:, 0].tolist(), strict=True)),
    )


def features_of(worlds: list[World], robot: Robot | None = None) -> Floats:
    """Return the features of worlds for a robot, (w, k) in the order of `FEATURES`; WorldError where nothing moves."""
    rows = [motion_features(world, robot) for world in worlds]
    return np.array([[getattr(row, item.name) for item in fields(row)] for row in rows])
