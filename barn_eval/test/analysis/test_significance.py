"""Differences and shares against enumeration, textbooks and simulation, and what looks
at a plan that runs decide.
"""

import itertools
import math

import numpy as np
import pytest
from analysis.test_statistics import counted, limits
from hypothesis import assume, example, given
from hypothesis import strategies as st
from scipy import stats

from barn_eval.analysis.sequential import decide
from barn_eval.analysis.significance import (
    Components,
    detectable_difference,
    half_width,
    holm,
    p_text,
    paired_difference,
    proportion,
    variance_components,
    worlds_for_difference,
    worlds_for_half_width,
)

VALUES = st.lists(st.floats(-10.0, 10.0, allow_subnormal=False), min_size=1, max_size=9)


@given(VALUES)
def test_few_worlds_are_enumerated(values):
    test = paired_difference(np.array(values), np.arange(len(values)))
    signs = np.array(list(itertools.product((1, -1), repeat=len(values))))
    sums = np.abs(signs @ np.array(values))
    as_far = sums >= abs(sum(values)) - 1e-9 * sum(map(abs, values))
    assert test.p == pytest.approx(as_far.mean())
    assert test.interval.estimate == pytest.approx(np.mean(values))
    assert test.worlds == len(values)


@example(
    [0.5, -1.0, -1.9054275882702818, -3.99999, -9.999999999999998, -1.6411609986506726],
    0.0,
)  # sums are rounded
@given(VALUES, st.floats(-5.0, 5.0))
def test_the_interval_holds_the_shifts_not_rejected(values, shift):
    values = np.array(values)
    assume(
        not np.isclose(values, shift).any()
    )  # a difference of 0 has no sign: at such a shift alone, p is larger
    interval = paired_difference(values, np.arange(len(values))).interval
    p = paired_difference(values - shift, np.arange(len(values))).p
    if interval.low is None:
        assert len(values) < 6
    elif interval.low + 1e-6 < shift < interval.high - 1e-6:
        assert p > 0.05
    elif shift < interval.low - 1e-6 or shift > interval.high + 1e-6:
        assert p <= 0.05 + 1e-9


def width(interval):
    return interval.high - interval.low


def test_trials_of_a_world_flip_together_and_in_any_order():
    generator = np.random.default_rng(1)
    worlds = np.repeat(np.arange(40), 3)
    values = generator.normal(0.3, 1.0, 40)[worlds] + generator.normal(0.0, 0.1, 120)
    test = paired_difference(values, worlds)
    order = generator.permutation(120)
    assert paired_difference(values[order], worlds[order]) == test
    means = np.array([values[worlds == world].mean() for world in range(40)])
    assert test.p == pytest.approx(stats.ttest_1samp(means, 0.0).pvalue, abs=0.02)
    student = stats.t.interval(0.95, 39, means.mean(), stats.sem(means))
    assert (test.interval.low, test.interval.high) == pytest.approx(student, abs=0.03)
    single = paired_difference(values, np.arange(120))
    assert width(single.interval) < 0.7 * width(test.interval)


def test_fewer_than_six_worlds_leave_a_difference_open():
    for worlds, limit in ((5, None), (6, 1.0)):
        test = paired_difference(np.full(worlds, 1.0), np.arange(worlds))
        assert test.p == pytest.approx(2.0 / 2**worlds)
        assert (test.interval.low, test.interval.high) == (limit, limit)
    none = paired_difference(np.array([]), np.array([], int))
    assert math.isnan(none.p) and none.worlds == 0


def test_a_world_with_more_trials_counts_more():
    worlds = np.array([0, 0, 0, *range(1, 8)])
    test = paired_difference(np.array([2.0, 2.0, 2.0, *[1.0] * 7]), worlds)
    assert test.interval.estimate == pytest.approx(1.3)


