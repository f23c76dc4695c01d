"""Statistics against published numbers, plain references and simulated coverage."""

import math
from dataclasses import replace
from functools import partial

import numpy as np
import pytest
from scipy import stats

from barn_eval.analysis import statistics
from barn_eval.analysis.significance import (
    Share,
    paired_difference,
    share_of,
    sign_patterns,
)
from barn_eval.analysis.statistics import (
    TrialValues,
    compare_pairs,
    difference,
    matched_trials,
    mean_interval,
    rank_correlation,
    repetition_spread,
)
from barn_metrics.bootstrap import Interval, bootstrap_interval


def trials_of(worlds=20, repetitions=5):
    draw = np.random.default_rng(1)
    world = np.repeat(np.arange(worlds), repetitions)
    values = (
        20.0
        + np.repeat(draw.gamma(1.0, 3.0, worlds), repetitions)
        + draw.normal(0, 1.0, len(world))
    )
    return values, world, np.tile(np.arange(repetitions), worlds)


def test_order_of_trials_changes_no_bit():
    values, worlds, repetitions = trials_of(30, 20)
    shuffled = np.random.default_rng(0).permutation(len(values))
    assert (
        TrialValues(values, worlds, repetitions).mean()
        == TrialValues(values, worlds, repetitions).at(shuffled).mean()
    )
    for figure in (mean_interval, repetition_spread):
        assert figure(values, worlds) == figure(values[shuffled], worlds[shuffled])


def test_unbalanced_worlds_are_weighted_by_trials():
    values = np.array([1.0, 2.0, 3.0, 10.0, np.nan, np.nan])
    worlds = np.array([7, 7, 7, 8, 8, 9])
    mean = TrialValues(values, worlds, np.zeros(6, np.int64)).mean()
    assert mean.estimate == 4.0
    assert mean.low == 0.0  # what two worlds say is little, but no value is below 0
    assert mean.high > 10.0


