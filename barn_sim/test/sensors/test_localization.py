import math

import numpy as np
import pytest

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
    distinct = [0] + [
        i for i in range(1, 25) if corrections[i].distance(corrections[i - 1]) > 1e-9
    ]
    assert distinct == [0, 10, 20]


def test_a_turn_causes_an_update_as_well():
    filter_ = believer()
    first = filter_.estimate(ORIGIN, Pose2D(0.0, 0.0, 0.0))
    before = (
        filter_.estimate(ORIGIN, Pose2D(0.0, 0.0, 0.313))
        @ Pose2D(0.0, 0.0, 0.313).inverse()
    )
    after = (
        filter_.estimate(ORIGIN, Pose2D(0.0, 0.0, 0.315))
        @ Pose2D(0.0, 0.0, 0.315).inverse()
    )
    assert before.distance(first) < 1e-12
    assert after.distance(first) > 1e-6


def test_errors_have_the_configured_deviation_and_correlation():
    filter_ = believer()
    rows = []
    for step in range(20000):
        odometry = Pose2D(0.11 * step, 0.0, 0.0)
        truth = ORIGIN @ odometry
        estimate = filter_.estimate(truth, odometry)
        rows.append(
            (estimate.x - truth.x, estimate.y - truth.y, estimate.yaw - truth.yaw)
        )
    errors = np.array(rows)
    assert (
        0.05 < np.hypot(errors[:, 0], errors[:, 1]).mean() < 0.09
    )  # as the paper's localisation
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