def test_shares_are_wilsons_with_students_quantile():
    successes = np.array([1] * 40 + [0] * 10)
    share = proportion(successes, np.arange(50))
    n = 50 - 1  # the divisor of the variance over worlds
    z = stats.t.ppf(0.975, 49)
    middle = 0.8 + z * z / (2 * n)
    half = z * math.sqrt(0.8 * 0.2 / n + (z / (2 * n)) ** 2)
    expected = np.array([middle - half, middle + half]) / (1 + z * z / n)
    assert limits(share) == pytest.approx((0.8, *expected))


def test_high_shares_are_as_wide_as_clopper_and_pearson():
    """Wilson's, at 98 of 100, would leave out a true share of 0.995."""
    share = proportion(np.array([1] * 98 + [0] * 2), np.arange(100))
    assert share.high > 0.995


def test_shares_know_that_trials_of_a_world_are_alike():
    worlds = np.repeat(np.arange(50), 3)
    alike = proportion(np.repeat([1] * 40 + [0] * 10, 3), worlds)
    single = proportion(np.array([1] * 40 + [0] * 10), np.arange(50))
    assert (alike.low, alike.high) == pytest.approx((single.low, single.high))
    mixed = proportion(np.array([1, 1, 1, 1, 0] * 30), worlds)
    assert width(mixed) < 0.8 * width(alike)


def test_shares_at_the_edge_and_without_data():
    every = proportion(np.ones(60, int), np.repeat(np.arange(20), 3))
    assert (every.estimate, every.high) == (1.0, 1.0)
    assert every.low == pytest.approx(20 / (20 + stats.t.ppf(0.975, 19) ** 2))
    assert proportion(np.zeros(20, int), np.arange(20)).low == 0.0
    assert proportion(np.ones(3, int), np.zeros(3, int)).low is None
    assert math.isnan(proportion(np.array([], int), np.array([], int)).estimate)


def test_holm_by_hand():
    assert holm([0.01, 0.04, 0.03, 0.005]) == pytest.approx([0.03, 0.06, 0.06, 0.02])
    assert holm([0.6, 0.9]) == pytest.approx([1.0, 1.0])
    assert holm([]) == []
    first, none, other = holm([0.04, math.nan, 0.03])
    assert (first, other) == pytest.approx((0.06, 0.06))
    assert math.isnan(none)


@pytest.mark.parametrize(
    "p, text", [(0.0004, "p < 0.001"), (0.001, "p = 0.001"), (0.0316, "p = 0.032")]
)
def test_p_values_are_written_with_three_digits(p, text):
    assert p_text(p) == text


def test_the_smallest_p_value_follows_the_number_of_flips():
    clear = np.linspace(1.0, 2.0, 40)
    assert paired_difference(clear, np.arange(40)).p == 1.0 / 10_001.0
    assert paired_difference(clear, np.arange(40), flips=50_000).p == 1.0 / 50_001.0


def test_a_difference_knows_its_components_of_variance():
    worlds = np.repeat(np.arange(10), 2)
    values = np.random.default_rng(2).normal(0.0, 1.0, 20)
    test = paired_difference(values, worlds)
    in_order = values[np.lexsort((values, worlds))]
    assert test.parts == variance_components(in_order, worlds)
    assert test.trials == 20


def test_components_by_hand():
    def components(values, worlds):
        return variance_components(np.array(values), np.array(worlds))

    parts = components([1.0, 3.0, 5.0, 7.0], [0, 0, 1, 1])
    assert parts == Components(pytest.approx((16.0 - 2.0) / 2.0), pytest.approx(2.0))
    assert components([1.0, 3.0], [0, 1]) == Components(pytest.approx(2.0), 0.0)
    assert math.isnan(components([1.0, 3.0], [0, 0]).between)
    assert components([1.0, 3.0, 1.0, 3.0], [0, 0, 1, 1]).between == 0.0


