"""Predicted difficulty from the command line, and the figures that a page quotes."""

import json
import re

import pytest
from waiting import ROOT

from barn_metrics.model import load_model
from barn_metrics.model.weights import default_weights
from barn_worlds.datasets.dataset import open_dataset


def test_the_command_prints_what_the_model_predicts(command):
    predict = ("difficulty", "predict", "barn300", "--weights", default_weights())
    code, out, _ = command(*predict, "--worlds", "0-4", "--json")
    assert code == 0
    lines = json.loads(out)["worlds"]
    expected = load_model().predict(open_dataset("barn300").load(3))
    assert lines[3]["difficulty_s_per_m"] == expected.difficulty_s_per_m
    assert f"{expected.difficulty_s_per_m:.2f}" in command(*predict, "--worlds", "3")[1]


def test_a_damaged_file_of_weights_is_named(tmp_path, rejected):
    (tmp_path / "w.npz").write_bytes(b"PK")
    message = rejected("difficulty predict barn300 --weights w.npz")
    assert message.startswith("error: w.npz: not a difficulty model, or a damaged one")


def test_the_page_on_metrics_quotes_the_card():
    page = ROOT / "docs" / "metrics.md"
    if not page.is_file():
        pytest.skip("the repository's docs are not beside this package")
    card = default_weights().with_suffix(".md").read_text("utf-8")
    folds = {}
    elsewhere = {}
    for line in card.splitlines():
        cells = [cell.strip() for cell in line.split("|")]
        if len(cells) == 9 and re.match(r"-?\d", cells[6]):
            values = [float(number) for number in re.findall(r"-?[\d.]+", cells[6])]
            (folds if cells[1] not in folds else elsewhere).setdefault(cells[1], values)
    section = " ".join(
        page.read_text("utf-8").split("## Learned difficulty")[1].split()
    )
    assert (
        f"ridge regression on the metrics explains {100 * folds['ridge'][0]:.0f}% of the variance"
        in section
    )
    assert (
        f"and {100 * elsewhere['ridge'][0]:.0f}% if it is trained in 9000 other worlds"
        in section
    )
    shipped, low, high = (round(100 * value) for value in elsewhere["routes"])
    assert (
        f"none of which are in barn300, the model explains {shipped}% [{low}, {high}]"
        in section
    )
    assert (
        f"Trained in barn300 alone, the model would explain {100 * folds['routes'][0]:.0f}%"
        in section
    )
    ceiling = float(re.search(r"allows an R2 of at most ([\d.]+)", card)[1])
    assert f"The noise of the trials allows at most {100 * ceiling:.0f}%" in section
