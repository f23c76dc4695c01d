"""Statistics against published numbers, plain references and simulated coverage."""

import math
from functools import partial

import numpy as np
import pytest
from scipy import stats

from barn_eval.analysis import statistics
from barn_eval.analysis.statistics import (
    mean_over_trials,
    paired,
    rank_correlation,
    ratio_of_means,
    repetition_spread,
)
from barn_metrics.bootstrap import RESAMPLES, Interval, over_worlds


def plain_cluster_bca(values, worlds, seed, level=0.95, resamples=RESAMPLES):
    """The interval written out: draw worlds, pool their trials, correct bias and skew by leaving out worlds."""
    groups = [values[worlds == world] for world in sorted(set(worlds.tolist()))]
    draw = np.random.default_rng(seed)
    means = [
        np.concatenate([groups[i] for i in draw.integers(0, len(groups), len(groups))]).mean() for _ in range(resamples)
    ]
    estimate = values.mean()
    bias = stats.norm.ppf(np.mean(np.array(means) < estimate) + 0.5 * np.mean(np.array(means) == estimate))
    left_out = np.array([np.concatenate(groups[:i] + groups[i + 1 :]).mean() for i in range(len(groups))])
    deviation = left_out.mean() - left_out
    skew = (deviation**3).sum() / (6.0 * (deviation**2).sum() ** 1.5)
    z = stats.norm.ppf([(1 - level) / 2, (1 + level) / 2])
    return np.quantile(means, stats.norm.cdf(bias + (bias + z) / (1 - skew * (bias + z))))


def trials_of(worlds=20, repetitions=5, seed=1, within=1.0, between=3.0):
    draw = np.random.default_rng(seed)
    world = np.repeat(np.arange(worlds), repetitions)
    values = 20.0 + np.repeat(draw.gamma(1.0, between, worlds), repetitions) + draw.normal(0, within, len(world))
    return values, world, np.tile(np.arange(repetitions), worlds)


def test_cluster_bootstrap_agrees_with_the_plain_reference():
    values, worlds, _ = trials_of()
    found = mean_over_trials(values, worlds, seed=3)
    assert found.estimate == pytest.approx(values.mean(), rel=1e-12)
    assert (found.low, found.high) == pytest.approx(tuple(plain_cluster_bca(values, worlds, seed=3)), rel=1e-9)


def test_interval_resamples_worlds_and_not_trials():
    values, worlds, _ = trials_of(within=0.01)
    clustered = mean_over_trials(values, worlds)
    each_alone = mean_over_trials(values, np.arange(len(values)))
    assert clustered.high - clustered.low > 1.8 * (each_alone.high - each_alone.low)
    once = mean_over_trials(values[::5], worlds[::5])
    assert clustered.high - clustered.low == pytest.approx(once.high - once.low, rel=0.05)


def test_interval_covers_the_truth_as_often_as_it_says(monkeypatch):
    monkeypatch.setattr(statistics, "over_worlds", partial(over_worlds, resamples=400))
    truth = 20.0 + 3.0
    covered = 0
    for seed in range(200):
        values, worlds, _ = trials_of(worlds=40, repetitions=3, seed=seed)
        found = mean_over_trials(values, worlds, seed=seed)
        covered += found.low <= truth <= found.high
    assert 0.89 <= covered / 200 <= 0.99


def test_order_of_trials_changes_no_bit():
    values, worlds, _ = trials_of()
    shuffled = np.random.default_rng(0).permutation(len(values))
    assert mean_over_trials(values, worlds, seed=1) == mean_over_trials(values[shuffled], worlds[shuffled], seed=1)
    assert repetition_spread(values, worlds) == repetition_spread(values[shuffled], worlds[shuffled])


def test_unbalanced_worlds_are_weighted_by_their_trials_and_nan_has_no_part():
    values = np.array([1.0, 2.0, 3.0, 10.0, np.nan, np.nan])
    worlds = np.array([7, 7, 7, 8, 8, 9])
    found = mean_over_trials(values, worlds)
    assert found.estimate == 4.0
    assert found.low is not None
    assert 2.0 <= found.low <= found.high <= 10.0


@pytest.mark.parametrize("values", [[], [np.nan]])
def test_mean_of_nothing_is_nan_without_limits(values):
    found = mean_over_trials(np.array(values, float), np.zeros(len(values), np.int64))
    assert math.isnan(found.estimate)
    assert (found.low, found.high) == (None, None)


