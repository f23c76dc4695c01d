"""Trials of the difficulty model, ridge regression, folds and the noise ceiling."""

from dataclasses import replace

import numpy as np
import pytest
from evaluation import fit_ridge, fold_masks, noise_ceiling
from refusals import refused
from trial_sources import Trials

from barn_metrics.model import ModelError
from barn_metrics.model.inputs import input_names, inputs_of


def make_trials(worlds, repetitions=4):
    """Return trials whose time follows the share of narrow places, with noise, the second planner 1 s/m slower."""
    generator = np.random.default_rng(3)
    narrow = inputs_of(worlds.values())[:, input_names().index("narrow_share")]
    rows = []
    for index, share in zip(worlds, narrow, strict=True):
        for planner, slower in (("quick", 0.0), ("slow", 1.0)):
            for _ in range(repetitions):
                easy = 8.0 + 3.0 * share
                time = easy + slower + 0.1 * generator.standard_normal()
                rows.append((index, planner, time, generator.random() < 0.9))
    numbers, planners, times, succeeded = zip(*rows, strict=True)
    return Trials(np.array(numbers), planners, np.array(times), np.array(succeeded))


def test_difficulty_weighs_planners_equally():
    trials = Trials(
        np.array([1, 1, 1, 2, 2]),
        ("a", "a", "b", "a", "b"),
        np.array([1.0, 3.0, 6.0, 1.0, 2.0]),
        np.array([True, True, False, True, True]),
    )
    assert trials.world_numbers == (1, 2)
    assert trials.difficulty().tolist() == [4.0, 1.5]
    assert trials.by_planner("b").difficulty().tolist() == [6.0, 2.0]
    assert trials.mean_by_world(trials.normalized_s_per_m).tolist() == [
        [2.0, 6.0],
        [1.0, 2.0],
    ]
    assert trials.mean_by_world(trials.succeeded).tolist() == [[1.0, 0.0], [1.0, 1.0]]
    with refused(r"no trials of planner 'dwa'", ModelError):
        trials.by_planner("dwa")


@pytest.mark.parametrize("time", [0.0, -1.0, np.nan, np.inf])
def test_trials_refuse_times_that_are_none(time):
    with refused("world 7: time per meter must be above 0", ModelError):
        Trials(np.array([7]), ("a",), np.array([time]), np.array([True]))


def test_ridge_regression_finds_a_plane():
    draw = np.random.default_rng(0).standard_normal
    x = np.column_stack([draw((200, 3)), np.full(200, 7.0)])
    y = 2.0 + x[:, 0] - 3.0 * x[:, 1] + 1e-3 * draw(200)
    errors = fit_ridge(x, y)(x) - y
    assert np.abs(errors).max() < 0.02


def test_folds_leave_each_world_out_once():
    masks = fold_masks(23, 5, seed=1)
    assert (~masks).sum(axis=0).tolist() == [1] * 23
    assert (fold_masks(23, 5, seed=1) == masks).all()
    assert (fold_masks(23, 5, seed=2) != masks).any()


def test_ceiling_is_the_known_reliability_of_simulated_trials():
    draw = np.random.default_rng(5).standard_normal
    repetitions = 6
    noise = 0.8
    truth = np.repeat(4.0 + 0.6 * draw(500), repetitions)
    numbers = np.repeat(np.arange(500), repetitions)
    count = len(numbers)
    times = np.maximum(truth + noise * draw(count), 0.01)
    trials = Trials(numbers, ("a",) * count, times, np.ones(count, np.bool_))
    expected = 0.36 / (0.36 + noise**2 / repetitions)
    ceiling = noise_ceiling(trials)
    assert ceiling.low < expected < ceiling.high
    assert ceiling.estimate == pytest.approx(expected, abs=0.03)
    single = replace(trials, worlds=np.arange(count))
    assert noise_ceiling(single) is None
