"""Statistics against published numbers, plain references and simulated coverage."""

import math
from dataclasses import replace
from functools import partial

import numpy as np
import pytest
from scipy import stats

from barn_eval.analysis import statistics
from barn_eval.analysis.statistics import (
    Columns,
    mean_interval,
    paired,
    rank_correlation,
    repetition_spread,
)
from barn_metrics.bootstrap import Interval, over_worlds


def trials_of(worlds=20, repetitions=5, seed=1, within=1.0, between=3.0):
    draw = np.random.default_rng(seed)
    world = np.repeat(np.arange(worlds), repetitions)
    values = 20.0 + np.repeat(draw.gamma(1.0, between, worlds), repetitions) + draw.normal(0, within, len(world))
    return values, world, np.tile(np.arange(repetitions), worlds)


def test_order_of_trials_changes_no_bit():
    values, worlds, repetitions = trials_of()
    shuffled = np.random.default_rng(0).permutation(len(values))
    assert Columns(values, worlds, repetitions).mean() == Columns(values, worlds, repetitions).at(shuffled).mean()
    assert repetition_spread(values, worlds) == repetition_spread(values[shuffled], worlds[shuffled])


def test_unbalanced_worlds_are_weighted_by_their_trials_and_nan_has_no_part():
    values = np.array([1.0, 2.0, 3.0, 10.0, np.nan, np.nan])
    worlds = np.array([7, 7, 7, 8, 8, 9])
    found = Columns(values, worlds, np.zeros(6, np.int64)).mean()
    assert found.estimate == 4.0
    assert found.low == 0.0  # what two worlds say is little, but no value is below 0
    assert found.high > 10.0


