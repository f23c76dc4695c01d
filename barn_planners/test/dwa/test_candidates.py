"""Which trajectories are shown: few, spread over all, the cheapest always, none of them worth less than it looks."""

import numpy as np
import pytest

from barn_planners.runtime.messages import (
    CHEAPEST_COLOR,
    COSTLIEST_COLOR,
    MAX_CANDIDATES,
    MAX_POINTS,
    REJECTED_COLOR,
    select_candidates,
)


def lines(count, length):
    """Return straight lines: candidate k goes from (0, k) to (length - 1, k)."""
    along, across = np.meshgrid(
        np.arange(length, dtype=float), np.arange(count, dtype=float)
    )
    return np.stack([along, across], axis=2)


@pytest.mark.parametrize(
    "count, length", [(1, 1), (3, 2), (20, 8), (21, 9), (140, 80), (5000, 30)]
)
def test_few_are_shown_from_end_to_end(count, length):
    selection = select_candidates(lines(count, length), np.zeros(count))
    assert selection.points.shape == (
        min(count, MAX_CANDIDATES),
        min(length, MAX_POINTS),
        2,
    )
    assert selection.colors.shape == (min(count, MAX_CANDIDATES), 4)
    np.testing.assert_array_equal(selection.points[[0, -1], 0, 1], [0, count - 1])
    np.testing.assert_array_equal(selection.points[:, 0, 0], 0.0)
    np.testing.assert_array_equal(selection.points[:, -1, 0], length - 1)
    assert len(np.unique(selection.points[:, 0, 1])) == len(selection.points)


@pytest.mark.parametrize("cheapest", [0, 1, 68, 139])
def test_the_cheapest_is_shown_in_its_color(cheapest):
    costs = np.full(140, 5.0)
    costs[cheapest] = 1.0
    selection = select_candidates(lines(140, 10), costs)
    (place,) = np.flatnonzero(selection.points[:, 0, 1] == cheapest)
    np.testing.assert_allclose(selection.colors[place], CHEAPEST_COLOR)
    np.testing.assert_allclose(
        np.delete(selection.colors, place, axis=0), [COSTLIEST_COLOR] * 19
    )


def test_rejected_ones_are_told_apart_and_costs_may_be_missing():
    costs = np.array([np.inf, 2.0, 4.0, 3.0, np.nan])
    colors = select_candidates(lines(5, 3), costs).colors
    np.testing.assert_allclose(colors[[0, 4]], [REJECTED_COLOR] * 2)
    np.testing.assert_allclose(colors[[1, 2]], [CHEAPEST_COLOR, COSTLIEST_COLOR])
    np.testing.assert_allclose(
        colors[3], 0.5 * (np.array(CHEAPEST_COLOR) + np.array(COSTLIEST_COLOR))
    )
    np.testing.assert_allclose(
        select_candidates(lines(5, 3), None).colors, [COSTLIEST_COLOR] * 5
    )
    np.testing.assert_allclose(
        select_candidates(lines(3, 3), np.full(3, np.inf)).colors, [REJECTED_COLOR] * 3
    )


def test_none_at_all():
    selection = select_candidates(np.empty((0, 5, 2)), np.empty(0))
    assert selection.points.shape[0] == selection.colors.shape[0] == 0
