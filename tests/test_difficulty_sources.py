"""Reading trials for the difficulty model, training and judging it, end to end."""

from dataclasses import replace

import numpy as np
import pytest
from click.testing import CliRunner
from evaluation import EvaluationConfig, evaluate
from judge_difficulty import main as judge
from refusals import refused
from reproduce_work import experiment_of, write_invented
from test_difficulty_judging import make_trials
from trial_sources import join_trials, load_trials, read_trials

from barn_eval.analysis.sources import read_source
from barn_eval.trials.result import Outcome
from barn_metrics.model import ModelError, load_model
from barn_worlds.base.errors import BarnError
from barn_worlds.datasets.dataset import open_dataset
from barn_worlds.formats.dataset_file import write_dataset_file

COUNT = 30


@pytest.fixture(scope="module")
def source(tmp_path_factory):
    """Return the folder of an experiment.

    Two planners, two repetitions, in worlds of barn300.
    """
    path = tmp_path_factory.mktemp("experiment") / "out"
    write_invented(path, experiment_of("0:300:10", 2))
    return path


@pytest.fixture(scope="module")
def weights(source, tmp_path_factory):
    """Weights of a model trained on the source, and what is told about it."""
    pytest.importorskip("torch", reason="networks are trained with PyTorch")
    path = tmp_path_factory.mktemp("weights") / "w.npz"
    from train_difficulty import main as train  # noqa: PLC0415 (needs PyTorch)

    trained = CliRunner().invoke(train, [str(source), "--out", str(path)])
    assert trained.exit_code == 0, trained.output
    return path, load_model(path).about


def test_networks_are_judged_on_folds_by_a_tool(source):
    pytest.importorskip("torch", reason="networks are trained with PyTorch")
    judged = CliRunner().invoke(
        judge, ["networks", str(source), "--folds", "3", "--repeats", "1"]
    )
    assert "ridge" in judged.output and "routes" in judged.output


def test_worlds_are_identified_by_checksum_not_by_number(source, tmp_path):
    by_number, trials = read_trials(source)
    dataset = open_dataset("barn300")
    assert tuple(by_number) == trials.world_numbers == dataset.world_numbers[::10]
    for index, world in by_number.items():
        assert world.checksum == dataset.load(index).checksum
    results = read_source(source).results
    first = [result.scores for result in results if result.world == 10]
    assert (len(first), len(trials)) == (4, len(results))
    mean = np.mean([scores.normalised_time_s_per_m for scores in first])
    assert trials.difficulty()[1] == pytest.approx(mean)
    renumbered = {1000 - index: world for index, world in by_number.items()}
    write_dataset_file(tmp_path / "again.npz", "again", renumbered)
    again, moved = read_trials(source, str(tmp_path / "again.npz"))
    assert tuple(again) == tuple(sorted(renumbered))
    assert moved.difficulty().tolist() == trials.difficulty().tolist()[::-1]
    with refused(
        "world 0 of its trials is none of barn_test; name the data set they ran in"
    ):
        read_trials(source, "barn_test")


def test_uncounted_trials_and_incomplete_worlds_are_left_out(tmp_path):
    def lost(result):
        if result.trial_id != lost_id:
            return result
        outcome = Outcome.ENVIRONMENT_FAILED
        return replace(result, outcome=outcome, fault="environment")

    lost_id = experiment_of("0-11", 1).trials()[0].trial_id
    write_invented(tmp_path / "out", experiment_of("0-11", 1), change=lost)
    by_number, trials = read_trials(tmp_path / "out")
    assert (len(by_number), len(trials)) == (11, 22)


def test_other_sources_are_refused(tmp_path):
    (tmp_path / "t.parquet").write_bytes(b"PAR1")
    for name in ("none.csv", "none", "t.parquet"):
        with refused(r"none|t\.parquet", BarnError):
            read_trials(tmp_path / name, "barn300")


def test_models_and_weights_are_judged_beside_ridge_regression(source, weights):
    path, trained = weights
    assert trained["training_worlds"] == COUNT
    config = EvaluationConfig(folds=3, repeats=1)
    report = evaluate(*load_trials([source]), load_model(path), config)
    ridge, network = report.scores
    for score in (ridge, network):
        assert score.mse.low <= score.mse.estimate <= score.mse.high
    difficulty = read_trials(source)[1].difficulty()
    assert (ridge.name, ridge.gain) == ("ridge", None)
    assert (network.name, report.worlds) == ("weights", COUNT)
    assert network.mse.estimate == pytest.approx(trained["training_mse"])
    assert network.training_mse == pytest.approx(trained["training_mse"])
    unexplained = trained["training_mse"] / difficulty.var()
    assert network.r2.estimate == pytest.approx(1.0 - unexplained)
    gain = ridge.mse.estimate - network.mse.estimate
    assert network.gain.estimate == pytest.approx(gain)
    assert report.ceiling is not None


def test_worlds_held_out_judge_weights_alone(tmp_path):
    judges = tmp_path / "judges"
    write_invented(judges, experiment_of("0-29", 2, "barn_test"))
    (score,) = evaluate(*load_trials([judges]), load_model(), EvaluationConfig()).scores
    assert (score.name, score.gain, len(score.predictions)) == ("weights", None, COUNT)


def test_mistakes_are_named(source):
    with refused("no trials of planner 'dwb'", BarnError):
        load_trials([source], planner="dwb")
    config = EvaluationConfig(folds=16)
    with refused("16 folds need at least 32 worlds, got 30", BarnError):
        evaluate(*load_trials([source]), load_model(), config)
    output = CliRunner().invoke(judge, ["weights", str(source), "--folds", "3"]).output
    assert "ridge" in output and "highest R2 that these trials allow" in output


def test_campaigns_are_joined_by_world_whatever_their_numbers(worlds):
    trials = make_trials(worlds, repetitions=1)
    even_worlds = {index: worlds[index] for index in list(worlds)[::2]}
    odd_worlds = {index: worlds[index] for index in list(worlds)[1::2]}
    some = trials.in_worlds(even_worlds)
    rest = trials.in_worlds(odd_worlds)
    renumbered = dict(enumerate(odd_worlds.values()))
    numbers = dict(zip(odd_worlds, renumbered, strict=True))
    moved_numbers = [numbers[int(index)] for index in rest.worlds]
    moved = replace(rest, worlds=np.array(moved_numbers))
    parts = [(even_worlds, some), (renumbered, moved), (even_worlds, some)]
    joined_worlds, joined_trials = join_trials(parts)
    assert len(joined_worlds) == len(worlds)
    assert len(joined_trials) == len(trials) + len(some)

    def difficulties(worlds, trials):
        values = zip(trials.world_numbers, trials.difficulty(), strict=True)
        return {worlds[number].checksum: value for number, value in values}

    expected = difficulties(worlds, trials)
    assert difficulties(joined_worlds, joined_trials) == pytest.approx(expected)
    with refused("there are trials of world 1, but not the world itself", ModelError):
        join_trials([({0: renumbered[0]}, moved)])
    numbers_with_stray = np.where(np.arange(len(moved)) == 0, 9_999, moved.worlds)
    stray = replace(moved, worlds=numbers_with_stray)
    words = "there are trials of world 9999, but not the world itself"
    with refused(words, ModelError):
        join_trials([(renumbered, stray)])
