"""Measured over predicted difficulty: the line, its interval, and the page."""

import csv
import json
from dataclasses import replace

import numpy as np
import pytest
from refusals import refused

from barn_eval.api.front import run
from barn_eval.pages.report.page import build_report
from barn_eval.running.judge import JudgeOptions, judge
from barn_eval.studies.physical import fit_line, measure_difficulty

WORLDS = "0,50,150,250,290"
LAB = JudgeOptions(planner="gap", system="jackal 42", pose="/odom", contact="none")


def test_the_line_is_that_of_least_squares():
    x = np.array([2.0, 2.5, 3.0, 4.0, 6.0])
    y = np.array([2.1, 2.9, 2.6, 4.4, 5.5])
    line = fit_line(x, y)
    slope, intercept = np.polyfit(x, y, 1)
    assert line.slope.estimate == pytest.approx(slope)
    assert line.intercept.estimate == pytest.approx(intercept)
    assert line.slope.low < slope < line.slope.high


def test_points_on_a_line_leave_no_doubt():
    x = np.array([1.0, 2.0, 4.0])
    line = fit_line(x, 0.5 * x + 1.0)
    assert (line.slope.low, line.slope.high) == pytest.approx((0.5, 0.5))


@pytest.mark.parametrize("worlds", [5, 20])
@pytest.mark.parametrize("grows", [False, True])
def test_intervals_cover_the_true_slope(worlds, grows):
    # Also where the scatter grows with the difficulty, as failures make it.
    rng = np.random.default_rng(3)
    runs = 1500
    covered = 0
    for _ in range(runs):
        x = np.exp(rng.normal(1.15, 0.25, worlds))
        noise = rng.normal(0.0, 0.6, worlds)
        if grows:
            noise = rng.normal(0.0, 0.2, worlds) * x
        slope = fit_line(x, 0.96 * x + noise).slope
        covered += slope.low <= 0.96 <= slope.high
    assert covered / runs >= 0.93


def test_equal_worlds_have_no_line():
    with refused("three worlds that differ in difficulty"):
        fit_line(np.ones(5), np.arange(5.0))


@pytest.fixture(scope="module")
def folders(tmp_path_factory):
    """Trials of the suite, and the same judged from their bags by odometry."""
    folder = tmp_path_factory.mktemp("physical")
    results = run(WORLDS, planners="gap", bags="all", out=folder / "sim", workers=1)
    bags = [results.folder / "bags" / row.trial_id for row in results.trials]
    judge(bags, folder / "lab", LAB)
    return folder / "lab", folder / "sim"


def test_measured_and_simulated_stand_side_by_side(folders):
    finding = measure_difficulty(folders)
    assert (finding.system, finding.trials) == ("jackal 42", 5)
    predicted_s_per_m = [world.predicted_s_per_m for world in finding.worlds]
    assert predicted_s_per_m == sorted(predicted_s_per_m)
    # One simulated trial each, of which the bag is.
    for world in finding.worlds:
        assert world.simulated_s_per_m == pytest.approx(
            world.measured_s_per_m, rel=0.02
        )
    assert finding.simulated_line.slope.estimate == pytest.approx(1.0, abs=0.02)
    # One trial per world says nothing of the noise of trials.
    assert finding.noise_share is None
    widths = list(finding.half_widths.values())
    assert widths == sorted(widths, reverse=True)


def test_the_page_has_the_worlds_and_the_line(folders, tmp_path, succeed):
    lab, sim = folders
    succeed(f"reproduce --physical {lab} {sim} --out {tmp_path}")
    page = (tmp_path / "physical.md").read_text()
    assert "5 trials of gap in 5 worlds, in the system `jackal 42`" in page
    assert "| published: 50 trials in 5 worlds (Fig. 8) | 0.96 |" in page
    finding = json.loads((tmp_path / "physical.json").read_text())
    assert len(finding["worlds"]) == 5
    assert (tmp_path / "figures" / "physical.png").stat().st_size > 10_000


def test_a_report_sets_measured_beside_simulated_trials(folders, tmp_path, succeed):
    lab, sim = folders
    succeed(f"report {lab} {sim} --out {tmp_path}/both.html")
    lines = (tmp_path / "both_assets/simulated.csv").read_text().splitlines()
    rows = list(csv.DictReader(lines))
    assert [row["world"] for row in rows] == [*WORLDS.split(","), "mean of 5"]
    for row in rows[:-1]:
        difference_s = float(row["measured [s]"]) - float(row["simulated [s]"])
        assert abs(difference_s) < 0.11
        assert float(row["measured - simulated [s]"]) == pytest.approx(difference_s)
    page = (tmp_path / "both.html").read_text()
    assert "observed, not driven again" in page
    # Only the measured trials are ranked, drawn and listed.
    assert "5 trials of 1 planner" in page
    assert len((tmp_path / "both_assets/headline.csv").read_text().splitlines()) == 2


def test_trials_with_nothing_in_common_do_not_stand_side_by_side(folders, tmp_path):
    _, sim = folders
    bags = [sim / "bags" / "gap_w0050_r00"]
    judge(bags, tmp_path / "other", replace(LAB, planner="other"))
    with refused("no planner with trials in the same world"):
        build_report([tmp_path / "other", sim])
    judge(bags, tmp_path / "older", replace(LAB, protocol="challenge_2022"))
    with refused("protocols: challenge, challenge_2022"):
        build_report([tmp_path / "older", sim])


def test_simulated_trials_alone_are_named_as_such(folders):
    finding = measure_difficulty(folders[1:])
    assert "none were measured outside" in finding.notes[0]


def test_too_few_worlds_are_refused(folders, tmp_path, rejected):
    lab, sim = folders
    judge([sim / "bags" / "gap_w0050_r00"], tmp_path / "few", LAB)
    with refused("at least 4 are needed"):
        measure_difficulty([tmp_path / "few"])
    assert "--physical and FOLDERS" in rejected(f"reproduce {lab}", 2)
