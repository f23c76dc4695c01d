"""The simulations of `barn validate`: their trials are what they say, and their outcome is within what is promised."""

import json
from pathlib import Path

import numpy as np
import pytest
from click.testing import CliRunner

from barn_eval.analysis import significance
from barn_eval.analysis.variance import components
from barn_eval.commands.validate import command
from barn_eval.studies import validation
from barn_eval.studies.validation import Check, checks, equal_planners, statistics_page
from barn_metrics.bootstrap import Interval

PAGE = Path(__file__).resolve().parents[2] / "docs" / "statistics.md"


@pytest.fixture(scope="module")
def small():
    """A version of each check that takes seconds; the shares, which are cheap, with more simulations."""
    with pytest.MonkeyPatch.context() as patch:
        patch.setattr(validation, "PAIR_WORLDS", (20, 50))
        patch.setattr(validation, "SHARES", ())
        tests = list(checks(60, seed=4))
        patch.undo()
        patch.setattr(validation, "PAIR_WORLDS", ())
        patch.setattr(validation, "BOARD_PLANNERS", 1)
        return [*list(checks(600, seed=4))[:-1], *tests]


def test_each_target_is_met_within_chance(small):
    assert [one.verdict for one in small if one.verdict == "missed"] == []
    assert [one.setting.split(",")[0] for one in small if "share" in one.setting] == ["50 worlds x 3"] * 4 + [
        "300 worlds x 5"
    ] * 4
    assert all(0.92 <= one.found <= 0.98 for one in small if "share" in one.setting)
    pairs, (board,) = small[8:-1], small[-1:]
    assert len(pairs) == 2
    assert all(0.0 < one.found <= 0.13 for one in pairs)
    assert board.found <= 0.13
    assert "8 equal planners" in board.what


def test_an_interval_over_trials_would_be_found_out(monkeypatch):
    """What the audit of the old intervals found: over trials, a share at 300 x 5 is covered much too seldom."""
    share = significance.share
    monkeypatch.setattr(validation, "share", lambda successes, worlds: share(successes, np.arange(len(worlds))))
    monkeypatch.setattr(validation, "PAIR_WORLDS", ())
    monkeypatch.setattr(validation, "BOARD_PLANNERS", 1)
    found = list(checks(500))[:8]
    assert all(one.found < 0.93 for one in found)
    assert [one.verdict for one in found[4:]] == ["missed"] * 4
    assert all(one.found < 0.85 for one in found[4:])


def test_a_board_without_holm_would_be_found_out(monkeypatch):
    monkeypatch.setattr(validation, "SHARES", ())
    monkeypatch.setattr(validation, "PAIR_WORLDS", ())
    monkeypatch.setattr("barn_eval.analysis.ranking.holm", list)
    (board,) = checks(30)
    assert board.verdict == "missed"
    assert board.found > 0.25


def test_equal_planners_share_their_worlds_and_nothing_else():
    draws = [equal_planners(2, 300, np.random.default_rng([1, number])) for number in range(5)]
    values = np.array([[one[0] for one in pair] for pair in draws])
    failed = (values == 10.0).astype(float)
    assert failed.mean() == pytest.approx(0.07, abs=0.02)
    assert values[0][0].tolist() != values[0][1].tolist()
    parts = [components(one.ravel(), draws[0][0][1]) for one in failed[:, 0]]
    correlation = np.mean([one.between / (one.between + one.within) for one in parts])
    assert correlation == pytest.approx(0.67, abs=0.12)
    assert np.corrcoef(values[:, 0].ravel(), values[:, 1].ravel())[0, 1] > 0.4
    assert draws[0][0][2].tolist()[:4] == [0, 1, 2, 0]


@pytest.mark.parametrize(
    ("found", "verdict"), [(0.95, "met"), (0.92, "met within chance"), (0.90, "missed"), (1.0, "missed")]
)
def test_a_target_is_missed_beyond_three_errors(found, verdict):
    one = Check("", "", 1000, found, (0.93, 0.97))  # an error is 0.8 % at the lower limit, 0.5 % at the upper
    assert one.verdict == verdict
    assert one.standard_error == pytest.approx((found * (1.0 - found) / 1000) ** 0.5)


def test_the_command_ends_with_1_if_a_target_is_missed(monkeypatch, tmp_path):
    monkeypatch.setattr(validation, "PAIR_WORLDS", ())
    monkeypatch.setattr(validation, "BOARD_PLANNERS", 1)
    runner = CliRunner()
    arguments = ["--simulations", "20", "--seed", "3"]
    done = runner.invoke(
        command, [*arguments, "--json", "--out", str(tmp_path / "statistics.md")], standalone_mode=False
    )
    assert done.return_value == 0
    content = json.loads(done.stdout)
    assert (content["simulations"], content["seed"], len(content["checks"])) == (20, 3, 9)
    assert "barn validate --simulations 20 --seed 3" in (tmp_path / "statistics.md").read_text()
    assert "50 worlds x 3" in runner.invoke(command, arguments, standalone_mode=False).stdout
    monkeypatch.setattr(validation, "share", lambda *_: Interval(0.5, 0.5, 0.5))
    assert runner.invoke(command, arguments, standalone_mode=False).return_value == 1


@pytest.mark.skipif(not PAGE.is_file(), reason="the repository's documentation is not beside this package")
def test_the_page_is_what_the_command_writes(monkeypatch):
    """The shares are simulated again in full; of the rest, the page must have a row with the settings of today."""
    text = PAGE.read_text("utf-8")
    every = [line for line in text.splitlines() if line.startswith(("| the 95 %", "| two equal", "| a board"))]
    assert len(every) == 12
    assert not any("missed" in line for line in every)
    monkeypatch.setattr(validation, "PAIR_WORLDS", ())
    monkeypatch.setattr(validation, "BOARD_PLANNERS", 1)
    page = statistics_page(list(checks())[:8], 0)
    shares = [line for line in page.splitlines() if line.startswith("| the 95 %")]
    assert every[:8] == shares
    head = page.partition("| in simulations")[0]
    assert text.startswith(head)
    assert text.endswith(page.rpartition("\n\nThe error is")[2])
