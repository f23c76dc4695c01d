"""The automaton against the paper's Algorithm 1 written out cell by cell."""

import itertools

import numpy as np
from hypothesis import given
from hypothesis import strategies as st
from hypothesis.extra import numpy as npst

from barn_worlds.worlds.generate import TABLE_I, WorldParameters, grow, iterations, smooth

GRIDS = npst.arrays(bool, st.tuples(st.integers(1, 12), st.integers(1, 12)))


def plain_smooth(grid, fill_threshold, clear_threshold):
    rows, cols = grid.shape
    result = grid.copy()
    for row in range(rows):
        for col in range(cols):
            count = 0
            for r in (row - 1, row, row + 1):
                for c in (col - 1, col, col + 1):
                    if (r, c) == (row, col):
                        continue
                    if r < 0 or r >= rows:
                        count += 1
                    elif 0 <= c < cols:
                        count += grid[r, c]
            if count >= fill_threshold:
                result[row, col] = True
            elif count <= clear_threshold:
                result[row, col] = False
    return result


@given(GRIDS, st.integers(0, 9), st.integers(-1, 8))
def test_smoothing_equals_the_plain_rule(grid, fill, clear):
    before = grid.copy()
    assert np.array_equal(smooth(grid, fill, min(clear, fill - 1)), plain_smooth(grid, fill, min(clear, fill - 1)))
    assert np.array_equal(grid, before)


@given(st.integers(0, 2**32), st.sampled_from(TABLE_I))
def test_iterations_are_successive_and_keep_the_side_walls(seed, parameters):
    grids = list(iterations(parameters, np.random.default_rng(seed)))
    assert len(grids) == parameters.smoothing_iterations + 1
    for before, after in itertools.pairwise(grids):
        assert np.array_equal(after, smooth(before, 5, 1))
    assert all(grid[[0, -1]].all() for grid in grids)
    assert np.array_equal(grow(parameters, np.random.default_rng(seed)), grids[-1])


def test_random_fill_has_the_share_asked_for():
    parameters = WorldParameters(initial_fill=0.3, rows=402, cols=500)
    inner = next(iterations(parameters, np.random.default_rng(1)))[1:-1]
    assert abs(inner.mean() - 0.3) < 4 * np.sqrt(0.21 / inner.size)


def test_table_i_has_the_twelve_sets_of_the_paper():
    assert {(p.initial_fill, p.smoothing_iterations) for p in TABLE_I} == {
        (fill, count) for fill in (0.15, 0.20, 0.25, 0.30) for count in (2, 3, 4)
    }
    assert {(p.fill_threshold, p.clear_threshold, p.rows, p.cols) for p in TABLE_I} == {(5, 1, 30, 30)}
