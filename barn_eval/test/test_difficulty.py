"""Reading trials for the difficulty model, and training, judging and using it from end to end."""

import json
import re
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from click.testing import CliRunner
from reproduce_work import experiment_of, write_made_up

from barn_eval.analysis.sources import read_source
from barn_eval.api.difficulty import evaluate, read_trials, train
from barn_eval.commands.main import cli
from barn_eval.trials.outcome import Outcome
from barn_metrics.model import load_model
from barn_metrics.model.weights import default_weights
from barn_worlds.base.errors import BarnError, ConfigError
from barn_worlds.datasets.dataset import open_dataset
from barn_worlds.formats.own import write_own

COUNT = 30


@pytest.fixture(scope="module")
def source(tmp_path_factory):
    """Return the folder of an experiment: two planners, two repetitions, in worlds of barn300."""
    path = tmp_path_factory.mktemp("experiment") / "out"
    write_made_up(path, experiment_of("0:300:10", 2))
    return path


@pytest.fixture(scope="module")
def weights(source, tmp_path_factory):
    """Weights of a model trained on the source, and what is told about it."""
    pytest.importorskip("torch", reason="networks are trained with PyTorch")
    path = tmp_path_factory.mktemp("weights") / "w.npz"
    trained = CliRunner().invoke(
        cli, ["difficulty", "train", str(source), "--out", str(path)]
    )
    assert trained.exit_code == 0, trained.output
    with pytest.raises(BarnError, match="no trials of planner 'dwb'"):
        train(source, path, planner="dwb")
    return path, load_model(path).about


def test_networks_are_judged_on_folds_by_a_tool(source):
    pytest.importorskip("torch", reason="networks are trained with PyTorch")
    tool = pytest.importorskip(
        "judge_difficulty",
        reason="the repository's qa folder is not beside this package",
    )
    judged = CliRunner().invoke(
        tool.main, [str(source), "--folds", "3", "--repeats", "1"]
    )
    assert "ridge" in judged.output and "routes" in judged.output


def test_worlds_are_known_by_their_checksum_whatever_their_number(source, tmp_path):
    worlds, trials = read_trials(source)
    dataset = open_dataset("barn300")
    assert tuple(worlds) == trials.world_numbers == dataset.world_numbers[::10]
    assert all(
        world.checksum == dataset.load(index).checksum
        for index, world in worlds.items()
    )
    results = read_source(source).results
    first = [one.scores.normalised_time_s_per_m for one in results if one.world == 10]
    assert (len(first), len(trials)) == (4, len(results))
    assert trials.difficulty()[1] == pytest.approx(np.mean(first))
    write_own(
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


def test_trials_that_do_not_count_and_worlds_without_every_planner_are_left_out(
    tmp_path,
):
    def lost(result):
        failed = replace(
            result, outcome=Outcome.ENVIRONMENT_FAILED, fault="environment"
        )
        return failed if result.trial_id == lost_id else result

    lost_id = experiment_of("0-11", 1).trials()[0].trial_id
    write_made_up(tmp_path / "out", experiment_of("0-11", 1), change=lost)
    worlds, trials = read_trials(tmp_path / "out")
    assert (len(worlds), len(trials)) == (11, 22)


def test_other_sources_are_refused(tmp_path):
    (tmp_path / "t.parquet").write_bytes(b"PAR1")
    for name in ("none.csv", "none", "t.parquet"):
        with pytest.raises(BarnError, match=r"none|t\.parquet") as caught:
            read_trials(tmp_path / name, "barn300")
        assert "\n" not in str(caught.value)


def test_a_model_is_trained_and_predicts_from_the_command_line(weights, command):
    path, told = weights
    assert told["training_worlds"] == COUNT
    predict = ("difficulty", "predict", "barn300", "--weights", path)
    code, out, _ = command(*predict, "--worlds", "0-4", "--json")
    assert code == 0
    lines = json.loads(out)["worlds"]
    expected = load_model(path).predict(open_dataset("barn300").load(3))
    assert lines[3]["difficulty_s_per_m"] == expected.difficulty_s_per_m
    assert f"{expected.difficulty_s_per_m:.2f}" in command(*predict, "--worlds", "3")[1]


def test_models_and_weights_are_judged_beside_ridge_regression(source, weights):
    path, trained = weights
    found = evaluate(source, weights=path, folds=3, repeats=1)
    ridge, one = found.scores
    assert all(
        each.mse.low <= each.mse.estimate <= each.mse.high for each in (ridge, one)
    )
    difficulty = read_trials(source)[1].difficulty()
    assert (ridge.name, ridge.gain, one.name, found.worlds) == (
        "ridge",
        None,
        "weights",
        COUNT,
    )
    assert (
        one.mse.estimate == pytest.approx(trained["training_mse"]) == one.training_mse
    )
    assert one.r2.estimate == pytest.approx(
        1.0 - trained["training_mse"] / difficulty.var()
    )
    assert one.gain.estimate == pytest.approx(ridge.mse.estimate - one.mse.estimate)
    assert found.ceiling is not None


def test_worlds_held_out_judge_weights_alone(tmp_path):
    judges = tmp_path / "judges"
    write_made_up(judges, experiment_of("0-29", 2, "barn_test"))
    (one,) = evaluate(judges).scores
    assert (one.name, one.gain, len(one.predictions)) == ("weights", None, COUNT)


def test_the_page_on_metrics_quotes_the_card():
    page = Path(__file__).resolve().parents[2] / "docs" / "metrics.md"
    if not page.is_file():
        pytest.skip("the repository's docs are not beside this package")
    card = default_weights().with_suffix(".md").read_text("utf-8")
    folds, elsewhere = ({}, {})
    for line in card.splitlines():
        cells = [cell.strip() for cell in line.split("|")]
        if len(cells) == 9 and re.match(r"-?\d", cells[6]):
            values = [float(number) for number in re.findall(r"-?[\d.]+", cells[6])]
            (folds if cells[1] not in folds else elsewhere).setdefault(cells[1], values)
    told = " ".join(page.read_text("utf-8").split("## Difficulty, learned")[1].split())
    assert (
        f"ridge regression on them explains {100 * folds['ridge'][0]:.0f} % of the variance"
        in told
    )
    assert (
        f"and {100 * elsewhere['ridge'][0]:.0f} % once it is trained in 9000 other worlds"
        in told
    )
    shipped, low, high = (round(100 * value) for value in elsewhere["routes"])
    assert f"none of them of barn300, it explains {shipped} % [{low}, {high}]" in told
    assert (
        f"Trained in barn300 alone it would come to {100 * folds['routes'][0]:.0f} %"
        in told
    )
    ceiling = float(
        re.search(r"highest R2 that these trials allow is ([\d.]+)", card)[1]
    )
    assert f"the trials themselves allow {100 * ceiling:.0f} %" in told


def test_mistakes_are_told(source, tmp_path, rejected):
    (tmp_path / "w.npz").write_bytes(b"PK")
    told = rejected("difficulty", "predict", "barn300", "--weights", "w.npz")
    assert told.startswith("error: w.npz: not a difficulty model, or a damaged one")
    with pytest.raises(BarnError, match="no trials of planner 'dwb'"):
        evaluate(source, planner="dwb")
    with pytest.raises(BarnError, match="16 folds need at least 32 worlds, got 30"):
        evaluate(source, folds=16)
