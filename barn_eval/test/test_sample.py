"""`barn worlds sample`, with the shipped model."""

import math

import pytest

from barn_eval.commands.worlds import parse_range
from barn_metrics.model import load_model
from barn_metrics.model.weights import shipped_weights
from barn_worlds.base.errors import ConfigError
from barn_worlds.worlds.dataset import open_dataset


@pytest.mark.parametrize("source", [(), ("--from", "barn300")])
def test_worlds_are_of_the_wanted_difficulty_and_repeat(command, rejected, tmp_path, source):
    model = load_model()
    known = sorted(model.predict(open_dataset("barn300").load(index)).difficulty_s_per_m for index in range(0, 300, 10))
    low, high = known[8], known[20]
    weights = ("--weights", shipped_weights())
    arguments = ("worlds", "sample", "--difficulty", f"{low}:{high}", "--count", 4, *weights, *source)
    assert command(*arguments, "a.npz") == (0, "", "4 worlds in a.npz\n")
    assert command(*arguments, "b.npz")[0] == command(*arguments, "--seed", 1, "c.npz")[0] == 0
    first, again, other = (open_dataset(tmp_path / f"{name}.npz") for name in "abc")
    predicted = [model.predict(first.load(index)).difficulty_s_per_m for index in first.indices]
    assert len(predicted) == 4 and predicted == sorted(predicted)
    assert low <= predicted[0] and predicted[-1] <= high
    assert first.checksum == again.checksum != other.checksum
    assert "a.npz: exists already" in rejected(*arguments, "a.npz")


def test_too_few_worlds_are_told_and_nothing_is_written(rejected):
    said = rejected("worlds", "sample", "x.npz", "--difficulty", "90:", "--from", "barn300")
    assert "barn300: 0 of 300 worlds have a difficulty of 90 to inf, 10 are wanted" in said


def test_a_range_may_be_open():
    assert parse_range("2.5:3") == (2.5, 3.0)
    assert parse_range(":3") == (-math.inf, 3.0) and parse_range("2:") == (2.0, math.inf)
    for text in ("3", "a:b", "1:2:3", ""):
        with pytest.raises(ConfigError, match="must be LOW:HIGH"):
            parse_range(text)
