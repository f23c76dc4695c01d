"""What is made of measured figures; nothing here depends on how fast the machine is."""

import json
from dataclasses import asdict

import pytest
from refusals import refused

from barn_eval.studies.bench import Change, Measurement, best_of, changes, read_figures


def rounds(*values, better="higher"):
    return [Measurement("speed", value, "x", better) for value in values]


def test_the_best_round_counts_and_the_others_tell_the_noise():
    best = best_of(rounds(4.0, 5.0, 4.5))
    assert (best.value, best.samples, best.noise) == (
        5.0,
        (4.0, 5.0, 4.5),
        pytest.approx(0.2),
    )
    assert best_of(rounds(4.0, 5.0, better="lower")).value == 4.0
    assert Measurement("speed", 1.0, "x").noise == 0.0


def test_a_change_is_how_many_times_as_good_a_figure_is():
    now = [
        Measurement("rate", 20.0, "/s"),
        Measurement("time", 2.0, "ms", "lower"),
        Measurement("new", 1.0, "x"),
    ]
    before = [
        Measurement("rate", 10.0, "/s"),
        Measurement("time", 1.0, "ms", "lower"),
        Measurement("old", 1.0, "x"),
    ]
    differences = changes(now, before)
    assert [(change.name, change.ratio, change.slower) for change in differences] == [
        ("rate", 2.0, False),
        ("time", 0.5, True),
    ]


def test_a_change_within_the_noise_is_none():
    before = best_of(rounds(9.0, 10.0))
    now = best_of(rounds(8.0, 9.0))
    (change,) = changes([now], [before])
    assert (
        change.ratio == pytest.approx(0.9) and change.noise > 0.1 and not change.slower
    )
    assert Change("speed", 0.8, 0.1).slower


def test_figures_come_back_from_their_file(tmp_path):
    figures = [best_of(rounds(4.0, 5.0)), Measurement("share", 40.0, "%", "lower")]
    (tmp_path / "bench.json").write_text(
        json.dumps({"figures": [asdict(figure) for figure in figures]})
    )
    assert read_figures(tmp_path / "bench.json") == figures


@pytest.mark.parametrize(
    "text", ["", "[]", "{}", '{"figures": [{"name": 3}]}', '{"figures": [7]}']
)
def test_a_file_of_something_else_is_told(tmp_path, text):
    (tmp_path / "bench.json").write_text(text)
    with refused(r"--against .*bench\.json: not a result of barn bench --json"):
        read_figures(tmp_path / "bench.json")


def test_a_wrong_figure_is_named_by_its_place(tmp_path):
    good = asdict(Measurement("share", 40.0, "%", "lower"))
    (tmp_path / "bench.json").write_text(json.dumps({"figures": [good, {"name": 3}]}))
    with refused(r"not a result of barn bench --json \(figures\[1\]"):
        read_figures(tmp_path / "bench.json")
