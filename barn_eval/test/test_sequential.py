"""Looks at a plan while it runs: what they decide, and that they decide by what has come alone."""

import numpy as np
import pytest
from test_statistics import counted

from barn_eval.analysis.sequential import decide

WORLDS, LOOKS = 100, (20, 40, 60, 80, 100)


def builds(better, noise=0.02, worlds=WORLDS):
    """Scores of two builds in the same worlds, one trial each, without failures."""
    generator = np.random.default_rng(6)
    effect = generator.normal(0.28, 0.04, WORLDS)
    pair = (effect + more + generator.normal(0.0, noise, WORLDS) for more in (0.0, better))
    return [counted(one[:worlds], [0] * worlds, range(worlds)) for one in pair]


def decided(a, b, order=range(WORLDS), larger=True):
    return decide(a, b, order, LOOKS, larger_is_better=larger)


def test_a_clear_difference_stops_the_plan_early_on_its_side():
    a, b = builds(0.08)
    found = decided(a, b)
    assert found.decided == "better"
    assert 0 < found.worlds < WORLDS
    assert found.difference.low > 0.0
    assert decided(b, a).decided == "worse"
    assert decided(a, b, larger=False).decided == "worse"


def test_a_clear_difference_waits_until_failures_not_seen_would_not_turn_it():
    """In 20 worlds up to 17 % of failures may be unseen, which is more than any tenth of a score."""
    found = decided(*builds(0.03, noise=0.001))
    assert found.decided == "better"
    assert found.worlds >= 40


def test_equal_builds_are_given_up_from_half_of_the_plan_on():
    found = decided(*builds(0.0))
    assert found.decided in ("futile", "open")
    assert found.worlds >= 60


def test_what_is_to_come_is_waited_for():
    assert decided(*builds(0.08, worlds=19)).worlds == 0
    found = decided(*builds(0.004, worlds=25))
    assert (found.decided, found.worlds) == ("continue", 20)


def test_the_first_decision_stands_whatever_comes_after_it():
    a, b = builds(0.08)
    first = decided(a, b)
    turned = counted(np.where(np.arange(WORLDS) < first.worlds, b.values, 0.1), b.failures, range(WORLDS))
    assert decided(a, turned) == first


def test_worlds_count_in_the_order_in_which_they_come():
    a, b = builds(0.08)
    order = [*range(50, 100), *range(50)]
    there = np.arange(50, 90)
    assert decided(a, b, order) == decided(a.at(there), b.at(there), order)
    with pytest.raises(KeyError):
        decided(a, b, range(50))
