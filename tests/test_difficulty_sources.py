"""Reading trials for the difficulty model, training and judging it, end to end."""

import json
from dataclasses import replace

import numpy as np
import pytest
from click.testing import CliRunner
from judge_difficulty import main as judge
from model.test_model import make_trials
from reproduce_work import experiment_of, write_invented
from trial_sources import join_trials, load_trials, read_trials

from barn_eval.analysis.sources import read_source
from barn_eval.commands.main import cli
from barn_eval.trials.outcome import Outcome
from barn_metrics.model import ModelError, load_model
from barn_metrics.model.evaluation import EvaluationConfig, evaluate
from barn_worlds.base.errors import BarnError, ConfigError
from barn_worlds.datasets.dataset import open_dataset
from barn_worlds.formats.dataset_file import write_dataset_file

COUNT = 30


@pytest.fixture(scope="module")
def worlds():
    dataset = open_dataset("barn300")
    return {number: dataset.load(number) for number in dataset.world_numbers[::6]}


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
    worlds, trials = read_trials(source)
    dataset = open_dataset("barn300")
    assert tuple(worlds) == trials.world_numbers == dataset.world_numbers[::10]
    assert all(
        world.checksum == dataset.load(index).checksum
        for index, world in worlds.items()
    )
    results = read_source(source).results
    first = [
        result.scores.normalised_time_s_per_m
        for result in results
        if result.world == 10
    ]
    assert (len(first), len(trials)) == (4, len(results))
    assert trials.difficulty()[1] == pytest.approx(np.mean(first))
    write_dataset_file(
        tmp_path / "again.npz",
        "again",
        {1000 - index: world for index, world in worlds.items()},
    )
    again, moved = read_trials(source, str(tmp_path / "again.npz"))
    assert tuple(again) == tuple(sorted(1000 - index for index in worlds))
    assert moved.difficulty().tolist() == trials.difficulty().tolist()[::-1]
    with pytest.raises(
        ConfigError,
        match="world 0 of its trials is none of barn_test; name the data set they ran in",
    ):
        read_trials(source, "barn_test")


def test_uncounted_trials_and_incomplete_worlds_are_left_out(
    tmp_path,
):
    def lost(result):
        failed = replace(
            result, outcome=Outcome.ENVIRONMENT_FAILED, fault="environment"
        )
        return failed if result.trial_id == lost_id else result

    lost_id = experiment_of("0-11", 1).trials()[0].trial_id
    write_invented(tmp_path / "out", experiment_of("0-11", 1), change=lost)
    worlds, trials = read_trials(tmp_path / "out")
    assert (len(worlds), len(trials)) == (11, 22)


def test_other_sources_are_refused(tmp_path):
    (tmp_path / "t.parquet").write_bytes(b"PAR1")
    for name in ("none.csv", "none", "t.parquet"):
        with pytest.raises(BarnError, match=r"none|t\.parquet") as caught:
            read_trials(tmp_path / name, "barn300")
        assert "\n" not in str(caught.value)


def test_a_trained_model_predicts_from_the_command_line(weights):
    path, description = weights
    assert description["training_worlds"] == COUNT
    predict = ["difficulty", "predict", "barn300", "--weights", str(path)]
    output = CliRunner().invoke(cli, [*predict, "--worlds", "0-4", "--json"]).output
    lines = json.loads(output)["worlds"]
    expected = load_model(path).predict(open_dataset("barn300").load(3))
    assert lines[3]["difficulty_s_per_m"] == expected.difficulty_s_per_m
    table = CliRunner().invoke(cli, [*predict, "--worlds", "3"]).output
    assert f"{expected.difficulty_s_per_m:.2f}" in table


def test_models_and_weights_are_judged_beside_ridge_regression(source, weights):
    path, trained = weights
    config = EvaluationConfig(folds=3, repeats=1)
    report = evaluate(*load_trials([source]), load_model(path), config)
    ridge, network = report.scores
    assert all(
        each.mse.low <= each.mse.estimate <= each.mse.high for each in (ridge, network)
    )
    difficulty = read_trials(source)[1].difficulty()
    assert (ridge.name, ridge.gain, network.name, report.worlds) == (
        "ridge",
        None,
        "weights",
        COUNT,
    )
    assert (
        network.mse.estimate
        == pytest.approx(trained["training_mse"])
        == network.training_mse
    )
    unexplained = trained["training_mse"] / difficulty.var()
    assert network.r2.estimate == pytest.approx(1.0 - unexplained)
    assert network.gain.estimate == pytest.approx(
        ridge.mse.estimate - network.mse.estimate
    )
    assert report.ceiling is not None


def test_worlds_held_out_judge_weights_alone(tmp_path):
    judges = tmp_path / "judges"
    write_invented(judges, experiment_of("0-29", 2, "barn_test"))
    (score,) = evaluate(*load_trials([judges]), load_model(), EvaluationConfig()).scores
    assert (score.name, score.gain, len(score.predictions)) == ("weights", None, COUNT)


def test_mistakes_are_named(source):
    with pytest.raises(BarnError, match="no trials of planner 'dwb'"):
        load_trials([source], planner="dwb")
    config = EvaluationConfig(folds=16)
    with pytest.raises(BarnError, match="16 folds need at least 32 worlds, got 30"):
        evaluate(*load_trials([source]), load_model(), config)
    output = CliRunner().invoke(judge, ["weights", str(source), "--folds", "3"]).output
    assert "ridge" in output and "highest R2 that these trials allow" in output


def test_campaigns_are_joined_by_world_whatever_their_numbers(worlds):
    trials = make_trials(worlds, repetitions=1)
    even_worlds, odd_worlds = (
        {index: worlds[index] for index in list(worlds)[first::2]} for first in (0, 1)
    )
    some = trials.in_worlds(even_worlds)
    rest = trials.in_worlds(odd_worlds)
    renumbered = dict(enumerate(odd_worlds.values()))
    numbers = dict(zip(odd_worlds, renumbered, strict=True))
    moved_numbers = [numbers[int(index)] for index in rest.worlds]
    moved = replace(rest, worlds=np.array(moved_numbers))
    joined_worlds, joined_trials = join_trials(
        [(even_worlds, some), (renumbered, moved), (even_worlds, some)]
    )
    assert len(joined_worlds) == len(worlds) and len(joined_trials) == len(
        trials
    ) + len(some)
    expected = {
        worlds[index].checksum: value
        for index, value in zip(trials.world_numbers, trials.difficulty(), strict=True)
    }
    assert [
        expected[joined_worlds[number].checksum]
        for number in joined_trials.world_numbers
    ] == pytest.approx(joined_trials.difficulty())
    with pytest.raises(
        ModelError, match="there are trials of world 1, but not the world itself"
    ):
        join_trials([({0: renumbered[0]}, moved)])
    numbers_with_stray = np.where(np.arange(len(moved)) == 0, 9_999, moved.worlds)
    stray = replace(moved, worlds=numbers_with_stray)
    with pytest.raises(
        ModelError, match="there are trials of world 9999, but not the world itself"
    ):
        join_trials([(renumbered, stray)])