def test_one_world_has_an_estimate_without_limits_and_equal_worlds_have_no_width():
    assert mean_interval(np.array([1.0, 3.0]), np.array([4, 4])) == Interval(2.0)
    assert mean_interval(np.ones(6), np.arange(6) // 2) == Interval(1.0, 1.0, 1.0)


def test_repetition_spread_is_the_papers():
    values = np.array([1.0, 3.0, 10.0, 10.0, 5.0])
    worlds = np.array([0, 0, 1, 1, 2])
    assert repetition_spread(values, worlds) == 0.5
    assert math.isnan(repetition_spread(values[-1:], worlds[-1:]))


def test_paired_comparison_removes_what_the_worlds_share():
    values, worlds, repetitions = trials_of(worlds=30)
    shift = np.random.default_rng(5).normal(-1.0, 0.1, len(values))
    found = paired(
        Columns(values + shift, worlds, repetitions), Columns(values, worlds, repetitions), larger_is_better=False
    )
    assert (found.worlds, found.trials) == (30, 150)
    assert found.difference.estimate == pytest.approx(shift.mean(), rel=1e-9)
    assert -1.1 < found.difference.low < found.difference.high < -0.9
    assert found.improvement.estimate > 0.5


def test_probability_of_improvement_equals_the_mann_whitney_statistic():
    draw = np.random.default_rng(6)
    worlds = np.repeat(np.arange(8), 6)
    repetitions = np.tile(np.arange(6), 8)
    a, b = draw.integers(0, 5, 48).astype(float), draw.integers(1, 6, 48).astype(float)
    found = paired(Columns(a, worlds, repetitions), Columns(b, worlds, repetitions), larger_is_better=True)
    chances = [stats.mannwhitneyu(a[worlds == w], b[worlds == w]).statistic / 36.0 for w in range(8)]
    assert found.improvement.estimate == pytest.approx(np.mean(chances), rel=1e-12)
    other = paired(Columns(b, worlds, repetitions), Columns(a, worlds, repetitions), larger_is_better=True)
    assert other.improvement.estimate == pytest.approx(1.0 - np.mean(chances), rel=1e-12)


def test_only_shared_worlds_and_repetitions_are_compared():
    a = Columns(np.array([1.0, 2.0, 50.0]), np.array([0, 1, 2]), np.array([0, 0, 0]))
    b = Columns(np.array([4.0, 4.0, 60.0]), np.array([0, 1, 2]), np.array([0, 0, 1]))
    found = paired(a, b, larger_is_better=False)
    assert (found.worlds, found.trials) == (2, 2)
    assert found.difference.estimate == -2.5
    assert found.improvement.estimate == 1.0
    none = paired(a, replace(b, worlds=b.worlds + 100), larger_is_better=False)
    assert none.trials == 0
    assert math.isnan(none.difference.estimate)


def test_rank_correlation_is_spearmans_over_world_means():
    values, worlds, _ = trials_of(worlds=25, within=2.0)
    other = values + np.random.default_rng(8).normal(0, 2.0, len(values))
    found = rank_correlation((values, worlds), (other, worlds), seed=1)
    means = [[part[worlds == w].mean() for w in range(25)] for part in (values, other)]
    assert found.estimate == pytest.approx(stats.spearmanr(*means).statistic, rel=1e-12)
    assert found.low < found.estimate < found.high <= 1.0
    assert math.isnan(rank_correlation((values[:5], worlds[:5]), (other[:5], worlds[:5])).estimate)


def test_intervals_are_drawn_with_seed_0_unless_told_otherwise():
    values, worlds, repetitions = trials_of()
    planner, other = Columns(values, worlds, repetitions), Columns(values[::-1].copy(), worlds, repetitions)
    figures = {
        "correlation": partial(rank_correlation, (planner.values, worlds), (other.values, worlds)),
        "paired": partial(paired, planner, other, larger_is_better=True),
    }
    assert {name: find() == find(seed=0) != find(seed=1) for name, find in figures.items()} == dict.fromkeys(
        figures, True
    )


def test_paired_comparison_gives_the_mean_of_each_over_the_pairs():
    worlds, repetitions = np.array([0, 1, 2, 3]), np.zeros(4, np.int64)
    a, b = np.array([1.0, 2.0, 6.0, 90.0]), np.array([10.0, 11.0, 15.0, np.nan])
    found = paired(Columns(a, worlds, repetitions), Columns(b, worlds, repetitions), larger_is_better=False)
    assert (found.worlds, found.trials, found.mean_a, found.mean_b) == (3, 3, 3.0, 12.0)


def test_an_improvement_however_small_counts_whole():
    worlds, repetitions = np.arange(3), np.zeros(3, np.int64)
    a, b = np.array([1.0, 1.0, 1.0]), np.array([0.999, 1.0, 1.001])
    found = paired(Columns(a, worlds, repetitions), Columns(b, worlds, repetitions), larger_is_better=True)
    assert found.improvement.estimate == pytest.approx((1.0 + 0.5 + 0.0) / 3.0)


def test_columns_of_unequal_length_are_refused():
    whole = Columns(np.arange(3.0), np.arange(3), np.arange(3))
    short = replace(whole, repetitions=np.arange(2))
    with pytest.raises(ValueError, match="shorter"):
        paired(whole, short, larger_is_better=True)


def test_rank_correlation_uses_the_worlds_that_both_have_done():
    a = (np.array([1.0, 2.0, 3.0, 9.0, np.nan]), np.array([0, 1, 2, 7, 4]))
    b = (np.array([10.0, 30.0, 20.0, 0.0, 5.0]), np.array([0, 1, 2, 8, 4]))
    assert rank_correlation(a, b).estimate == pytest.approx(0.5)
    two_worlds = rank_correlation((a[0][:2], a[1][:2]), b)
    assert math.isnan(two_worlds.estimate)


def test_rank_correlation_and_its_interval_are_scipys_with_ties_too(monkeypatch):
    monkeypatch.setattr(statistics, "over_worlds", partial(over_worlds, resamples=200))
    draw = np.random.default_rng(9)
    worlds = np.arange(12)
    x, y = draw.integers(0, 3, 12).astype(float), draw.integers(0, 8, 12).astype(float)
    found = rank_correlation((x, worlds), (y, worlds), seed=2)

    def spearman(drawn):
        each = [stats.spearmanr(x[row], y[row]).statistic for row in drawn.reshape(-1, drawn.shape[-1])]
        return np.reshape(each, drawn.shape[:-1])

    plain = over_worlds(spearman, 12, seed=2, resamples=200)
    assert (found.estimate, found.low, found.high) == pytest.approx((plain.estimate, plain.low, plain.high), rel=1e-9)


def test_published_trials_give_the_known_agreement_of_planners(original):
    """The 50 shared worlds: Spearman of DWA's and E-Band's means, known to be about 0.37 over all 300 worlds."""
    table = np.genfromtxt(original / "trials.csv", delimiter=",", names=True)
    worlds = np.repeat(np.arange(len(table)), 5)
    dwa, eband = (
        np.stack([table[f"{name}_{i}"] / table["path_length_m"] for i in range(1, 6)], 1).ravel()
        for name in ("dwa", "eband")
    )
    found = rank_correlation((dwa, worlds), (eband, worlds))
    assert found.low < 0.37 < found.high
    assert mean_interval(dwa, worlds).low < 3.30 < mean_interval(dwa, worlds).high
    assert mean_interval(eband, worlds).low < 3.24 < mean_interval(eband, worlds).high
    assert repetition_spread(eband, worlds) == pytest.approx(0.38, abs=0.02)
