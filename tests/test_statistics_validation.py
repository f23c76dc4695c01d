"""Simulated trials are what they say, and their statistics are within the promise."""

import json
from dataclasses import replace

import numpy as np
import pytest
import simulated_checks
import validate_statistics
from click.testing import CliRunner
from repository import ROOT
from simulated_checks import GROUPS
from simulated_trials import draw_equal_planners
from text_tables import rows_of
from validate_statistics import Check, main, render_page, run_checks

from barn_eval.analysis import significance
from barn_eval.analysis.significance import variance_components
from barn_eval.analysis.statistics import TrialValues
from barn_metrics.bootstrap import Interval

PAGE = ROOT / "docs/statistics.md"


def some(name, *settings):
    """Return a group of checks with these settings alone."""
    return replace(GROUPS[name], settings=settings)


# A check, its setting, and how many simulations it takes.
TARGETS = """
share         | 50 3 0.3 0.9 | 300
high share    | 300 5 0.7 0.995 | 200
better        | 10 1 0.3 0.95 | 100
mean          | 10 1 3.0     | 100
mean          | 20 5 0.5     | 100
skewed        | 10           | 200
filtered      | 50 3 50.0    | 100
success       | 10 5 3.0 10.0 | 100
unlike        | 50 5 2.0     | 50
slow          | 300 1 2.0 3.0 | 50
test          | 20           | 100
equal         | 50           | 30
board         | 20           | 3
power         | 100 2.0      | 30
equal builds  | 100 2.0      | 30
unlike builds | 100 2.0      | 30
builds        | 100 2.0      | 20
plan          | 100 2.0      | 20
"""


@pytest.mark.parametrize("name, setting, simulations", rows_of(TARGETS))
def test_each_target_is_met_within_chance(name, setting, simulations):
    setting = tuple(map(json.loads, setting.split()))
    groups = [some(name, setting)]
    (check,) = run_checks(int(simulations), seed=4, groups=groups)
    assert check.conclusion != "missed"
    assert len(check.shares) == 2


def test_a_verdict_from_observed_failures_alone_is_detected(monkeypatch):
    """As a test of signs alone is: failures that were not drawn are not thought of."""
    monkeypatch.setattr(TrialValues, "counts_failures", False)
    (unlike,) = run_checks(100, seed=4, groups=[some("unlike", (50, 5, 2.0))])
    assert unlike.conclusion == "missed"


def test_an_interval_over_trials_would_be_found_out(monkeypatch):
    over_trials = significance.proportion

    def proportion(successes, worlds):
        return over_trials(successes, np.arange(len(worlds)))

    monkeypatch.setattr(simulated_checks, "proportion", proportion)
    group = some("share", (300, 5, 0.3, 0.9), (300, 5, 0.7, 0.7))
    first, second = run_checks(300, groups=[group])
    assert first.conclusion == second.conclusion == "missed"
    assert max(*first.shares, *second.shares) < 0.85


def test_a_board_without_holm_would_be_found_out(monkeypatch):
    monkeypatch.setattr("barn_eval.analysis.verdict.holm", list)
    (board,) = run_checks(10, groups=[some("board", (20,))])
    assert board.conclusion == "missed"


def test_equal_planners_share_their_worlds_and_nothing_else():
    generators = (np.random.default_rng([1, number]) for number in range(5))
    draws = [draw_equal_planners(2, 300, generator) for generator in generators]
    values = np.array([[sample.values for sample in pair] for pair in draws])
    failed = (values == 10.0).astype(float)
    assert failed.mean() == pytest.approx(0.07, abs=0.02)
    assert values[0][0].tolist() != values[0][1].tolist()
    worlds = draws[0][0].worlds
    parts = [variance_components(sample.ravel(), worlds) for sample in failed[:, 0]]
    correlations = [part.between / (part.between + part.within) for part in parts]
    assert np.mean(correlations) == pytest.approx(0.67, abs=0.12)
    both = (values[:, 0].ravel(), values[:, 1].ravel())
    assert np.corrcoef(*both)[0, 1] > 0.4
    assert draws[0][0].repetitions.tolist()[:4] == [0, 1, 2, 0]


@pytest.mark.parametrize(
    "share, verdict",
    [(0.95, "met"), (0.92, "met within chance"), (0.90, "missed"), (1.0, "missed")],
)
def test_a_target_is_missed_beyond_three_errors_with_any_seed(share, verdict):
    check = Check(
        "", "", 1000, (0.95, share), (0.93, 0.97)
    )  # an error is 0.8 % at the lower limit, 0.5 % at the upper
    assert check.conclusion == verdict
    variances = [x * (1.0 - x) / 1000 for x in (0.95, share)]
    assert check.standard_error == pytest.approx(max(variances) ** 0.5)


def test_the_command_ends_with_1_if_a_target_is_missed(monkeypatch, tmp_path):
    monkeypatch.setattr(validate_statistics, "GROUPS", {"share": GROUPS["share"]})
    runner = CliRunner()
    arguments = ["--simulations", "20", "--seed", "3"]
    out = tmp_path / "statistics.md"
    done = runner.invoke(main, [*arguments, "--json", "--out", str(out)])
    assert done.exit_code == 0
    content = json.loads(done.stdout)
    assert (content["simulations"], content["seed"]) == (20, 3)
    assert len(content["checks"]) == 8
    assert "validate_statistics.py --simulations 20 --seed 3" in out.read_text()
    assert "| seed 3 [%] | seed 4 [%] |" in out.read_text()
    assert "50 worlds x 3" in runner.invoke(main, arguments).stdout
    monkeypatch.setattr(
        simulated_checks, "proportion", lambda *_: Interval(0.5, 0.5, 0.5)
    )
    assert runner.invoke(main, arguments).exit_code == 1


def test_the_page_is_what_the_command_writes():
    """The shares are simulated again in full.

    Of the rest, statistics.csv must have a row with the settings of today.
    """
    checks = validate_statistics.read_checks(PAGE.with_suffix(".csv"))
    described = [(check.event, check.setting, check.target) for check in checks]
    assert described == [
        (group.event, group.setting_text.format(*setting), group.target)
        for group in GROUPS.values()
        for setting in group.settings
    ]
    assert not any(check.conclusion == "missed" for check in checks)
    assert list(run_checks(groups=[GROUPS["share"]])) == checks[:8]
    page = render_page(checks, 0, PAGE.with_name("ranking.json"))
    assert page == PAGE.read_text("utf-8")


def test_a_summary_has_the_range_and_the_worst_conclusion(tmp_path):
    checks = [
        Check("a", "x", 1000, (0.95, 0.96), (0.93, 0.97)),
        Check("a", "y", 1000, (0.92, 0.93), (0.93, 0.97)),
        Check("b", "x", 1000, (0.0, 0.0), (0.0, 0.06)),
    ]
    rows = validate_statistics.summarize(checks, 3).splitlines()[2:]
    assert rows == [
        "| a | 2 | 92.0 to 95.0 | 93.0 to 96.0 | 93 to 97 | met within chance |",
        "| b | 1 | 0.0 to 0.0 | 0.0 to 0.0 | 0 to 6 | met |",
    ]
    path = tmp_path / "checks.csv"
    validate_statistics.write_checks(path, checks, 3)
    assert validate_statistics.read_checks(path) == checks
    assert "share_seed_3,share_seed_4" in path.read_text()
