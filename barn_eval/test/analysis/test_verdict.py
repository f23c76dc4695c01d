"""Ranks and verdicts.

Planners that cannot be told apart share a rank, and sentences say what the numbers say.
"""

import re
from dataclasses import replace

import numpy as np
import pytest
from analysis.test_compare import results, scored
from refusals import refused

from barn_eval.analysis.compare import adjust_by_holm, compare
from barn_eval.analysis.entries import Entry
from barn_eval.analysis.measures import MEASURES
from barn_eval.analysis.notes import find_mixture
from barn_eval.analysis.significance import paired_difference
from barn_eval.analysis.sources import Source
from barn_eval.analysis.statistics import TrialValues
from barn_eval.analysis.verdict import (
    conclude_comparison,
    conclude_ranking,
    conclude_results,
    list_cautions,
    rank,
    rank_results,
)

TIME = MEASURES["normalised_time_s_per_m"]


def planner(offset, seed, worlds=30, noise=1.0):
    """Values, worlds and repetitions of a planner.

    Worlds are the same for all, the noise is its own.
    """
    world = np.repeat(np.arange(worlds), 2)
    shared = np.random.default_rng(99).normal(0.0, 5.0, worlds)[world]
    means = np.random.default_rng(seed).normal(offset, noise, len(world))
    return TrialValues(shared + means, world, np.tile([0, 1], worlds))


def timed(name, values, worlds):
    """Results of a planner with these times per meter, one trial in each world."""
    firsts = (row for row in results(name, worlds=worlds) if row.repetition == 0)
    return tuple(
        scored(row, normalised_time_s_per_m=float(value))
        for row, value in zip(firsts, values, strict=True)
    )


def by_time(planners):
    """Rank planners by a measure of which less is better."""
    return rank(planners, larger_is_better=False)


def test_clear_differences_make_ranks_in_the_order_of_the_means():
    slow, quick, middle = planner(9.0, 1), planner(0.0, 2), planner(4.0, 3)
    ranking = by_time({"slow": slow, "quick": quick, "middle": middle})
    assert ranking.names == ["quick", "middle", "slow"]
    assert (ranking.ranks, ranking.leaders) == ((1, 2, 3), (0,))
    difference = ranking.differences[0, 2].interval.estimate
    assert difference == pytest.approx(ranking.means[0] - ranking.means[2])
    ranking = rank({"low": quick, "high": slow}, larger_is_better=True)
    assert (ranking.names, ranking.ranks) == (["high", "low"], (1, 2))


def test_two_clear_tests_may_be_open_after_holm():
    a = planner(0.0, 1)
    b = replace(a, values=a.values + 0.24 + np.repeat(np.linspace(-1.0, 1.0, 30), 2))
    alone = by_time({"a": a, "b": b})
    assert alone.p[0, 1] <= 0.05 < 3.0 * alone.p[0, 1]
    beside = by_time({"a": a, "b": b, "c": a})
    assert beside.pair_count == 3
    assert not any(beside.is_clear(*places) for places in beside.p)
    assert beside.ranks == (1, 1, 1)


def test_a_chain_shares_a_rank_though_its_ends_differ():
    """The middle one cannot be told from either end, so that no rank may part it from
    them.
    """
    a = planner(0.0, 1)
    noise = np.random.default_rng(5).normal(0.0, 4.0, len(a.values))
    b = replace(a, values=a.values + 0.6 + noise - noise.mean())
    c = replace(a, values=a.values + 1.2)
    ranking = by_time({"a": a, "b": b, "c": c})
    assert ranking.names == ["a", "b", "c"]
    assert (ranking.ranks, ranking.leaders) == ((1, 1, 1), (0, 1))
    assert ranking.is_clear(0, 2)
    assert not ranking.is_clear(0, 1)
    assert not ranking.is_clear(1, 2)


def test_nobody_is_ahead_where_all_means_are_equal():
    ranking = by_time({name: planner(0.0, 1) for name in ("a", "b", "c")})
    text = str(conclude_ranking(ranking, TIME))
    assert text.startswith("a, b and c have the same time per meter as counted, ")
    assert "30 worlds" in text
    assert "first" not in text


