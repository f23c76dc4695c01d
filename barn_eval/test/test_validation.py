"""The simulations of `barn validate`: their trials are what they say, and their outcome is within what is promised."""

import json
from pathlib import Path

import numpy as np
import pytest
from click.testing import CliRunner

from barn_eval.analysis import significance
from barn_eval.analysis.means import Columns
from barn_eval.analysis.significance import components
from barn_eval.commands.validate import command
from barn_eval.studies import validation
from barn_eval.studies.validation import Check, checks, equal_planners, statistics_page
from barn_metrics.bootstrap import Interval

PAGE = Path(__file__).resolve().parents[2] / "docs" / "statistics.md"


GROUPS = ("SHARES", "MEANS", "SKEWED_WORLDS", "SUCCESSES", "UNLIKE", "PAIR_WORLDS")


def only(patch, **kept):
    """Leave out all checks but those of the groups that are named, and the board unless it keeps its planners."""
    for name, value in {**dict.fromkeys(GROUPS, ()), "BOARD_PLANNERS": 1, **kept}.items():
        patch.setattr(validation, name, value)


@pytest.mark.parametrize(
    ("group", "settings", "simulations", "lowest", "highest"),
    [
        ("SHARES", ((50, 3),), 600, 0.92, 0.98),
        ("MEANS", ((10, 1), (20, 5)), 200, 0.90, 1.0),
        ("SKEWED_WORLDS", (10,), 400, 0.90, 1.0),
        ("SUCCESSES", ((10, 5),), 300, 0.90, 1.0),
        ("UNLIKE", ((50, 5),), 60, 0.0, 0.13),
        ("PAIR_WORLDS", (20,), 60, 0.0, 0.13),
    ],
)
def test_each_target_is_met_within_chance(monkeypatch, group, settings, simulations, lowest, highest):
    only(monkeypatch, **{group: settings})
    found = list(checks(simulations, seed=4))[:-1]
    assert len(found) >= len(settings)
    assert [one.verdict for one in found if one.verdict == "missed"] == []
    assert all(lowest <= one.found <= highest for one in found)


def test_a_verdict_that_knows_only_the_failures_it_saw_would_be_found_out(monkeypatch):
    """What the audit of the old verdicts found: failures that were not drawn were not thought of."""
    only(monkeypatch, UNLIKE=((50, 5),), UNLIKE_FAILURES=(0.02,))
    monkeypatch.setattr(Columns, "counted", False)
    unlike, _ = checks(200, seed=4)
    assert unlike.verdict == "missed"


def test_an_interval_over_trials_would_be_found_out(monkeypatch):
    """What the audit of the old intervals found: over trials, a share at 300 x 5 is covered much too seldom."""
    over_trials = significance.proportion
    monkeypatch.setattr(validation, "proportion", lambda some, worlds: over_trials(some, np.arange(len(worlds))))
    only(monkeypatch, SHARES=validation.SHARES)
    found = list(checks(500))[:8]
    assert all(one.found < 0.93 for one in found)
    assert [one.verdict for one in found[4:]] == ["missed"] * 4
    assert all(one.found < 0.85 for one in found[4:])


def test_a_board_without_holm_would_be_found_out(monkeypatch):
    only(monkeypatch, BOARD_PLANNERS=validation.BOARD_PLANNERS)
    monkeypatch.setattr("barn_eval.analysis.verdict.holm", list)
    (board,) = checks(30)
    assert board.verdict == "missed"
    assert board.found > 0.25


def test_equal_planners_share_their_worlds_and_nothing_else():
    draws = [equal_planners(2, 300, np.random.default_rng([1, number])) for number in range(5)]
    values = np.array([[one.values for one in pair] for pair in draws])
    failed = (values == 10.0).astype(float)
    assert failed.mean() == pytest.approx(0.07, abs=0.02)
    assert values[0][0].tolist() != values[0][1].tolist()
    parts = [components(one.ravel(), draws[0][0].worlds) for one in failed[:, 0]]
    correlation = np.mean([one.between / (one.between + one.within) for one in parts])
    assert correlation == pytest.approx(0.67, abs=0.12)
    assert np.corrcoef(values[:, 0].ravel(), values[:, 1].ravel())[0, 1] > 0.4
    assert draws[0][0].repetitions.tolist()[:4] == [0, 1, 2, 0]


@pytest.mark.parametrize(
    ("found", "verdict"), [(0.95, "met"), (0.92, "met within chance"), (0.90, "missed"), (1.0, "missed")]
)
def test_a_target_is_missed_beyond_three_errors(found, verdict):
    one = Check("", "", 1000, found, (0.93, 0.97))  # an error is 0.8 % at the lower limit, 0.5 % at the upper
    assert one.verdict == verdict
    assert one.standard_error == pytest.approx((found * (1.0 - found) / 1000) ** 0.5)


def test_the_command_ends_with_1_if_a_target_is_missed(monkeypatch, tmp_path):
    only(monkeypatch, SHARES=validation.SHARES)
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
    monkeypatch.setattr(validation, "proportion", lambda *_: Interval(0.5, 0.5, 0.5))
    assert runner.invoke(command, arguments, standalone_mode=False).return_value == 1


@pytest.mark.skipif(not PAGE.is_file(), reason="the repository's documentation is not beside this package")
def test_the_page_is_what_the_command_writes(monkeypatch):
    """The shares are simulated again in full; of the rest, the page must have a row with the settings of today."""
    text = PAGE.read_text("utf-8")
    every = [line for line in text.splitlines() if line.startswith(("| the 95 %", "| two ", "| a board"))]
    assert len(every) == 43
    assert not any("missed" in line for line in every)
    only(monkeypatch, SHARES=validation.SHARES)
    page = statistics_page(list(checks())[:8], 0)
    shares = [line for line in page.splitlines() if line.startswith("| the 95 %")]
    assert every[:8] == shares
    head = page.partition("| in simulations")[0]
    assert text.startswith(head)
    assert text.endswith(page.rpartition("\n\nThe error is")[2])
