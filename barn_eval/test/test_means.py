"""Limits of means and differences that count failures: plain cases by hand, and their promises in simulation."""

import math

import numpy as np
import pytest

from barn_eval.analysis.means import (
    Columns,
    counted_interval,
    difference_interval,
    difference_p,
    mean_interval,
)
from barn_eval.analysis.significance import proportion


def counted(values, failures, worlds, as_failure=0.0, best=0.5):
    values = np.asarray(values, float)
    failing = np.asarray(failures), np.full(len(values), as_failure)
    return Columns(values, np.asarray(worlds), np.zeros(len(values), int), *failing, best)


def draw(generator, worlds, repetitions, failing, mean, *, correlation=0.5, effect=None):
    """Trials of a bounded score, 0 for a failure; worlds differ, and so do their chances of failure."""
    world = np.repeat(np.arange(worlds), repetitions)
    effect = generator.normal(0.0, 0.04, worlds) if effect is None else effect
    size = 1.0 / correlation - 1.0
    chances = generator.beta(failing * size, (1.0 - failing) * size, worlds) if failing else np.zeros(worlds)
    failures = (generator.random(len(world)) < chances[world]).astype(np.int64)
    scores = mean + effect[world] + generator.normal(0.0, 0.02, len(world))
    return counted(np.where(failures == 1, 0.0, scores), failures, world)


def test_a_mean_of_symmetric_values_has_students_limits():
    values = np.array([1.0, 2.0, 3.0, 4.0, 5.0])
    found = mean_interval(values, np.arange(5))
    half = 2.7764451051977987 * math.sqrt(2.5 / 5)  # Student's quantile of 4 degrees of freedom
    assert (found.estimate, found.low, found.high) == pytest.approx((3.0, 3.0 - half, 3.0 + half))


def test_a_mean_of_skewed_values_reaches_further_to_their_long_side():
    found = mean_interval(np.array([1.0, 1.1, 1.2, 1.3, 1.2, 1.1, 9.0]), np.arange(7))
    assert found.high - found.estimate > 2.0 * (found.estimate - found.low)


def test_a_mean_depends_on_worlds_and_not_on_the_order_of_trials():
    values, worlds = np.array([1.0, 1.1, 5.0, 5.2, 9.0, 9.1]), np.array([3, 3, 7, 7, 8, 8])
    found = mean_interval(values, worlds)
    turned = mean_interval(values[::-1], worlds[::-1])
    assert found == turned
    means = mean_interval(np.array([1.05, 5.1, 9.05]), np.arange(3))
    assert (found.low, found.high) == pytest.approx((means.low, means.high))


@pytest.mark.parametrize("values", [[], [math.nan, math.nan]])
def test_nothing_has_no_mean(values):
    assert math.isnan(mean_interval(np.array(values, float), np.arange(len(values))).estimate)


def test_one_world_has_no_limits():
    assert mean_interval(np.array([1.0, 2.0]), np.array([4, 4])).low is None
    assert counted_interval(counted([0.3, 0.2], [0, 0], [1, 1])).low is None


def test_failures_that_were_not_seen_lower_the_lower_limit():
    trials = counted([0.30, 0.31, 0.29, 0.30], [0] * 4, range(4))
    unseen = proportion(np.zeros(4, np.int64), np.arange(4)).high
    found = counted_interval(trials)
    assert found.estimate - found.low >= unseen * trials.success_mean
    assert found.high - found.estimate == pytest.approx(
        mean_interval(trials.values, trials.worlds).high - found.estimate
    )


def test_a_failure_that_counts_less_than_a_success_raises_the_mean_of_times():
    """As under the paper's rules, where giving up counts 30 s and a slow success up to 50 s."""
    found = counted_interval(counted([40.0, 41.0, 39.0, 42.0, 40.5], [0] * 5, range(5), as_failure=30.0))
    assert found.estimate - found.low > found.high - found.estimate


def test_where_nothing_succeeded_a_success_may_be_worth_the_best():
    """Of ten failures, one more trial may succeed in the share that Wilson's interval allows."""
    found = counted_interval(counted([0.0] * 10, [1] * 10, range(10)))
    unseen = proportion(np.ones(10, np.int64), np.arange(10)).low
    assert (found.estimate, found.low, found.high) == pytest.approx((0.0, 0.0, 0.5 * (1.0 - unseen)))


def test_one_that_always_fails_is_worse_than_one_that_never_does():
    never, always = (
        counted([1.0] * 12, [0] * 12, range(12), best=1.0),
        counted([0.0] * 12, [1] * 12, range(12), best=1.0),
    )
    assert difference_interval(never, always).low > 0.3
    assert difference_p(never, always) < 0.01


def test_the_p_value_is_where_the_interval_meets_zero():
    generator = np.random.default_rng(3)
    effect = generator.normal(0.0, 0.04, 60)
    a, b = (draw(generator, 60, 2, 0.02, mean, effect=effect) for mean in (0.30, 0.28))
    p = difference_p(a, b)
    assert 1e-6 < p < 1.0
    assert not difference_interval(a, b, 1.0 - 0.99 * p).excludes(0.0)
    assert difference_interval(a, b, 1.0 - 1.01 * p).excludes(0.0)
    assert difference_p(b, a) == pytest.approx(p, rel=1e-6)


def test_a_difference_turns_with_its_sides():
    generator = np.random.default_rng(4)
    a, b = draw(generator, 30, 3, 0.05, 0.30), draw(generator, 30, 3, 0.1, 0.25)
    one, other = difference_interval(a, b), difference_interval(b, a).mirrored()
    assert (one.low, one.high) == pytest.approx((other.low, other.high))


@pytest.mark.parametrize(("worlds", "repetitions", "failing"), [(10, 1, 0.03), (20, 5, 0.005), (50, 5, 0.1)])
def test_means_of_planners_that_rarely_fail_are_covered(worlds, repetitions, failing):
    """At least 93 % in the long run; 13 of 300 are three standard errors."""
    generator = np.random.default_rng(worlds)
    found = [counted_interval(draw(generator, worlds, repetitions, failing, 0.30)) for _ in range(300)]
    truth = 0.30 * (1.0 - failing)
    assert sum(one.low <= truth <= one.high for one in found) >= 0.93 * 300 - 13


@pytest.mark.parametrize("failing", [0.02, 0.05])
def test_a_steady_planner_and_a_quick_one_that_fails_are_rarely_told_apart_at_equal_means(failing):
    generator = np.random.default_rng(5)
    alarms = 0
    for _ in range(200):
        effect = generator.normal(0.0, 0.04, 50)
        steady = draw(generator, 50, 5, 0.0, 0.28, effect=effect)
        quick = draw(generator, 50, 5, failing, 0.28 / (1.0 - failing), effect=effect / (1.0 - failing))
        alarms += difference_interval(steady, quick).excludes(0.0)
    assert alarms <= 0.06 * 200 + 10


@pytest.mark.parametrize(("worlds", "least"), [(10, 0.93), (50, 0.93)])
def test_means_of_skewed_values_are_covered(worlds, least):
    generator = np.random.default_rng(worlds)
    found = [mean_interval(generator.exponential(1.0, worlds), np.arange(worlds)) for _ in range(400)]
    assert sum(one.low <= 1.0 <= one.high for one in found) >= 400 * least - 15  # three standard errors