def test_what_reads_alike_is_no_lead():
    """A difference below the last digit, and one planner that is truly behind."""
    a = planner(0.0, 1)
    b = replace(a, values=a.values + np.where(a.worlds % 2, 1e-4, -0.9e-4))
    noise = np.random.default_rng(3).normal(0.3, 2.0, len(a.values))
    ranking = by_time({"a": a, "b": b, "c": replace(a, values=a.values + noise)})
    short = conclude_ranking(ranking, TIME).short
    lead = r"[ab] and [ab] have the same .*; their lead over c is not significant"
    assert re.match(lead, short)


def test_ranks_are_of_the_trials_that_all_have():
    a = planner(0.0, 1)
    b = planner(3.0, 2)
    spoilt = replace(b, values=np.where(b.worlds == 7, np.nan, b.values))
    ranking = by_time({"a": a, "b": spoilt})
    assert (ranking.worlds, ranking.trials) == (29, 58)
    rest = a.worlds != 7
    assert ranking.means[0] == pytest.approx(a.values[rest].mean())
    expected = paired_difference((a.values - b.values)[rest], a.worlds[rest])
    assert ranking.differences[0, 1].p == expected.p


def test_even_a_big_board_can_find_a_difference():
    """Of 33 planners the smallest p-value, times 528 pairs, is still below 5%."""
    planners = {
        f"p{number:02}": planner(0.0, number, worlds=20) for number in range(32)
    }
    ranking = by_time(planners | {"winner": planner(-50.0, 33, worlds=20)})
    assert ranking.names[0] == "winner"
    assert ranking.is_clear(0, 1)
    assert ranking.ranks[:2] == (1, 2)


def sentence(offset, worlds=20, **options):
    """The verdict on A, and on B that is so much slower."""
    a = planner(10.0, 1, worlds)
    b = planner(10.0 + offset, 2, worlds)
    return str(conclude_ranking(by_time({"A": a, "B": b} | options), TIME))


def test_a_conclusion_states_size_interval_p_and_counts():
    text = sentence(5.0)
    a = planner(10.0, 1, 20)
    b = planner(15.0, 2, 20)
    interval = paired_difference(b.values - a.values, a.worlds).interval
    mean = f"{a.values.mean():.3f} s/m"
    assert text.startswith(
        f"A is better than B (p < 0.001, 20 worlds): time per meter as counted {mean}"
    )
    limits = f"[{interval.low:.3f}, {interval.high:.3f}]"
    assert f"The difference is {interval.estimate:.3f} {limits} s/m" in text
    share = f"{100.0 * interval.estimate / b.values.mean():.1f}%"
    assert f"or {share} of B's (40 pairs of trials)." in text


def test_an_open_conclusion_says_how_many_worlds_to_add():
    text = sentence(0.05)
    lead = (
        r"([AB]) ranks first; its lead over [AB] is not significant \(p = 0\.\d+, 20 w"
    )
    assert re.match(lead, text)
    needs = r"in 8 of 10 runs, about (\d+) worlds with 2 trials each would be needed"
    assert int(re.search(needs, text)[1]) > 20
    limit = "With fewer than 6 worlds, no difference can be significant"
    assert limit in sentence(5.0, worlds=5)
    for worlds, words in ((30, "The means are equal"), (5, limit)):
        same = planner(0.0, 1, worlds)
        ranking = by_time({"A": same, "B": same})
        assert words in conclude_ranking(ranking, TIME).details


def test_conclusions_name_the_leader_or_the_group():
    text = sentence(5.0, C=planner(40.0, 3, 20))
    assert text.startswith("A is better than all others (p < 0.001, 20 worlds):")
    assert "after Holm" in text
    text = sentence(0.0, C=planner(40.0, 3, 20))
    assert re.match(r"[AB] ranks first; its lead over [AB] is not significant", text)
    assert " C" not in text
    assert conclude_ranking(by_time({"A": planner(0.0, 1)}), TIME).short.startswith(
        "A is the only planner"
    )