def test_components_of_uneven_worlds_are_unbiased():
    generator = np.random.default_rng(3)
    worlds = np.repeat(np.arange(200), generator.integers(1, 6, 200))
    between = generator.normal(0.0, 2.0, (200, 200))
    within = generator.normal(0.0, 1.0, (200, len(worlds)))
    estimates = [
        variance_components(values, worlds) for values in between[:, worlds] + within
    ]
    means = np.mean([(parts.between, parts.within) for parts in estimates], axis=0)
    assert means == pytest.approx([4.0, 1.0], rel=0.03)


def test_counts_just_suffice():
    parts = Components(0.04, 0.02)
    for worlds_for, reached in (
        (worlds_for_half_width, half_width),
        (worlds_for_difference, detectable_difference),
    ):
        for repetitions in (1, 5):
            enough = worlds_for(parts, 0.03, repetitions)
            assert reached(parts, enough, repetitions) <= 0.03
            assert reached(parts, enough - 1, repetitions) > 0.03
    assert worlds_for_half_width(parts, 1e-9, 1) is None
    assert half_width(parts, 1, 5) == math.inf


def test_a_detectable_difference_is_found_as_often_as_promised():
    generator = np.random.default_rng(4)
    truth = Components(0.09, 0.18)
    worlds = 40
    repetitions = 2
    shift = detectable_difference(truth, worlds, repetitions)
    world = np.repeat(np.arange(worlds), repetitions)
    draws = shift + generator.normal(0.0, 0.3, (400, worlds))[:, world]
    draws += generator.normal(0.0, math.sqrt(0.18), draws.shape)
    clear = [paired_difference(values, world).p <= 0.05 for values in draws]
    assert np.mean(clear) == pytest.approx(0.8, abs=0.06)


WORLDS = 100
LOOKS = (20, 40, 60, 80, 100)


def builds(better, noise=0.02, worlds=WORLDS):
    """Scores of two builds in the same worlds, one trial each, without failures."""
    generator = np.random.default_rng(6)
    effect = generator.normal(0.28, 0.04, WORLDS)
    pair = (
        effect + gain + generator.normal(0.0, noise, WORLDS) for gain in (0.0, better)
    )
    return [counted(values[:worlds]) for values in pair]


def decided(a, b, order=range(WORLDS), larger=True):
    return decide(a, b, order, LOOKS, larger_is_better=larger)


def test_a_clear_difference_stops_the_plan_early_on_its_side():
    a, b = builds(0.08)
    look = decided(a, b)
    assert look.decision == "better"
    assert 0 < look.worlds < WORLDS
    assert look.difference.low > 0.0
    assert decided(b, a).decision == "worse"
    assert decided(a, b, larger=False).decision == "worse"


def test_a_difference_waits_for_failures_not_yet_observed():
    """In 20 worlds up to 17% of failures may be unseen, which is more than any tenth
    of a score.
    """
    look = decided(*builds(0.03, noise=0.001))
    assert look.decision == "better"
    assert look.worlds >= 40


def test_equal_builds_are_given_up_from_half_of_the_plan_on():
    look = decided(*builds(0.0))
    assert look.decision in ("futile", "open")
    assert look.worlds >= 60


def test_what_is_to_come_is_waited_for():
    assert decided(*builds(0.08, worlds=19)).worlds == 0
    look = decided(*builds(0.004, worlds=25))
    assert (look.decision, look.worlds) == ("continue", 20)


def test_the_first_decision_stands_whatever_comes_after_it():
    a, b = builds(0.08)
    first = decided(a, b)
    values = np.where(np.arange(WORLDS) < first.worlds, b.values, 0.1)
    turned = counted(values, b.failures)
    assert decided(a, turned) == first


def test_worlds_count_in_the_order_in_which_they_come():
    a, b = builds(0.08)
    order = [*range(50, 100), *range(50)]
    later = np.arange(50, 90)
    assert decided(a, b, order) == decided(a.at(later), b.at(later), order)
    with pytest.raises(KeyError):
        decided(a, b, range(50))
