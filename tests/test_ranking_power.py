"""How well worlds rank planners: against draws of the means, and through the command."""

import json

import numpy as np
import pytest
from analysis.test_compare import folders, results, scored  # noqa: F401 (a fixture)
from analysis.test_verdict import timed
from click.testing import CliRunner
from ranking_power import main, ranking_power, ranking_table
from refusals import refused


def test_more_worlds_rank_planners_more_reliably():
    """A planner that is better in all worlds is so in each draw; one by the mean alone in large draws."""
    times = np.random.default_rng(1).normal(4.0, 0.5, 60)
    lead = {
        "best": -3.0,
        "second": 0.0,
        "third": np.random.default_rng(2).normal(0.12, 0.3, 60),
    }
    groups = {  # a failure counts little more than a success
        name: [
            scored(trial, failure_time_s=5.0 * 4.1)
            for trial in timed(name, times + ahead, 60)
        ]
        for name, ahead in lead.items()
    }
    (pair,) = ranking_power({name: groups[name] for name in ("best", "second")})
    assert (pair.planners, pair.shares[10], pair.enough) == (("best", "second"), 1.0, 1)
    (three,) = ranking_power(groups)
    assert three.differing == (
        ("best", "second"),
        ("best", "third"),
        ("second", "third"),
    )
    assert three.shares[10] < three.shares[20] < three.shares[50]
    assert 1 < three.enough < 60
    draws = np.random.default_rng(5).integers(0, 60, (1000, 20))
    right = (lead["third"][draws].mean(axis=1) > 0.0).mean()
    assert three.shares[20] == pytest.approx(right, abs=0.05)
    cells = ranking_table([pair, three]).rows
    assert [row[-1] for row in cells] == ["1", str(three.enough)]
    with refused("unknown measure 'sucess'; did you mean 'success'"):
        ranking_power(groups, ["sucess"])
    with refused("a ranking needs two planners; there is best only"):
        ranking_power({"best": groups["best"]})


def test_planners_that_do_not_differ_have_no_right_order():
    same = {"dwa": results(), "eband": results("eband")}
    (power,) = ranking_power(same)
    assert (power.differing, power.shares, power.enough) == ((), {}, None)
    assert ranking_table([power]).rows[0][-1] == "over 20"


def invoke(*arguments):
    return CliRunner().invoke(main, [*map(str, arguments)], catch_exceptions=False)


def test_the_tool_takes_folders_and_measures(folders):  # noqa: F811 (a fixture)
    both = folders / "both"
    measures = ("--measure", "success", "--measure", "challenge")
    powers = json.loads(invoke(both, both, *measures, "--json").output)
    assert [entry["measure"] for entry in powers] == ["success", "challenge"] * 2
    assert "DWA and E-Band 0 of 1 over 4" in " ".join(invoke(both).output.split())


def test_the_tool_refuses_in_one_line(tmp_path):
    ended = invoke(tmp_path / "none")
    assert ended.exit_code == 1
    (line,) = ended.output.splitlines()
    assert line.startswith(f"Error: {tmp_path}/none")