def test_a_verdict_is_by_the_metric_of_the_protocol():
    good = results(worlds=12)
    worse = [scored(row, challenge=0.0) for row in results("eband", worlds=12)]
    paper = conclude_results({"DWA": good, "E-Band": worse}).short
    assert paper.startswith("DWA and E-Band have the same time per meter as")
    good = [replace(row, protocol="challenge") for row in good]
    worse = [replace(row, protocol="challenge") for row in worse]
    challenge = conclude_results({"DWA": good, "E-Band": worse}).short
    assert re.match(r"DWA is better than E-Band \(.*\): challenge metric", challenge)


def test_the_conclusion_on_a_pair_is_symmetric():
    a = results()
    b = [replace(row, planner="eband") for row in results("eband", slower_s=5.0)]
    first = conclude_comparison(compare(a, b))
    second = conclude_comparison(compare(b, a))
    assert first == second
    assert first.short.startswith("DWA is better than E-Band")
    assert conclude_results({"DWA": a, "E-Band": b}) == first
    # Of three planners, a pair does not show which ranks first.
    close = compare(results(worlds=4), results("eband", 1.0, worlds=4))
    text = conclude_comparison(replace(close, pairs=3)).short
    assert text.startswith("The lead of DWA over E-Band is not significant (p = 0.9")


def test_pairs_that_are_shown_together_are_corrected_together():
    a = results()
    b = results("eband", slower_s=1.0)
    c = results("gap", slower_s=2.0)
    alone = compare(a, b)
    row = alone.row("scored_time_s")
    assert (alone.pairs, row.p_holm) == (1, row.paired.p)
    comparisons = adjust_by_holm([alone, compare(a, c), compare(b, c)])
    assert {comparison.pairs for comparison in comparisons} == {3}
    rows = [comparison.row("scored_time_s") for comparison in comparisons]
    smallest = min(row.paired.p for row in rows)
    assert min(row.p_holm for row in rows) == pytest.approx(3.0 * smallest)


def test_what_is_not_the_same_task_is_not_ranked():
    other = [replace(row, world_checksum="ff") for row in results("eband")]
    with refused(
        r"DWA and E-Band cannot be ranked against each other: .* have different"
    ):
        rank_results({"DWA": results(), "E-Band": other}, TIME)


def test_few_worlds_and_unfinished_folders_are_told(tmp_path):
    rows = tuple(results(worlds=2))
    source = Source(tmp_path, "run", rows, {}, (), 20)
    entry = Entry("DWA", "", source, "dwa", rows)
    assert list_cautions(10) == []
    few, partial = list_cautions(9, [entry])
    assert few.startswith("Only 9 worlds")
    assert partial == f"{tmp_path} is partial: 6 of 20 trials"
    for planned in (6, None):
        whole = replace(entry, source=replace(source, planned=planned))
        assert list_cautions(10, [whole]) == []


def test_what_is_compared_across_classes_or_commits_is_named(tmp_path):
    slow = tuple(replace(row, speed_cap_mps=0.5) for row in results(worlds=2))
    fast = tuple(replace(row, speed_cap_mps=0.9) for row in slow)
    old = Source(tmp_path / "a", "run", slow, {}, ({"commit": "1" * 40},), None)
    new = replace(
        old, path=tmp_path / "b", sessions=({"commit": f"{'1' * 40}+changes"},)
    )
    entries = [Entry("A", "", old, "dwa", slow), Entry("B", "", new, "dwa", fast)]
    assert list(find_mixture(entries[:1])) == []
    classes, commits = find_mixture(entries)
    assert classes.endswith("rank separately: A up to 0.5 m/s; B up to 1 m/s.")
    assert (
        commits
        == f"Commits differ: {'1' * 8} in {old.path}, {'1' * 8}+changes in {new.path}."
    )


def test_a_set_that_is_too_small_to_tell_is_said_to_be():
    a = planner(10.0, 1, 20)
    b = planner(10.05, 2, 20)
    ranking = replace(by_time({"A": a, "B": b}), available=21)
    words = (
        "The 21 worlds of this set cannot show such a difference: it would take about"
    )
    assert words in conclude_ranking(ranking, TIME).details
