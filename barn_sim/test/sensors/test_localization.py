import math
from itertools import pairwise

import numpy as np
import pytest
from driving import difference

from barn_sim.config import LocalizationConfig
from barn_sim.sensors.localization import FilterLocalization
from barn_worlds.base.types import Pose2D

CONFIG = LocalizationConfig(mode="amcl")
ORIGIN = Pose2D(1.0, 2.0, 0.5)


def believer(config=CONFIG, seed=0):
    return FilterLocalization(config, np.random.default_rng(seed))


def test_the_correction_is_held_until_the_robot_has_moved_enough():
    filter_ = believer()
    corrections = []
    for step in range(25):
        odometry = Pose2D(0.01 * step, 0.0, 0.0)
        estimate = filter_.estimate(ORIGIN @ odometry, odometry)
        corrections.append(estimate @ odometry.inverse())
    changes = [after.distance(before) for before, after in pairwise(corrections)]
    assert (1 + np.flatnonzero(np.array(changes) > 1e-9)).tolist() == [10, 20]


def test_a_turn_causes_an_update_as_well():
    filter_ = believer()
    first, before, after = (
        filter_.estimate(ORIGIN, turn) @ turn.inverse()
        for turn in (Pose2D(0.0, 0.0, yaw) for yaw in (0.0, 0.313, 0.315))
    )
    assert before.distance(first) < 1e-12
    assert after.distance(first) > 1e-6


def test_errors_have_the_configured_deviation_and_correlation():
    filter_ = believer()
    errors = np.empty((20000, 3))
    for step in range(len(errors)):
        odometry = Pose2D(0.11 * step, 0.0, 0.0)
        truth = ORIGIN @ odometry
        errors[step] = difference(filter_.estimate(truth, odometry), truth)
    away = np.hypot(errors[:, 0], errors[:, 1])
    assert 0.05 < away.mean() < 0.09  # as the paper's localisation
    assert errors.std(axis=0) == pytest.approx([0.04, 0.04, 0.01], rel=0.1)
    after_five = np.corrcoef(errors[:-5, 0], errors[5:, 0])[0, 1]
    assert after_five == pytest.approx(math.exp(-1.0), abs=0.06)


def test_without_deviations_it_gives_the_truth_where_it_updates():
    config = LocalizationConfig(mode="amcl", position_std_m=0.0, yaw_std_rad=0.0)
    filter_ = believer(config)
    odometry = Pose2D(0.2, 0.1, -0.3)
    estimate = filter_.estimate(ORIGIN @ odometry, odometry)
    assert estimate.distance(ORIGIN @ odometry) < 1e-12


def test_the_same_seed_gives_the_same_errors():
    odometry = Pose2D(0.0, 0.0, 0.0)
    first, again, other = (
        believer(CONFIG, seed).estimate(ORIGIN, odometry) for seed in (3, 3, 4)
    )
    assert first == again != other
