"""Comparisons of results, and what cannot be compared."""

import json
from dataclasses import replace

import numpy as np
import pytest
from click.testing import CliRunner
from test_rows import result as a_result

from barn_eval.analysis.compare import COMPARED, compare
from barn_eval.analysis.summary import DRIVEN, SCORED, summarise_campaign
from barn_eval.commands.compare import compare_command
from barn_eval.experiments.rows import ResultRows
from barn_eval.trials.outcome import Outcome
from barn_eval.trials.result import trial_id
from barn_worlds.errors import BarnError


def results(planner="dwa", slower_s=0.0, worlds=20, seed=0):
    """Return three trials in each world, slow worlds for both planners alike."""
    draw = np.random.default_rng(seed)
    found = []
    for world in range(worlds):
        own_s = draw.uniform(10.0, 30.0)
        for repetition in range(3):
            time_s = own_s + slower_s + draw.normal(0.0, 0.5)
            one = a_result(world)
            scores = replace(
                one.scores, traversal_time_s=time_s, scored_time_s=time_s, normalised_time_s_per_m=time_s / 5.0
            )
            found.append(
                replace(
                    one,
                    trial_id=trial_id(planner, world, repetition),
                    planner=planner,
                    repetition=repetition,
                    simulator_seed=100 * world + repetition,
                    scores=scores,
                )
            )
    return found


def failed(one):
    scores = replace(one.scores, success=False, scored_time_s=50.0, challenge=0.0)
    return replace(one, outcome=Outcome.TIMEOUT, scores=scores)


def rows_of(found):
    return {row.measure: row for row in found.rows}


def test_a_difference_that_worlds_hide_is_found_by_pairs():
    found = compare(results(), results("eband", slower_s=1.0))
    row = rows_of(found)["time as counted"]
    assert row.paired.trials == 60
    assert row.paired.difference.estimate == pytest.approx(-1.0, abs=1e-9)
    assert row.paired.improvement.estimate > 0.8
    assert found.rank_correlation.estimate > 0.9
    assert [row.key for row in found.rows] == list(COMPARED)


def test_time_of_successes_needs_both_to_succeed():
    a, b = results(), results("eband")
    a[0], b[1] = failed(a[0]), failed(b[1])
    rows = rows_of(compare(a, b))
    assert rows["success"].paired.trials == 60
    assert rows["success"].paired.difference.estimate == 0.0
    assert rows["time of successes"].paired.trials == 58


def test_only_what_both_have_is_compared():
    found = compare(results()[:30], results("eband"))
    assert (found.trials_a, found.trials_b) == (30, 60)
    assert rows_of(found)["success"].paired.trials == 30


@pytest.mark.parametrize(
    ("change", "words"),
    [
        ({"protocol": "challenge"}, "have different protocols: paper, challenge"),
        ({"world_checksum": "ff"}, "have different worlds of the same number: 00, ff"),
        ({"simulator_seed": 77}, "have different simulator seeds: 0, 77"),
    ],
)
def test_what_is_not_the_same_task_is_refused(change, words):
    other = results("eband")
    with pytest.raises(BarnError, match=words):
        compare(results(), [replace(other[0], **change), *other[1:]])


def test_nothing_in_common_and_mixed_planners_are_refused():
    with pytest.raises(BarnError, match="no trial of the same world and repetition"):
        compare(results(worlds=1), [replace(one, world=5) for one in results("eband", worlds=1)])
    with pytest.raises(BarnError, match="several planners cannot be compared as one"):
        compare(results() + results("eband"), results())


def test_summary_of_a_campaign_has_each_planner_and_each_pair():
    found = summarise_campaign(results("dwa") + results("eband", 1.0) + results("gap", 2.0))
    assert [one.planner for one in found.planners] == ["dwa", "eband", "gap"]
    assert [(one.a, one.b) for one in found.comparisons] == [("dwa", "eband"), ("dwa", "gap"), ("eband", "gap")]
    dwa = found.planners[0]
    assert list(dwa.means) == [*SCORED, *DRIVEN]
    assert dwa["min_clearance_m"].estimate == pytest.approx(0.1)
    assert dwa["path_ratio"].estimate == pytest.approx(5.5 / 5.0)
    assert np.isnan(dwa["recoveries"].estimate)
    assert dwa["success"].estimate == 1.0


@pytest.fixture
def folders(tmp_path):
    dwa, eband = results(worlds=4), results("eband", 1.0, worlds=4)
    for name, content in (("a", dwa), ("b", eband), ("both", dwa + eband)):
        (tmp_path / name).mkdir()
        for one in content:
            ResultRows(tmp_path / name).append(one)
    return tmp_path


def invoke(*arguments):
    return CliRunner().invoke(compare_command, [*map(str, arguments)], catch_exceptions=False)


def test_command_compares_folders(folders):
    content = json.loads(invoke(folders / "a", folders / "b", "--json").output)
    assert [(one["a"], one["b"]) for one in content] == [("dwa", "eband")]
    assert content[0]["rows"][0]["paired"]["trials"] == 12
    content = json.loads(invoke(folders / "a", f"{folders / 'both'}:eband", "--json").output)
    assert content[0]["b"] == "eband"
    content = json.loads(invoke(folders / "both", folders / "both", "--json").output)
    assert [one["a"] for one in content] == [f"{name} ({folders / 'both'})" for name in ("DWA", "E-Band")]
    assert content[0]["rows"][0]["paired"]["difference"]["estimate"] == 0.0
    text = " ".join(invoke(folders / "a", folders / "b").output.split())
    assert "same worlds and seeds" in text


def test_command_names_what_is_missing(folders):
    with pytest.raises(BarnError, match="holds no results of a run or campaign"):
        invoke(folders, folders / "a")
    with pytest.raises(BarnError, match="has no planner 'ebnd'; did you mean 'eband'"):
        invoke(folders / "a", f"{folders / 'both'}:ebnd")
