"""Training with PyTorch is repeatable, the same in numpy and judged in other worlds."""

from dataclasses import replace

import numpy as np
import pytest
from evaluation import WEIGHTS, EvaluationConfig, evaluate, noise_ceiling
from refusals import refused
from test_difficulty_judging import make_trials

from barn_metrics.model import ModelError, load_model, save_model
from barn_metrics.model.inputs import inputs_of
from barn_worlds.datasets.dataset import open_dataset

torch = pytest.importorskip("torch", reason="networks are trained with PyTorch")

from judge_difficulty import judge_networks  # noqa: E402
from network_training import (  # noqa: E402
    NetworkConfig,
    NetworkTraining,
    targets_of,
    train_model,
    train_network,
)


def test_training_repeats_and_numpy_evaluates_it_as_torch_does(worlds):
    few = {number: worlds[number] for number in list(worlds)[::2]}
    inputs = inputs_of(few.values())
    trials = make_trials(few)
    targets = targets_of(trials)
    config = NetworkConfig(filters=8, epochs=60, batch=10, dropout=0.0)
    first, again = (train_network(inputs, targets, 3, config) for _ in range(2))
    assert (first(inputs) == again(inputs)).all()
    errors = (first(inputs) - targets)[:, 0]
    assert np.mean(errors**2) < 0.3 * targets[:, 0].var()
    training = NetworkTraining(inputs, targets, config, 3)
    every = torch.arange(len(inputs))
    strips = (training.strips, training.mirrored_strips)
    with torch.no_grad():
        both = [training.outputs(way, every).numpy() for way in strips]
    mean_output = 0.5 * (both[0] + both[1])
    theirs = mean_output * training.target_std + training.target_mean
    assert training.network()(inputs) == pytest.approx(theirs, rel=1e-4, abs=1e-4)


def test_training_is_repeatable_and_its_model_stored_and_checked(worlds, tmp_path):
    worlds = {number: worlds[number] for number in list(worlds)[::3]}
    trials = make_trials(worlds)
    model = train_model(worlds, trials)
    save_model(model, tmp_path / "w.npz")
    read = load_model(tmp_path / "w.npz")
    assert read.predict(worlds[0]) == model.predict(worlds[0])
    save_model(train_model(worlds, trials), tmp_path / "again.npz")
    assert (tmp_path / "again.npz").read_bytes() == (tmp_path / "w.npz").read_bytes()
    report = evaluate(worlds, trials, read, EvaluationConfig(folds=2, repeats=1))
    assert report.worlds == model.about["training_worlds"] == len(worlds)
    assert report.trials == len(trials)
    score = report.score(WEIGHTS)
    assert score.mse.estimate == pytest.approx(model.about["training_mse"])
    predicted = [model.predict(world) for world in worlds.values()]
    difficulties = [prediction.difficulty_s_per_m for prediction in predicted]
    assert score.predictions == pytest.approx(difficulties)
    assert all(prediction.std_s_per_m > 0.0 for prediction in predicted[:3])


def test_both_kinds_are_judged_on_the_same_folds(worlds):
    trials = make_trials(worlds)
    five, routes = judge_networks(worlds, trials, EvaluationConfig(folds=3, repeats=1))
    assert min(five.r2.estimate, routes.r2.estimate) > 0.5
    gain = five.mse.estimate - routes.mse.estimate
    assert routes.gain.estimate == pytest.approx(gain)
    assert five.gain is None
    assert (five.name, routes.name) == ("ridge", "routes")
    assert len(routes.predictions) == len(worlds)
    assert noise_ceiling(trials).estimate > 0.5


def test_nothing_is_trained_on_worlds_held_out_under_any_name(worlds):
    held_out = open_dataset("barn_test")
    renamed = {
        number: replace(held_out.load(number), name=f"mine_{number}")
        for number in held_out.world_numbers[:20]
    }
    trials = make_trials(renamed)
    words = "is a world of barn_test, which judges models and is never trained on"
    with refused(f"mine_0 {words}", ModelError):
        train_model(renamed, trials)
    mixed = worlds | {1000: held_out.load(7)}
    with refused("is a world of barn_test", ModelError):
        train_model(mixed, make_trials(mixed))
    with refused(words, ModelError):
        judge_networks(renamed, trials, EvaluationConfig(folds=2, repeats=1))
    shipped = load_model()
    (judged,) = evaluate(renamed, trials, shipped, EvaluationConfig()).scores
    assert (judged.name, judged.gain) == (WEIGHTS, None)
    assert judged.training_mse == shipped.about["training_mse"]


def test_training_needs_worlds(worlds):
    trials = make_trials(worlds)
    few = trials.in_worlds(trials.world_numbers[:9])
    with refused("at least 10 worlds with trials of every planner, got 9", ModelError):
        train_model(worlds, few)
    with refused("trials of world 0, but not the world itself", ModelError):
        train_model({6: worlds[6]}, trials)