def test_equal_worlds_have_an_interval_without_width():
    assert mean_interval(np.array([1.0, 3.0]), np.array([4, 4])) == Interval(2.0)
    assert counted([0.3, 0.2], [0, 0], [1, 1]).mean().low is None
    assert mean_interval(np.ones(6), np.arange(6) // 2) == Interval(1.0, 1.0, 1.0)


def test_repetition_spread_is_the_papers():
    values = np.array([1.0, 3.0, 10.0, 10.0, 5.0])
    worlds = np.array([0, 0, 1, 1, 2])
    assert repetition_spread(values, worlds) == 0.5
    assert math.isnan(repetition_spread(values[-1:], worlds[-1:]))


def test_paired_comparison_removes_what_the_worlds_share():
    values, worlds, repetitions = trials_of(worlds=30)
    shift = np.random.default_rng(5).normal(-1.0, 0.1, len(values))
    paired = compare_pairs(
        TrialValues(values + shift, worlds, repetitions),
        TrialValues(values, worlds, repetitions),
        larger_is_better=False,
    )
    assert (paired.worlds, paired.trials) == (30, 150)
    assert paired.difference.estimate == pytest.approx(shift.mean(), rel=1e-9)
    assert -1.1 < paired.difference.low < paired.difference.high < -0.9
    assert paired.improvement.estimate > 0.5


def test_improvement_is_the_mann_whitney_statistic():
    draw = np.random.default_rng(6)
    worlds = np.repeat(np.arange(8), 6)
    repetitions = np.tile(np.arange(6), 8)
    a = draw.integers(0, 5, 48).astype(float)
    b = draw.integers(1, 6, 48).astype(float)
    paired = compare_pairs(
        TrialValues(a, worlds, repetitions),
        TrialValues(b, worlds, repetitions),
        larger_is_better=True,
    )
    chances = [
        stats.mannwhitneyu(a[worlds == w], b[worlds == w]).statistic / 36.0
        for w in range(8)
    ]
    assert paired.improvement.estimate == pytest.approx(np.mean(chances), rel=1e-12)
    other = compare_pairs(
        TrialValues(b, worlds, repetitions),
        TrialValues(a, worlds, repetitions),
        larger_is_better=True,
    )
    assert other.improvement.estimate == pytest.approx(
        1.0 - np.mean(chances), rel=1e-12
    )


def test_only_shared_worlds_and_repetitions_are_compared():
    a = TrialValues(
        np.array([1.0, 2.0, 50.0]), np.array([0, 1, 2]), np.array([0, 0, 0])
    )
    b = TrialValues(
        np.array([4.0, 4.0, 60.0]), np.array([0, 1, 2]), np.array([0, 0, 1])
    )
    paired = compare_pairs(a, b, larger_is_better=False)
    assert (paired.worlds, paired.trials) == (2, 2)
    assert paired.difference.estimate == -2.5
    assert paired.improvement.estimate == 1.0
    none = compare_pairs(a, replace(b, worlds=b.worlds + 100), larger_is_better=False)
    assert (none.worlds, none.trials) == (0, 0)
    assert math.isnan(none.p) and math.isnan(none.improvement.estimate)
    assert math.isnan(none.difference.estimate)


def test_intervals_repeat():
    values, worlds, repetitions = trials_of()
    planner = TrialValues(values, worlds, repetitions)
    other = TrialValues(values[::-1].copy(), worlds, repetitions)
    correlation = partial(
        rank_correlation, (planner.values, worlds), (other.values, worlds)
    )
    assert correlation() == correlation(seed=0) != correlation(seed=1)
    for find in (
        partial(difference, planner, other),
        partial(compare_pairs, planner, other, larger_is_better=True),
    ):
        first = find()
        # The patterns of signs are drawn again.
        sign_patterns.cache_clear()
        assert find() == first


def test_paired_comparison_gives_the_mean_of_each_over_the_pairs():
    worlds = np.array([0, 1, 2, 3])
    repetitions = np.zeros(4, np.int64)
    a = np.array([1.0, 2.0, 6.0, 90.0])
    b = np.array([10.0, 11.0, 15.0, np.nan])
    paired = compare_pairs(
        TrialValues(a, worlds, repetitions),
        TrialValues(b, worlds, repetitions),
        larger_is_better=False,
    )
    assert (paired.worlds, paired.trials, paired.mean_a, paired.mean_b) == (
        3,
        3,
        3.0,
        12.0,
    )


def test_an_improvement_however_small_counts_whole():
    a = counted([1.0, 1.0, 1.0], [0] * 3, range(3))
    b = counted([0.999, 1.0, 1.001], [0] * 3, range(3))
    paired = compare_pairs(a, b, larger_is_better=True)
    assert paired.improvement.estimate == pytest.approx((1.0 + 0.5 + 0.0) / 3.0)


def test_rank_correlation_uses_the_worlds_that_both_have_done():
    a = (
        np.array([1.0, 1.0, 1.0, 1.0, 2.0, 3.0, 9.0, np.nan]),
        np.array([0, 0, 0, 0, 1, 2, 7, 4]),
    )
    b = (np.array([10.0, 30.0, 20.0, 0.0, 5.0]), np.array([0, 1, 2, 8, 4]))
    assert rank_correlation(a, b).estimate == pytest.approx(0.5)
    two_worlds = rank_correlation((a[0][:5], a[1][:5]), b)
    assert math.isnan(two_worlds.estimate)


def test_rank_correlation_is_scipys_with_ties_too(monkeypatch):
    monkeypatch.setattr(
        statistics, "bootstrap_interval", partial(bootstrap_interval, resamples=200)
    )
    draw = np.random.default_rng(9)
    worlds = np.arange(12)
    x = draw.integers(0, 3, 12).astype(float)
    y = draw.integers(0, 8, 12).astype(float)
    apart = draw.integers(0, 9, 12)  # trials of a world, whose means are x and y
    trials = [
        (np.concatenate([values - apart, values + apart]), np.tile(worlds, 2))
        for values in (x, y)
    ]
    correlation = rank_correlation(*trials, seed=2)

    def spearman(sample):
        each = [
            stats.spearmanr(x[row], y[row]).statistic
            for row in sample.reshape(-1, sample.shape[-1])
        ]
        return np.reshape(each, sample.shape[:-1])

    plain = bootstrap_interval(spearman, 12, seed=2, resamples=200)
    assert (correlation.estimate, correlation.low, correlation.high) == pytest.approx(
        (plain.estimate, plain.low, plain.high), rel=1e-9
    )


def test_published_trials_give_the_known_agreement_of_planners(original_folder):
    """The 50 shared worlds: Spearman of DWA's and E-Band's means, known to be about 0.37 over all 300 worlds."""
    table = np.genfromtxt(original_folder / "trials.csv", delimiter=",", names=True)
    worlds = np.repeat(np.arange(len(table)), 5)
    dwa, eband = (
        np.stack(
            [table[f"{name}_{i}"] / table["path_length_m"] for i in range(1, 6)], 1
        ).ravel()
        for name in ("dwa", "eband")
    )
    correlation = rank_correlation((dwa, worlds), (eband, worlds))
    assert correlation.low < 0.37 < correlation.high
    assert mean_interval(dwa, worlds).low < 3.30 < mean_interval(dwa, worlds).high
    assert mean_interval(eband, worlds).low < 3.24 < mean_interval(eband, worlds).high
    assert repetition_spread(eband, worlds) == pytest.approx(0.38, abs=0.02)


def counted(values, failures, worlds, as_failure=0.0, best=0.5):
    values = np.asarray(values, float)
    failing = np.asarray(failures), np.full(len(values), as_failure)
    return TrialValues(
        values, np.asarray(worlds), np.zeros(len(values), int), *failing, best
    )


def draw(generator, mean, effect):
    """Two trials a world of a bounded score, 0 for a failure; worlds differ, and so do their chances of failure."""
    world = np.repeat(np.arange(len(effect)), 2)
    chances = generator.beta(0.02, 0.98, len(effect))
    failures = (generator.random(len(world)) < chances[world]).astype(np.int64)
    scores = mean + effect[world] + generator.normal(0.0, 0.02, len(world))
    return counted(np.where(failures == 1, 0.0, scores), failures, world)


def test_a_mean_of_symmetric_values_has_students_limits():
    values = np.array([1.0, 2.0, 3.0, 4.0, 5.0])
    interval = mean_interval(values, np.arange(5))
    half = 2.7764451051977987 * math.sqrt(
        2.5 / 5
    )  # Student's quantile of 4 degrees of freedom
    assert (interval.estimate, interval.low, interval.high) == pytest.approx(
        (3.0, 3.0 - half, 3.0 + half)
    )


def test_skewed_limits_follow_halls_transform():
    values = np.array([1.0, 1.1, 1.2, 1.3, 1.2, 1.1, 9.0])
    interval = mean_interval(values, np.arange(7))
    error = stats.sem(values)
    skewness = stats.skew(values) / math.sqrt(7)
    t = (interval.estimate - np.array([interval.low, interval.high])) / error
    transformed = t + skewness * t**2 / 3.0 + skewness**2 * t**3 / 27.0 + skewness / 6.0
    assert transformed == pytest.approx(stats.t.ppf([0.975, 0.025], 6))


def test_the_limits_of_a_mean_are_those_of_the_means_of_worlds():
    interval = mean_interval(
        np.array([1.0, 1.1, 5.0, 5.2, 9.0, 9.1]), np.array([3, 3, 7, 7, 8, 8])
    )
    means = mean_interval(np.array([1.05, 5.1, 9.05]), np.arange(3))
    assert (interval.low, interval.high) == pytest.approx((means.low, means.high))


@pytest.mark.parametrize("values", [[], [math.nan, math.nan]])
def test_nothing_has_no_mean(values):
    assert math.isnan(
        mean_interval(np.array(values, float), np.arange(len(values))).estimate
    )


def test_failures_that_were_not_seen_lower_the_lower_limit():
    """By the limit of none in four: 1 - 0.025^(1/4)."""
    trials = counted([0.30, 0.31, 0.29, 0.30], [0] * 4, range(4))
    interval = trials.mean()
    plain = mean_interval(trials.values, trials.worlds)
    assert interval.low == pytest.approx(0.30 * 0.025**0.25)
    assert interval.high == plain.high


def test_cheap_failures_raise_the_mean_of_times():
    """As under the paper's rules, where giving up counts 30 s and a slow success up to 50 s."""
    interval = counted(
        [40.0, 41.0, 39.0, 42.0, 40.5], [0] * 5, range(5), as_failure=30.0, best=0.0
    ).mean()
    assert interval.estimate - interval.low > interval.high - interval.estimate > 0.0


@pytest.mark.parametrize(("least", "cut"), [(-0.05, False), (0.0, True), (0.05, True)])
def test_only_where_no_value_is_below_zero_are_limits_not_either(least, cut):
    values = np.array([least, 1.0, 3.0])
    trials = np.arange(3)
    plain = mean_interval(values, trials).low
    assert TrialValues(values, trials, trials).mean().low == (0.0 if cut else plain)
    assert plain < 0.0


def test_the_upper_limit_of_a_mean_is_not_above_the_best():
    assert counted([0.0, 0.05, 0.05], [0] * 3, range(3), best=0.05).mean().high == 0.05


def test_parts_of_a_mean_are_those_of_a_difference_from_zero():
    planner = TrialValues(*trials_of())
    apart = difference(planner, replace(planner, values=0.0 * planner.values)).parts
    assert planner.parts().within == pytest.approx(apart.within)


def test_matched_trials_are_in_the_order_of_worlds():
    (matched,) = matched_trials(
        [TrialValues(np.array([1.0, 2.0]), np.array([1, 0]), np.array([0, 1]))]
    )
    assert matched.worlds.tolist() == [0, 1]


def test_success_in_one_world_is_worth_the_best():
    costs = [
        counted([0.3, 0.3, 0.2], failures, range(3), 0.1).cost
        for failures in ([0, 1, 1], [0, 0, 1])
    ]
    assert costs == pytest.approx([0.5 - 0.1, 0.3 - 0.1])


def test_what_a_failure_costs_is_unseen_only_where_none_was_seen():
    none, with_failure = (
        counted([0.3, 0.3], failures, range(2), 0.4) for failures in ([0, 0], [0, 1])
    )
    assert (
        none.parts().unseen,
        with_failure.unseen,
        replace(none, failures=with_failure.failures[:0]).unseen,
    ) == (
        (none.cost * -1,),
        (),
        (),
    )
    assert (
        compare_pairs(none, with_failure, larger_is_better=True).parts.unseen
        == difference(with_failure, none).parts.unseen
        == none.unseen
    )


def test_paired_comparison_gives_the_share_of_failures_of_each():
    paired = compare_pairs(
        *(counted([0.3], [failure], [0]) for failure in (0, 1)), larger_is_better=True
    )
    shares = [Share(share, 1.0) for share in (0.0, 1.0)]
    assert paired.failures == tuple(
        Interval(failure_share.share, *failure_share.limits) for failure_share in shares
    )


def test_where_nothing_succeeded_a_success_may_be_worth_the_best():
    interval = counted([0.0] * 10, [1] * 10, range(10)).mean()
    assert (interval.estimate, interval.low, interval.high) == pytest.approx(
        (0.0, 0.0, 0.5 * (1.0 - 0.025**0.1))
    )


def test_one_that_always_fails_is_worse_than_one_that_never_does():
    never, always = (
        counted([value] * 12, [1 - int(value)] * 12, range(12), best=1.0)
        for value in (1.0, 0.0)
    )
    test = difference(never, always)
    assert test.interval.low > 0.3
    assert test.p < 0.01


def test_few_failing_worlds_count_as_one_trial_each():
    worlds = np.repeat(np.arange(20), 5)
    trial = np.arange(100)
    failing_once, single, alike = (
        trial < 3,
        trial % 20 == 0,
        trial < 25,
    )  # single: in five worlds, as if trials were independent
    effective = [
        share_of(failures.astype(np.int64), worlds).effective
        for failures in (failing_once, single, alike)
    ]
    assert effective == [20.0, 100.0, pytest.approx(19.0)]


def test_a_share_beyond_its_limit_is_significant():
    share = Share(0.08, 50.0)
    assert share.limits == pytest.approx(
        (0.0222, 0.1923), abs=1e-4
    )  # Clopper and Pearson, 4 of 50
    assert share.p_above(share.limits[1]) == pytest.approx(0.05)
    assert share.p_above(1.0) == 0.0


def test_a_difference_is_clear_if_its_interval_excludes_zero():
    generator = np.random.default_rng(4)
    for mean in (0.30, 0.28, 0.26):
        effect = generator.normal(0.0, 0.04, 60)
        a, b = (draw(generator, level, effect) for level in (0.30, mean))
        test = difference(a, b)
        turned = difference(b, a)
        contains_zero = test.interval.low <= 0.0 <= test.interval.high
        assert (test.p <= 0.05) == (not contains_zero)
        assert (turned.p, turned.interval.negate().low) == pytest.approx(
            (test.p, test.interval.low)
        )


def test_unobserved_failures_keep_a_difference_open():
    """B is better by 5 % in each of 50 worlds, but may fail in 7 %; in 100 worlds, in 4 %."""
    for worlds, clear in ((50, False), (100, True)):
        a, b = (
            counted([value] * worlds, [0] * worlds, range(worlds))
            for value in (0.285, 0.30)
        )
        assert paired_difference(a.values - b.values, a.worlds).p < 0.001
        test = difference(a, b)
        assert (test.p <= 0.05) is clear
        assert test.interval.high == pytest.approx(
            -0.015 + 0.30 * (1.0 - 0.025 ** (1.0 / worlds))
        )


def test_failures_that_both_have_in_the_same_worlds_cancel():
    failures = [1] * 5 + [0] * 45
    a, b = (
        counted([0.0] * 5 + [value] * 45, failures, range(50)) for value in (0.30, 0.20)
    )
    assert a.excess(b).share == 0.0
    assert difference(a, b).p < 0.01


def test_failures_in_excess_are_a_share_of_the_trials_of_a_world():
    with_failure, none = (
        counted([0.3] * 2, failures, [0, 0]) for failures in ([1, 0], [0, 0])
    )
    assert with_failure.excess(none).share == 0.5


def test_one_sided_failures_do_not_change_a_difference():
    a, b = (counted([value] * 9, [0] * 9, range(9)) for value in (0.3, 0.2))
    plain = paired_difference(a.values - b.values, a.worlds)
    without = [replace(trials, failures=trials.failures[:0]) for trials in (a, b)]
    assert (
        difference(a, without[1]).interval
        == difference(without[0], b).interval
        == plain.interval
    )


def test_failures_that_cost_nothing_change_no_difference():
    a, b = (counted([value] * 9, [0] * 9, range(9), value) for value in (0.5, 0.25))
    assert (
        difference(a, b).interval
        == paired_difference(a.values - b.values, a.worlds).interval
    )
