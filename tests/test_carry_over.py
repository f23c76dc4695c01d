"""Whether difficulty carries over from robot to robot.

The page shows what its command makes of the trials kept.
"""

from itertools import product

import carry_over as tool
import numpy as np
import pandas as pd
import pytest
from refusals import refused
from repository import DOCS
from scipy import stats


def invent_trials():
    rows = []
    drives = product(("jackal", "husky"), ("gap", "dwa"), (0, 1), range(0, 60, 6))
    for robot, planner, seed, world in drives:
        draw = np.random.default_rng([world, seed, len(robot)])
        time_s = 20.0 + world + 30.0 * draw.random() * (planner == "dwa")
        success = int(time_s < 90.0)
        rows.append((robot, planner, seed, 0, world, success, round(time_s, 3)))
    columns = ["robot", "planner", "seed", "repetition", "world", "success", "time_s"]
    return tool.Trials(pd.DataFrame(rows, columns=columns))


def test_trials_are_written_and_read_again(tmp_path):
    trials = invent_trials()
    (tmp_path / "trials.csv").write_text(tool.csv_text(trials))
    assert tool.read_trials(tmp_path / "trials.csv").table.equals(trials.table)
    assert (trials.robots, trials.planners) == (["jackal", "husky"], ["gap", "dwa"])
    assert trials.tries("husky", "dwa").shape == (2, 10)
    times = [trials.times("husky", planner) for planner in trials.planners]
    together = np.mean(times, axis=0)
    assert trials.times("husky", tool.TOGETHER) == pytest.approx(together)


def test_the_line_is_that_of_least_squares():
    x = invent_trials().times("jackal", "dwa")
    y = invent_trials().times("husky", "dwa")
    expected = stats.linregress(x, y)
    assert tool.slope(x, y) == pytest.approx(expected.slope)
    assert tool.intercept(x, y) == pytest.approx(expected.intercept)
    assert tool.determination(x, y) == pytest.approx(expected.rvalue**2)
    slopes = tool.slope(np.array([x, y]), np.array([y, x]))
    assert slopes == pytest.approx([tool.slope(x, y), tool.slope(y, x)])


def test_correlations_between_robots_and_with_themselves():
    trials = invent_trials()
    x = trials.times("jackal", "dwa")
    y = trials.times("husky", "dwa")
    first, second = trials.tries("jackal", "dwa")
    lines = tool.robots_table(trials).splitlines()
    row = next(line for line in lines if "DWA" in line).split("|")
    correlation = stats.spearmanr(x, y).statistic
    assert float(row[2].split()[0]) == pytest.approx(correlation, abs=0.006)
    once = stats.spearmanr(first, second).statistic
    twice = 2.0 * once / (1.0 + once)
    assert float(row[3].split()[0]) == pytest.approx(twice, abs=0.006)
    assert "| gap | 1.00" in tool.robots_table(trials)


def test_planners_that_did_not_drive_every_robot_are_refused():
    some = tool.Trials(
        invent_trials().table.query("robot != 'husky' or planner != 'gap'")
    )
    with refused("every planner must have driven with every robot"):
        tool.results_table(some)


def test_the_page_shows_what_its_command_makes():
    page = (DOCS / "carry_over.md").read_text("utf-8")
    trials = tool.read_trials(DOCS / "carry_over.csv")
    for title, text in tool.tables(trials).items():
        assert text in page, title
