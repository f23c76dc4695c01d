"""Which trajectories are shown: few, spread over all, the cheapest always, none of them worth less than it looks."""

import numpy as np
import pytest
from numpy.testing import assert_allclose, assert_array_equal

from barn_planners.runtime.messages import (
    CHEAPEST_COLOR,
    COSTLIEST_COLOR,
    MAX_CANDIDATES,
    MAX_POINTS,
    REJECTED_COLOR,
    select_candidates,
)

MIDDLE = np.mean([CHEAPEST_COLOR, COSTLIEST_COLOR], axis=0)


def lines(count, length):
    """Return straight lines: candidate k goes from (0, k) to (length - 1, k)."""
    across, along = np.indices((count, length), dtype=float)
    return np.stack([along, across], axis=2)


@pytest.mark.parametrize(
    "count, length", [(1, 1), (3, 2), (20, 8), (21, 9), (140, 80), (5000, 30)]
)
def test_few_are_shown_from_end_to_end(count, length):
    selection = select_candidates(lines(count, length), np.zeros(count))
    shown = min(count, MAX_CANDIDATES)
    assert selection.points.shape == (shown, min(length, MAX_POINTS), 2)
    assert selection.colors.shape == (shown, 4)
    assert_array_equal(selection.points[[0, -1], 0, 1], [0, count - 1])
    assert_array_equal(selection.points[:, 0, 0], 0.0)
    assert_array_equal(selection.points[:, -1, 0], length - 1)
    assert len(np.unique(selection.points[:, 0, 1])) == shown


@pytest.mark.parametrize("cheapest", [0, 1, 68, 139])
def test_the_cheapest_is_shown_in_its_color(cheapest):
    costs = np.full(140, 5.0)
    costs[cheapest] = 1.0
    selection = select_candidates(lines(140, 10), costs)
    is_cheapest = selection.points[:, 0, 1] == cheapest
    assert is_cheapest.sum() == 1
    assert_allclose(selection.colors[is_cheapest], [CHEAPEST_COLOR])
    assert_allclose(selection.colors[~is_cheapest], [COSTLIEST_COLOR] * 19)


@pytest.mark.parametrize(
    "costs, colors",
    [
        (
            [np.inf, 2.0, 4.0, 3.0, np.nan],
            [REJECTED_COLOR, CHEAPEST_COLOR, COSTLIEST_COLOR, MIDDLE, COSTLIEST_COLOR],
        ),
        (None, [COSTLIEST_COLOR] * 5),
        ([np.inf] * 5, [REJECTED_COLOR] * 5),
    ],
)
def test_rejected_ones_are_told_apart_and_costs_may_be_missing(costs, colors):
    costs = None if costs is None else np.array(costs)
    assert_allclose(select_candidates(lines(5, 3), costs).colors, colors)


def test_none_at_all():
    selection = select_candidates(np.empty((0, 5, 2)), np.empty(0))
    assert selection.points.shape[0] == selection.colors.shape[0] == 0
