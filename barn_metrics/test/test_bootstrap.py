"""Intervals over worlds against draws written out, and the one way in which estimates are written."""

import math

import numpy as np
import pytest
from scipy import stats

from barn_metrics.bootstrap import (
    Interval,
    bootstrap_interval,
    correlation,
    number,
    spearman,
)

VALUES = np.random.default_rng(1).gamma(2.0, 3.0, 30)


def mean(sample):
    return VALUES[sample].mean(axis=-1)


def mean_or(figure):
    """Return the mean number of a sample, or a figure where all numbers are alike."""

    def statistic(sample):
        return np.where(np.ptp(sample, axis=-1) > 0, sample.mean(axis=-1), figure)

    return statistic


def constant(figure):
    return lambda sample: np.full(sample.shape[:-1], figure)


def plain_draws():
    generator = np.random.default_rng(4)
    count = len(VALUES)
    draws = [generator.integers(0, count, count) for _ in range(1000)]
    return np.array([mean(draw) for draw in draws])


def test_percentile_limits_are_quantiles_of_the_draws():
    interval = bootstrap_interval(
        mean, len(VALUES), seed=4, percentile=True, resamples=1000
    )
    expected = np.quantile(plain_draws(), [0.025, 0.975])
    assert interval.estimate == VALUES.mean()
    assert (interval.low, interval.high) == pytest.approx(tuple(expected), rel=1e-12)


def test_bca_limits_are_those_of_efrons_formula():
    interval = bootstrap_interval(mean, len(VALUES), seed=4, resamples=1000)
    draws = plain_draws()
    estimate = VALUES.mean()
    below = (draws < estimate).mean() + 0.5 * (draws == estimate).mean()
    bias = stats.norm.ppf(below)
    left_out = np.array([np.delete(VALUES, at).mean() for at in range(len(VALUES))])
    deviation = left_out.mean() - left_out
    spread = (deviation**2).sum() ** 1.5
    skew = (deviation**3).sum() / (6.0 * spread)
    z = bias + stats.norm.ppf([0.025, 0.975])
    levels = stats.norm.cdf(bias + z / (1.0 - skew * z))
    expected = np.quantile(draws, levels)
    assert (interval.low, interval.high) == pytest.approx(tuple(expected), rel=1e-9)


def test_an_interval_is_of_95_percent_from_10_000_draws():
    interval = bootstrap_interval(mean, len(VALUES))
    defaults = {"seed": 0, "percentile": False, "resamples": 10_000}
    assert interval == bootstrap_interval(mean, len(VALUES), **defaults)
    for other in (
        {"seed": 1},
        {"percentile": True},
        {"resamples": 9_999},
        {"resamples": 10_001},
    ):
        assert interval != bootstrap_interval(mean, len(VALUES), **other), other


def test_draws_without_a_figure_are_left_out():
    unless_alike = mean_or(np.nan)
    interval = bootstrap_interval(unless_alike, 3, percentile=True)
    assert interval.low < interval.estimate < interval.high
    assert bootstrap_interval(unless_alike, 3) == Interval(1.0)
    none = bootstrap_interval(constant(np.nan), 3, percentile=True)
    assert none.low is None


def test_a_limit_that_is_infinite_is_none():
    assert bootstrap_interval(mean_or(np.inf), 3) == Interval(1.0)


@pytest.mark.filterwarnings("error")
@pytest.mark.parametrize("percentile", [False, True])
def test_one_world_has_no_limits_and_raises_no_warning(percentile):
    single = bootstrap_interval(mean_or(0.0), 1, percentile=percentile)
    assert single == Interval(0.0)
    same = bootstrap_interval(constant(1.0), 5, percentile=percentile)
    assert same == Interval(1.0)


def test_numbers_have_no_signed_zero_and_none_is_a_dash():
    written = {
        -0.004: "0.00",
        -0.0: "0.00",
        0.004: "0.00",
        -0.006: "-0.01",
        12.345: "12.35",
    }
    assert {value: number(value) for value in written} == written
    assert number(-0.0004, 3) == "0.000"
    assert [number(value) for value in (None, math.nan, -math.inf)] == ["-"] * 3


def test_an_interval_is_written_with_its_limits():
    interval = Interval(0.51234, 0.4, 0.6)
    assert interval.text(3) == "0.512 [0.400, 0.600]"
    assert interval.scale(100.0).text(0, "%") == "51% [40, 60]"
    assert Interval(-0.001, -0.002, 0.0).text() == "0.00 [0.00, 0.00]"
    assert (Interval(2.0).text(1), Interval(math.nan).text()) == ("2.0", "-")
    assert Interval(2.0).scale(3.0) == Interval(6.0)


def test_one_limit_alone_is_none():
    for half in (Interval(1.0, 0.5, None), Interval(1.0, None, 2.0)):
        assert half.text() == "1.00"
        assert half.widen_to(0.0, 3.0) == half


def test_an_interval_reaches_what_it_is_to_hold():
    interval = Interval(1.0, 0.5, 2.0)
    assert interval.widen_to(3.0, 0.2) == Interval(1.0, 0.2, 3.0)
    assert interval.widen_to(0.7) == interval


def test_columns_of_an_interval_are_named_after_it():
    columns = Interval(2.0, 1.0, 4.0).columns("x")
    assert columns == {"x": 2.0, "x_low": 1.0, "x_high": 4.0}


def test_an_interval_is_mirrored_with_its_limits():
    interval = Interval(1.0, 0.5, 2.0)
    assert interval.negate() == Interval(-1.0, -2.0, -0.5)
    assert Interval(1.0).negate() == Interval(-1.0)


@pytest.mark.parametrize("kind", [np.int64, np.float64])
def test_rank_correlations_are_those_of_scipy(kind):
    pairs = np.random.default_rng(3).integers(1, 7, (2, 4, 3, 8)).astype(kind)
    expected = [
        stats.spearmanr(first, other).statistic
        for first, other in zip(*pairs.reshape(2, -1, 8), strict=True)
    ]
    np.testing.assert_allclose(spearman(*pairs), np.reshape(expected, (4, 3)))


def test_what_varies_by_rounding_only_has_no_correlation():
    values = np.array([0.0, 1.0])
    correlations = [
        correlation(values, step * values) for step in (1.9e-12, 2e-12, 2.1e-12)
    ]
    np.testing.assert_allclose(correlations, [math.nan, math.nan, 1.0])
