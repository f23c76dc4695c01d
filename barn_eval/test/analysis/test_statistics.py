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
    shared = np.repeat(draw.gamma(1.0, 3.0, worlds), repetitions)
    values = 20.0 + shared + draw.normal(0, 1.0, len(world))
    return TrialValues(values, world, np.tile(np.arange(repetitions), worlds))


def test_order_of_trials_changes_no_bit():
    trials = trials_of(30, 20)
    shuffled = trials.at(np.random.default_rng(0).permutation(len(trials.values)))
    assert trials.mean() == shuffled.mean()
    for figure in (mean_interval, repetition_spread):
        in_order = figure(trials.values, trials.worlds)
        assert in_order == figure(shuffled.values, shuffled.worlds)


def test_unbalanced_worlds_are_weighted_by_trials():
    values = np.array([1.0, 2.0, 3.0, 10.0, np.nan, np.nan])
    worlds = np.array([7, 7, 7, 8, 8, 9])
    mean = TrialValues(values, worlds, np.zeros(6, np.int64)).mean()
    assert mean.estimate == 4.0
    assert mean.low == 0.0  # what two worlds say is little, but no value is below 0
    assert mean.high > 10.0


def test_equal_worlds_have_an_interval_without_width():
    assert mean_interval(np.array([1.0, 3.0]), np.array([4, 4])) == Interval(2.0)
    assert counted([0.3, 0.2], worlds=[1, 1]).mean().low is None
    assert mean_interval(np.ones(6), np.arange(6) // 2) == Interval(1.0, 1.0, 1.0)


def test_repetition_spread_is_the_papers():
    values = np.array([1.0, 3.0, 10.0, 10.0, 5.0])
    worlds = np.array([0, 0, 1, 1, 2])
    assert repetition_spread(values, worlds) == 0.5
    assert math.isnan(repetition_spread(values[-1:], worlds[-1:]))


def test_paired_comparison_removes_what_the_worlds_share():
    trials = trials_of(worlds=30)
    shift = np.random.default_rng(5).normal(-1.0, 0.1, len(trials.values))
    moved = replace(trials, values=trials.values + shift)
    paired = compare_pairs(moved, trials, larger_is_better=False)
    assert (paired.worlds, paired.trials) == (30, 150)
    assert paired.difference.estimate == pytest.approx(shift.mean(), rel=1e-9)
    assert -1.1 < paired.difference.low < paired.difference.high < -0.9


def test_a_lead_in_all_worlds_does_not_exclude_losses_in_others():
    trials = trials_of(worlds=30)
    moved = replace(trials, values=trials.values - 100.0)
    low = pytest.approx(0.025 ** (1.0 / 30.0))
    better = compare_pairs(moved, trials, larger_is_better=False).improvement
    assert better == Interval(1.0, low, 1.0)
    worse = compare_pairs(trials, moved, larger_is_better=False).improvement
    assert worse == Interval(0.0, 0.0, pytest.approx(1.0 - better.low))


def test_a_paired_comparison_gives_the_test_that_it_made():
    trials = trials_of()
    other = replace(trials, values=trials.values[::-1].copy())
    paired = compare_pairs(trials, other, larger_is_better=True)
    assert paired.test() == difference(trials, other)


def test_improvement_is_the_mann_whitney_statistic():
    draw = np.random.default_rng(6)
    worlds = np.repeat(np.arange(8), 6)
    repetitions = np.tile(np.arange(6), 8)
    a = draw.integers(0, 5, 48).astype(float)
    b = draw.integers(1, 6, 48).astype(float)
    trials_a, trials_b = (TrialValues(part, worlds, repetitions) for part in (a, b))
    chances = [
        stats.mannwhitneyu(a[worlds == w], b[worlds == w]).statistic / 36.0
        for w in range(8)
    ]
    chance = np.mean(chances)
    paired = compare_pairs(trials_a, trials_b, larger_is_better=True)
    assert paired.improvement.estimate == pytest.approx(chance, rel=1e-12)
    other = compare_pairs(trials_b, trials_a, larger_is_better=True)
    assert other.improvement.estimate == pytest.approx(1.0 - chance, rel=1e-12)


def test_only_shared_worlds_and_repetitions_are_compared():
    worlds = np.array([0, 1, 2])
    a = TrialValues(np.array([1.0, 2.0, 50.0]), worlds, np.array([0, 0, 0]))
    b = TrialValues(np.array([4.0, 4.0, 60.0]), worlds, np.array([0, 0, 1]))
    paired = compare_pairs(a, b, larger_is_better=False)
    assert (paired.worlds, paired.trials) == (2, 2)
    assert paired.difference.estimate == -2.5
    assert paired.improvement.estimate == 1.0
    none = compare_pairs(a, replace(b, worlds=b.worlds + 100), larger_is_better=False)
    assert (none.worlds, none.trials) == (0, 0)
    assert math.isnan(none.p) and math.isnan(none.improvement.estimate)
    assert math.isnan(none.difference.estimate)
    assert math.isnan(none.mean_a) and math.isnan(none.mean_b)


def test_intervals_repeat():
    planner = trials_of()
    other = replace(planner, values=planner.values[::-1].copy())
    pairs = ((trials.values, trials.worlds) for trials in (planner, other))
    correlation = partial(rank_correlation, *pairs)
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
    a = TrialValues(np.array([1.0, 2.0, 6.0, 90.0]), worlds, np.zeros(4, np.int64))
    b = replace(a, values=np.array([10.0, 11.0, 15.0, np.nan]))
    paired = compare_pairs(a, b, larger_is_better=False)
    assert (paired.worlds, paired.trials) == (3, 3)
    assert (paired.mean_a, paired.mean_b) == (3.0, 12.0)


def test_an_improvement_however_small_counts_whole():
    a = counted([1.0, 1.0, 1.0])
    b = counted([0.999, 1.0, 1.001])
    paired = compare_pairs(a, b, larger_is_better=True)
    assert paired.improvement.estimate == pytest.approx((1.0 + 0.5 + 0.0) / 3.0)


def test_rank_correlation_uses_the_worlds_that_both_have_done():
    values = np.array([1.0, 1.0, 1.0, 1.0, 2.0, 3.0, 9.0, np.nan])
    worlds = np.array([0, 0, 0, 0, 1, 2, 7, 4])
    b = (np.array([10.0, 30.0, 20.0, 0.0, 5.0]), np.array([0, 1, 2, 8, 4]))
    assert rank_correlation((values, worlds), b).estimate == pytest.approx(0.5)
    two_worlds = rank_correlation((values[:5], worlds[:5]), b)
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
    twice = np.tile(worlds, 2)
    trials = (
        (np.concatenate([values - apart, values + apart]), twice) for values in (x, y)
    )
    correlation = rank_correlation(*trials, seed=2)

    def spearman(sample):
        each = [
            stats.spearmanr(x[row], y[row]).statistic
            for row in sample.reshape(-1, sample.shape[-1])
        ]
        return np.reshape(each, sample.shape[:-1])

    plain = bootstrap_interval(spearman, 12, seed=2, resamples=200)
    assert limits(correlation) == pytest.approx(limits(plain), rel=1e-9)


def test_published_trials_give_the_known_agreement_of_planners(original_folder):
    """The 50 shared worlds.

    Spearman of DWA's and E-Band's means, known to be about 0.37 over all 300 worlds.
    """
    table = np.genfromtxt(original_folder / "trials.csv", delimiter=",", names=True)
    worlds = np.repeat(np.arange(len(table)), 5)

    def time_per_meter(planner):
        times = [table[f"{planner}_{trial}"] for trial in range(1, 6)]
        return (np.array(times) / table["path_length_m"]).T.ravel()

    dwa, eband = map(time_per_meter, ("dwa", "eband"))
    correlation = rank_correlation((dwa, worlds), (eband, worlds))
    assert correlation.low < 0.37 < correlation.high
    for values, published in ((dwa, 3.30), (eband, 3.24)):
        interval = mean_interval(values, worlds)
        assert interval.low < published < interval.high
    assert repetition_spread(eband, worlds) == pytest.approx(0.38, abs=0.02)


def counted(values, failures=0, worlds=None, as_failure=0.0, best=0.5):
    """Values of trials, by default of one without a failure in each world."""
    values = np.asarray(values, float)
    number = len(values)
    worlds = np.arange(number) if worlds is None else np.asarray(worlds)
    failing = (np.full(number, given) for given in (failures, as_failure))
    return TrialValues(values, worlds, np.zeros(number, int), *failing, best)


def without_failures(trials):
    """The same trials, of which it is not known whether they failed."""
    return replace(trials, failures=trials.failures[:0])


def limits(interval):
    return interval.estimate, interval.low, interval.high


def draw(generator, mean, effect):
    """Two trials a world of a bounded score, 0 for a failure.

    Worlds differ, and so do their chances of failure.
    """
    world = np.repeat(np.arange(len(effect)), 2)
    chances = generator.beta(0.02, 0.98, len(effect))
    failures = (generator.random(len(world)) < chances[world]).astype(np.int64)
    scores = mean + effect[world] + generator.normal(0.0, 0.02, len(world))
    return counted(np.where(failures == 1, 0.0, scores), failures, world)


def test_a_mean_of_symmetric_values_has_students_limits():
    values = np.array([1.0, 2.0, 3.0, 4.0, 5.0])
    interval = mean_interval(values, np.arange(5))
    # Student's quantile of 4 degrees of freedom
    half = 2.7764451051977987 * math.sqrt(2.5 / 5)
    assert limits(interval) == pytest.approx((3.0, 3.0 - half, 3.0 + half))


def test_skewed_limits_follow_halls_transform():
    values = np.array([1.0, 1.1, 1.2, 1.3, 1.2, 1.1, 9.0])
    interval = mean_interval(values, np.arange(7))
    error = stats.sem(values)
    skewness = stats.skew(values) / math.sqrt(7)
    t = (interval.estimate - np.array([interval.low, interval.high])) / error
    transformed = t + skewness * t**2 / 3.0 + skewness**2 * t**3 / 27.0 + skewness / 6.0
    assert transformed == pytest.approx(stats.t.ppf([0.975, 0.025], 6))


def test_the_limits_of_a_mean_are_those_of_the_means_of_worlds():
    values = np.array([1.0, 1.1, 5.0, 5.2, 9.0, 9.1])
    interval = mean_interval(values, np.array([3, 3, 7, 7, 8, 8]))
    means = mean_interval(np.array([1.05, 5.1, 9.05]), np.arange(3))
    assert (interval.low, interval.high) == pytest.approx((means.low, means.high))


@pytest.mark.parametrize("values", [[], [math.nan, math.nan]])
def test_nothing_has_no_mean(values):
    mean = mean_interval(np.array(values, float), np.arange(len(values)))
    assert math.isnan(mean.estimate)


def test_failures_that_were_not_seen_lower_the_lower_limit():
    """By the limit of none in four: 1 - 0.025^(1/4)."""
    trials = counted([0.30, 0.31, 0.29, 0.30])
    interval = trials.mean()
    plain = mean_interval(trials.values, trials.worlds)
    assert interval.low == pytest.approx(0.30 * 0.025**0.25)
    assert interval.high == plain.high


def test_cheap_failures_raise_the_mean_of_times():
    """As under the paper's rules, where giving up counts 30 s and a slow success up to
    50 s.
    """
    times = [40.0, 41.0, 39.0, 42.0, 40.5]
    interval = counted(times, as_failure=30.0, best=0.0).mean()
    assert interval.estimate - interval.low > interval.high - interval.estimate > 0.0


@pytest.mark.parametrize("least, cut", [(-0.05, False), (0.0, True), (0.05, True)])
def test_only_where_no_value_is_below_zero_are_limits_not_either(least, cut):
    values = np.array([least, 1.0, 3.0])
    trials = np.arange(3)
    plain = mean_interval(values, trials).low
    assert TrialValues(values, trials, trials).mean().low == (0.0 if cut else plain)
    assert plain < 0.0


def test_the_upper_limit_of_a_mean_is_not_above_the_best():
    assert counted([0.0, 0.05, 0.05], best=0.05).mean().high == 0.05


def test_parts_of_a_mean_are_those_of_a_difference_from_zero():
    planner = trials_of()
    apart = difference(planner, replace(planner, values=0.0 * planner.values)).parts
    assert planner.parts().within == pytest.approx(apart.within)


def test_matched_trials_are_in_the_order_of_worlds():
    trials = TrialValues(np.array([1.0, 2.0]), np.array([1, 0]), np.array([0, 1]))
    (matched,) = matched_trials([trials])
    assert matched.worlds.tolist() == [0, 1]


def test_selected_trials_keep_whether_they_failed():
    trials = counted([0.1, 0.2, 0.3], [1, 0, 0], as_failure=[0.0, 0.5, 0.25])
    selected = trials.at(np.array([2, 0]))
    assert selected.failures.tolist() == [0, 1]
    assert selected.as_failure.tolist() == [0.25, 0.0]


def test_success_in_one_world_is_worth_the_best():
    for failures, best in (([0, 1, 1], 0.5), ([0, 0, 1], 0.3)):
        trials = counted([0.3, 0.3, 0.2], failures, as_failure=0.1)
        assert trials.cost == pytest.approx(best - 0.1)


def test_what_a_failure_costs_is_unseen_only_where_all_trials_end_alike():
    none = counted([0.3, 0.3], as_failure=0.4)
    with_failure = counted([0.3, 0.3], [0, 1], as_failure=0.4)
    assert none.parts().unseen == (none.cost * -1,)
    never = counted([0.0, 0.0], failures=1)
    assert never.unseen == (never.best,)
    assert with_failure.unseen == without_failures(none).unseen == ()
    paired = compare_pairs(none, with_failure, larger_is_better=True)
    turned = difference(with_failure, none)
    assert paired.parts.unseen == turned.parts.unseen == none.unseen


def test_paired_comparison_gives_the_share_of_failures_of_each():
    none, one = (counted([0.3], failure) for failure in (0, 1))
    paired = compare_pairs(none, one, larger_is_better=True)
    for interval, share in zip(paired.failures, (0.0, 1.0), strict=True):
        assert interval == Interval(share, *Share(share, 1.0).limits)


def test_where_nothing_succeeded_a_success_may_be_worth_the_best():
    interval = counted([0.0] * 10, failures=1).mean()
    assert limits(interval) == pytest.approx((0.0, 0.0, 0.5 * (1.0 - 0.025**0.1)))


def test_one_that_always_fails_is_worse_than_one_that_never_does():
    never = counted([1.0] * 12, best=1.0)
    always = counted([0.0] * 12, failures=1, best=1.0)
    test = difference(never, always)
    assert test.interval.low > 0.3
    assert test.p < 0.01


def test_few_failing_worlds_count_as_one_trial_each():
    worlds = np.repeat(np.arange(20), 5)
    trial = np.arange(100)

    def effective(failures):
        return share_of(failures.astype(np.int64), worlds).effective

    assert effective(trial < 3) == 20.0
    # in five worlds, as if trials were independent
    assert effective(trial % 20 == 0) == 100.0
    assert effective(trial < 25) == pytest.approx(19.0)


def test_a_share_beyond_its_limit_is_significant():
    share = Share(0.08, 50.0)
    # Clopper and Pearson, 4 of 50
    assert share.limits == pytest.approx((0.0222, 0.1923), abs=1e-4)
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
        turned_figures = (turned.p, turned.interval.negate().low)
        assert turned_figures == pytest.approx((test.p, test.interval.low))


def test_unobserved_failures_keep_a_difference_open():
    """B is better by 5% in each of 50 worlds, but may fail in 7%.

    In 100 worlds, in 4%.
    """
    for worlds, clear in ((50, False), (100, True)):
        a = counted([0.285] * worlds)
        b = replace(a, values=a.values + 0.015)
        assert paired_difference(a.values - b.values, a.worlds).p < 0.001
        test = difference(a, b)
        assert (test.p <= 0.05) is clear
        unseen = 1.0 - 0.025 ** (1.0 / worlds)
        assert test.interval.high == pytest.approx(-0.015 + 0.30 * unseen)


def test_failures_that_both_have_in_the_same_worlds_cancel():
    failures = [1] * 5 + [0] * 45
    a = counted([0.0] * 5 + [0.30] * 45, failures)
    b = counted([0.0] * 5 + [0.20] * 45, failures)
    assert a.excess(b).share == 0.0
    assert difference(a, b).p < 0.01


def test_failures_in_excess_are_a_share_of_the_trials_of_a_world():
    with_failure = counted([0.3] * 2, [1, 0], [0, 0])
    none = counted([0.3] * 2, worlds=[0, 0])
    assert with_failure.excess(none).share == 0.5


def test_one_sided_failures_do_not_change_a_difference():
    a, b = (counted([value] * 9) for value in (0.3, 0.2))
    plain = paired_difference(a.values - b.values, a.worlds).interval
    assert difference(a, without_failures(b)).interval == plain
    assert difference(without_failures(a), b).interval == plain


def test_failures_that_cost_nothing_change_no_difference():
    a, b = (counted([value] * 9, as_failure=value) for value in (0.5, 0.25))
    plain = paired_difference(a.values - b.values, a.worlds)
    assert difference(a, b).interval == plain.interval