def test_one_world_has_an_estimate_without_limits_and_equal_worlds_have_no_width():
    assert mean_over_trials(np.array([1.0, 3.0]), np.array([4, 4])) == Interval(2.0)
    assert mean_over_trials(np.ones(6), np.arange(6) // 2) == Interval(1.0, 1.0, 1.0)


def test_repetition_spread_is_the_papers():
    values = np.array([1.0, 3.0, 10.0, 10.0, 5.0])
    worlds = np.array([0, 0, 1, 1, 2])
    assert repetition_spread(values, worlds) == 0.5
    assert math.isnan(repetition_spread(values[-1:], worlds[-1:]))


def test_paired_comparison_removes_what_the_worlds_share():
    values, worlds, repetitions = trials_of(worlds=30)
    shift = np.random.default_rng(5).normal(-1.0, 0.1, len(values))
    found = paired((values + shift, worlds, repetitions), (values, worlds, repetitions), larger_is_better=False)
    assert (found.worlds, found.trials) == (30, 150)
    assert found.difference.estimate == pytest.approx(shift.mean(), rel=1e-9)
    assert -1.1 < found.difference.low < found.difference.high < -0.9
    assert found.improvement.estimate > 0.5


def test_probability_of_improvement_equals_the_mann_whitney_statistic():
    draw = np.random.default_rng(6)
    worlds = np.repeat(np.arange(8), 6)
    repetitions = np.tile(np.arange(6), 8)
    a, b = draw.integers(0, 5, 48).astype(float), draw.integers(1, 6, 48).astype(float)
    found = paired((a, worlds, repetitions), (b, worlds, repetitions), larger_is_better=True)
    chances = [stats.mannwhitneyu(a[worlds == w], b[worlds == w]).statistic / 36.0 for w in range(8)]
    assert found.improvement.estimate == pytest.approx(np.mean(chances), rel=1e-12)
    other = paired((b, worlds, repetitions), (a, worlds, repetitions), larger_is_better=True)
    assert other.improvement.estimate == pytest.approx(1.0 - np.mean(chances), rel=1e-12)


def test_only_shared_worlds_and_repetitions_are_compared():
    a = (np.array([1.0, 2.0, 50.0]), np.array([0, 1, 2]), np.array([0, 0, 0]))
    b = (np.array([4.0, 4.0, 60.0]), np.array([0, 1, 2]), np.array([0, 0, 1]))
    found = paired(a, b, larger_is_better=False)
    assert (found.worlds, found.trials) == (2, 2)
    assert found.difference.estimate == -2.5
    assert found.improvement.estimate == 1.0
    none = paired(a, (b[0], b[1] + 100, b[2]), larger_is_better=False)
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
    planner, other = (values, worlds, repetitions), (values[::-1].copy(), worlds, repetitions)
    figures = {
        "mean": partial(mean_over_trials, values, worlds),
        "ratio": partial(ratio_of_means, values[:20], values[20:40]),
        "correlation": partial(rank_correlation, planner[:2], other[:2]),
        "paired": partial(paired, planner, other, larger_is_better=True),
    }
    assert {name: find() == find(seed=0) != find(seed=1) for name, find in figures.items()} == dict.fromkeys(
        figures, True
    )


def test_paired_comparison_gives_the_mean_of_each_over_the_pairs():
    worlds, repetitions = np.array([0, 1, 2, 3]), np.zeros(4, np.int64)
    a, b = np.array([1.0, 2.0, 6.0, 90.0]), np.array([10.0, 11.0, 15.0, np.nan])
    found = paired((a, worlds, repetitions), (b, worlds, repetitions), larger_is_better=False)
    assert (found.worlds, found.trials, found.mean_a, found.mean_b) == (3, 3, 3.0, 12.0)


def test_planners_without_a_common_trial_have_no_figures():
    one, other = ((np.array([1.0]), np.array([world]), np.array([0])) for world in (1, 2))
    found = paired(one, other, larger_is_better=True)
    assert (found.worlds, found.trials) == (0, 0)
    figures = (found.mean_a, found.mean_b, found.difference.estimate, found.improvement.estimate)
    assert np.isnan(figures).all()


def test_an_improvement_however_small_counts_whole():
    worlds, repetitions = np.arange(3), np.zeros(3, np.int64)
    a, b = np.array([1.0, 1.0, 1.0]), np.array([0.999, 1.0, 1.001])
    found = paired((a, worlds, repetitions), (b, worlds, repetitions), larger_is_better=True)
    assert found.improvement.estimate == pytest.approx((1.0 + 0.5 + 0.0) / 3.0)


def test_columns_of_unequal_length_are_refused():
    whole, short = (np.arange(3.0), np.arange(3), np.arange(3)), (np.arange(3.0), np.arange(3), np.arange(2))
    with pytest.raises(ValueError, match="shorter"):
        paired(whole, short, larger_is_better=True)


def test_rank_correlation_uses_the_worlds_that_both_have_done():
    a = (np.array([1.0, 2.0, 3.0, 9.0, np.nan]), np.array([0, 1, 2, 7, 4]))
    b = (np.array([10.0, 30.0, 20.0, 0.0, 5.0]), np.array([0, 1, 2, 8, 4]))
    assert rank_correlation(a, b).estimate == pytest.approx(0.5)
    two_worlds = rank_correlation((a[0][:2], a[1][:2]), b)
    assert math.isnan(two_worlds.estimate)


def test_rank_correlation_is_of_means_whatever_the_number_of_trials():
    a = (np.array([1.0, 1.0, 1.0, 2.0, 3.0]), np.array([0, 0, 0, 1, 2]))
    b = (np.array([1.0, 2.0, 3.0]), np.array([0, 1, 2]))
    assert rank_correlation(a, b).estimate == pytest.approx(1.0)


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


def test_ratio_of_nothing_is_nan_without_limits():
    found = ratio_of_means(np.empty(0), np.empty(0))
    assert math.isnan(found.estimate)
    assert (found.low, found.high) == (None, None)


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
    assert mean_over_trials(dwa, worlds).low < 3.30 < mean_over_trials(dwa, worlds).high
    assert mean_over_trials(eband, worlds).low < 3.24 < mean_over_trials(eband, worlds).high
    assert repetition_spread(eband, worlds) == pytest.approx(0.38, abs=0.02)
