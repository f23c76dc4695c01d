"""Reading trials for the difficulty model, and `barn difficulty` from end to end."""

import csv
import json
import os
import re
from pathlib import Path

import numpy as np
import pyarrow as pa
import pyarrow.csv
import pyarrow.parquet
import pytest
from click.testing import CliRunner

from barn_eval.commands.main import cli
from barn_eval.learning.difficulty import read_trials
from barn_metrics.bootstrap import Interval
from barn_metrics.model import load_model
from barn_metrics.model.weights import shipped_weights
from barn_worlds.base.errors import BarnError, ConfigError
from barn_worlds.worlds.dataset import open_dataset

COUNT = 30
FOLDS = ("--set", "folds=3", "--set", "repeats=1")


@pytest.fixture(scope="module")
def table(tmp_path_factory):
    """Return a campaign's table: two planners, two repetitions, in worlds of barn300 numbered otherwise."""
    path = tmp_path_factory.mktemp("campaign") / "results.parquet"
    write_table(path, rows())
    return path


def rows(first=0, name="barn300"):
    dataset = open_dataset(name)
    worlds = [dataset.load(index) for index in dataset.indices[first :: len(dataset.indices) // COUNT]][:COUNT]
    return [
        {
            "dataset": name,
            "world": 1000 + number,
            "world_checksum": world.checksum,
            "planner": planner,
            "normalised_time_s_per_m": 2.0 + 0.1 * number + slower + 0.01 * repetition,
            "success": (number + repetition) % 7 > 0,
        }
        for number, world in enumerate(worlds)
        for planner, slower in (("dwa", 0.0), ("eband", 0.5))
        for repetition in range(2)
    ]


def write_table(path, content):
    found = pa.Table.from_pylist(content)
    if path.suffix == ".parquet":
        pyarrow.parquet.write_table(found, path)
    else:
        pyarrow.csv.write_csv(found, path)


@pytest.fixture(scope="module")
def weights(table, tmp_path_factory):
    """Weights of a model trained on the table, and what the command told."""
    pytest.importorskip("torch", reason="networks are trained with PyTorch")
    path = tmp_path_factory.mktemp("weights") / "w.npz"
    trained = barn("train", table, "--out", path, "--json")
    assert trained.exit_code == 0, trained.output
    return path, json.loads(trained.stdout)


def barn(*arguments):
    return CliRunner().invoke(cli, ["difficulty", *map(str, arguments)], catch_exceptions=True)


def test_worlds_are_known_by_their_checksum_whatever_their_number(table, tmp_path):
    worlds, trials = read_trials(table)
    dataset = open_dataset("barn300")
    assert tuple(worlds) == trials.world_numbers == dataset.indices[:: 300 // COUNT]
    assert all(world.checksum == dataset.load(index).checksum for index, world in worlds.items())
    assert trials.difficulty() == pytest.approx([2.255 + 0.1 * number for number in range(COUNT)])
    again = tmp_path / "results.csv"
    write_table(again, rows())
    assert read_trials(again)[1].difficulty() == pytest.approx(trials.difficulty())
    whole = [row | {"normalised_time_s_per_m": 3 + row["world"] % 2} for row in rows()]
    write_table(again, whole)  # times without decimals are times all the same
    assert read_trials(again)[1].difficulty() == pytest.approx([3.0, 4.0] * (COUNT // 2))


@pytest.mark.parametrize("suffix", [".parquet", ".csv"])
def test_trials_that_did_not_fail_by_the_planners_fault_are_left_out(tmp_path, suffix):
    path = tmp_path / f"results{suffix}"
    content = [row | {"fault": ""} for row in rows()]
    lost = content[0] | {"fault": "environment", "success": False, "normalised_time_s_per_m": 900.0}
    write_table(path, [*content, lost, lost | {"fault": "simulator"}])
    assert len(read_trials(path)[1]) == len(content)
    write_table(path, [lost])
    with pytest.raises(ConfigError, match="has no rows of trials that count"):
        read_trials(path)


def test_a_world_without_trials_of_every_planner_is_left_out(tmp_path):
    path = tmp_path / "results.parquet"
    write_table(path, [row for row in rows() if (row["world"], row["planner"]) != (1000, "dwa")])
    assert len(read_trials(path)[0]) == COUNT - 1


@pytest.mark.parametrize(
    ("change", "message"),
    [
        ({"world_checksum": "0" * 64}, "world 1000 of its trials is none of barn300"),
        ({"normalised_time_s_per_m": -1.0}, "time per metre must be above 0, got -1.0"),
        (
            {"normalised_time_s_per_m": None},
            "column 'normalised_time_s_per_m' must hold double in every row, has double, 1 missing",
        ),
        ({"planner": None}, "column 'planner' must hold string in every row, has string, 1 missing"),
    ],
)
def test_a_table_that_cannot_be_used_is_refused_in_one_line(tmp_path, change, message):
    path = tmp_path / "results.parquet"
    content = rows()
    write_table(path, [content[0] | change, *content[1:]])
    with pytest.raises(BarnError, match=message) as caught:
        read_trials(path)
    assert "\n" not in str(caught.value)


def test_other_files_are_refused(tmp_path):
    with pytest.raises(ConfigError, match="No such file"):
        read_trials(tmp_path / "none.parquet")
    with pytest.raises(ConfigError, match=r"must be the folder of a campaign, or a table that ends in"):
        read_trials(tmp_path / "none.txt")
    (tmp_path / "bad.parquet").write_bytes(b"PAR1 no")
    with pytest.raises(ConfigError, match="cannot be read"):
        read_trials(tmp_path / "bad.parquet")
    content = [{key: value for key, value in row.items() if key != "success"} for row in rows()]
    write_table(tmp_path / "less.parquet", content)
    with pytest.raises(ConfigError, match="no column 'success'"):
        read_trials(tmp_path / "less.parquet")


def test_published_times_are_read_with_the_worlds_beside_them():
    folder = Path(os.environ.get("BARN_ORIGINAL", Path(__file__).resolve().parents[3] / "shared" / "barn_original"))
    if not (folder / "trials.csv").is_file():
        pytest.skip(f"no original worlds in {folder}; set BARN_ORIGINAL to their folder")
    worlds, trials = read_trials(folder / "trials.csv")
    assert (len(worlds), len(trials), trials.planner_names) == (50, 500, ("dwa", "eband"))
    with (folder / "trials.csv").open() as file:
        first = next(csv.DictReader(file))
    times = [float(first[f"{planner}_{number}"]) for planner in ("dwa", "eband") for number in range(1, 6)]
    assert trials.difficulty()[0] == pytest.approx(np.mean(times) / float(first["path_length_m"]))
    with pytest.raises(BarnError, match="path of world 0 has"):
        read_trials(folder / "trials.csv", "barn300")


def test_train_and_predict_from_the_command_line(weights, tmp_path):
    path, told = weights
    scores = tmp_path / "scores.csv"
    assert told["training_worlds"] == COUNT
    predicted = barn("predict", "barn300", "--worlds", "0-4", "--weights", path, "--out", scores, "--json")
    assert predicted.exit_code == 0, predicted.output
    lines = json.loads(predicted.stdout)["worlds"]
    expected = load_model(path).predict(open_dataset("barn300").load(3))
    assert lines[3]["difficulty_s_per_m"] == expected.difficulty_s_per_m
    with scores.open() as file:
        assert [float(row["difficulty_s_per_m"]) for row in csv.DictReader(file)] == [
            line["difficulty_s_per_m"] for line in lines
        ]
    shown = barn("predict", "barn300", "--worlds", "3", "--weights", path)
    assert f"{expected.difficulty_s_per_m:.2f}" in shown.stdout


def test_models_and_weights_are_judged_beside_ridge_regression(table, weights):
    path, trained = weights
    found = barn("evaluate", table, *FOLDS, "--json")
    assert found.exit_code == 0, found.output
    ridge, routes = json.loads(found.stdout)["scores"]
    assert (ridge["name"], routes["name"], ridge["gain"]) == ("ridge", "routes", None)
    assert all(one["mse"]["low"] <= one["mse"]["estimate"] <= one["mse"]["high"] for one in (ridge, routes))
    content = json.loads(barn("evaluate", table, "--weights", path, *FOLDS, "--json").stdout)
    again, one = content["scores"]
    difficulty = read_trials(table)[1].difficulty()
    assert (again, one["name"], content["worlds"]) == (ridge, "weights", COUNT)
    assert one["mse"]["estimate"] == pytest.approx(trained["training_mse"]) == one["training_mse"]
    assert one["r2"]["estimate"] == pytest.approx(1.0 - trained["training_mse"] / difficulty.var())
    assert one["gain"]["estimate"] == pytest.approx(ridge["mse"]["estimate"] - one["mse"]["estimate"])
    shown = " ".join(barn("evaluate", table, "--weights", path, *FOLDS).stdout.split())
    limits = Interval(**one["gain"]).text().split(" ", 1)[1]
    assert limits in shown and "highest R2 that these trials allow" in shown


def test_worlds_held_out_judge_weights_alone(tmp_path):
    judges = tmp_path / "judges.parquet"
    write_table(judges, rows(name="barn_test"))
    assert "is never trained on; it judges weights" in str(barn("evaluate", judges, *FOLDS).exception)
    (one,) = json.loads(barn("evaluate", judges, "--weights", "shipped", "--json").stdout)["scores"]
    assert (one["name"], one["gain"], len(one["predictions"])) == ("weights", None, COUNT)


def test_the_page_on_metrics_quotes_the_card():
    page = Path(__file__).resolve().parents[2] / "docs" / "metrics.md"
    if not page.is_file():
        pytest.skip("the repository's docs are not beside this package")
    card = shipped_weights().with_suffix(".md").read_text("utf-8")
    folds, elsewhere = ({}, {})
    for line in card.splitlines():
        cells = [cell.strip() for cell in line.split("|")]
        if len(cells) == 9 and re.match(r"-?\d", cells[6]):
            values = [float(number) for number in re.findall(r"-?[\d.]+", cells[6])]
            (folds if cells[1] not in folds else elsewhere).setdefault(cells[1], values)
    told = " ".join(page.read_text("utf-8").split("## Difficulty, learned")[1].split())
    assert f"ridge regression on them explains {100 * folds['ridge'][0]:.0f} % of the variance" in told
    assert f"and {100 * elsewhere['ridge'][0]:.0f} % once it is trained in 9000 other worlds" in told
    shipped, low, high = (round(100 * value) for value in elsewhere["routes"])
    assert f"none of them of barn300, it explains {shipped} % [{low}, {high}]" in told
    assert f"Trained in barn300 alone it would come to {100 * folds['routes'][0]:.0f} %" in told
    ceiling = float(re.search(r"highest R2 that these trials allow is ([\d.]+)", card)[1])
    assert f"the trials themselves allow {100 * ceiling:.0f} %" in told


def test_mistakes_are_told(table, tmp_path):
    assert "must end in .npz" in str(barn("train", table, "--out", tmp_path / "w.bin").exception)
    (tmp_path / "w.npz").write_bytes(b"PK")
    refused = barn("predict", "barn300", "--weights", tmp_path / "w.npz")
    assert isinstance(refused.exception, BarnError)
    assert str(refused.exception).startswith(f"{tmp_path / 'w.npz'}: not a difficulty model, or a damaged one")
    assert "no trials of planner 'dwb'" in str(
        barn("train", table, "--out", tmp_path / "x.npz", "--set", "planner=dwb").exception
    )
