"""How many worlds are enough: components of variance by hand and by simulation, and counts that just suffice."""

import math

import numpy as np
import pytest

from barn_eval.analysis.significance import (
    Components,
    components,
    detectable_difference,
    half_width,
    paired_difference,
    worlds_for_difference,
    worlds_for_half_width,
)


def test_components_by_hand():
    found = components(np.array([1.0, 3.0, 5.0, 7.0]), np.array([0, 0, 1, 1]))
    assert found == Components(pytest.approx((16.0 - 2.0) / 2.0), pytest.approx(2.0))
    assert components(np.array([1.0, 3.0]), np.array([0, 1])) == Components(pytest.approx(2.0), 0.0)
    assert math.isnan(components(np.array([1.0, 3.0]), np.array([0, 0])).between)
    assert components(np.array([1.0, 3.0, 1.0, 3.0]), np.array([0, 0, 1, 1])).between == 0.0


def test_components_of_uneven_worlds_are_unbiased():
    generator = np.random.default_rng(3)
    worlds = np.repeat(np.arange(200), generator.integers(1, 6, 200))
    found = [
        components(generator.normal(0.0, 2.0, 200)[worlds] + generator.normal(0.0, 1.0, len(worlds)), worlds)
        for _ in range(200)
    ]
    assert np.mean([one.between for one in found]) == pytest.approx(4.0, rel=0.03)
    assert np.mean([one.within for one in found]) == pytest.approx(1.0, rel=0.03)


def test_counts_just_suffice():
    found = Components(0.04, 0.02)
    for repetitions in (1, 5):
        enough = worlds_for_half_width(found, 0.03, repetitions)
        assert half_width(found, enough, repetitions) <= 0.03 < half_width(found, enough - 1, repetitions)
        enough = worlds_for_difference(found, 0.03, repetitions)
        assert (
            detectable_difference(found, enough, repetitions)
            <= 0.03
            < detectable_difference(found, enough - 1, repetitions)
        )
    assert worlds_for_half_width(found, 1e-9, 1) is None
    assert half_width(found, 1, 5) == math.inf


def test_a_detectable_difference_is_found_as_often_as_promised():
    generator = np.random.default_rng(4)
    truth, worlds, repetitions = Components(0.09, 0.18), 40, 2
    shift = detectable_difference(truth, worlds, repetitions)
    world = np.repeat(np.arange(worlds), repetitions)
    found = 0
    for _ in range(400):
        values = shift + generator.normal(0.0, 0.3, worlds)[world] + generator.normal(0.0, math.sqrt(0.18), len(world))
        found += paired_difference(values, world).p <= 0.05
    assert found / 400 == pytest.approx(0.8, abs=0.06)
