"""Features of worlds against values worked out by hand and slow references."""

import itertools
import math

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from hypothesis.extra.numpy import array_shapes, arrays
from pytest import approx
from scipy.spatial.distance import cdist

from barn_metrics.features import (
    heading_changes,
    path_clearance,
    sharpest_turn,
    widest_gap_m,
    without_repeats,
    world_features,
)
from barn_worlds.base.arrays import side_lengths
from barn_worlds.worlds.world import World

RESOLUTION = 0.15

steps = st.sampled_from(
    [step for step in itertools.product((-1, 0, 1), repeat=2) if any(step)]
)
paths = st.lists(steps, min_size=1, max_size=40).map(
    lambda moves: np.cumsum([(0, 0), *moves], axis=0)
)


def reference_gap(grid):
    """The least of all largest gaps on ways from edge to edge that step from obstacle to obstacle, in cells."""
    cells = np.argwhere(grid)
    from_top = cells[:, 0]
    rows = float(len(grid))
    # the upper edge, the lower one, and every obstacle
    gaps = np.full((len(cells) + 2, len(cells) + 2), rows)
    gaps[2:, 2:] = cdist(cells, cells) - 1.0
    gaps[0, 2:] = gaps[2:, 0] = from_top
    gaps[1, 2:] = gaps[2:, 1] = rows - 1 - from_top
    for k in range(len(gaps)):
        by_way_of_k = np.maximum(gaps[:, k, None], gaps[k])
        gaps = np.minimum(gaps, by_way_of_k)
    return max(0.0, gaps[0, 1])


@given(arrays(bool, array_shapes(min_dims=2, max_dims=2, max_side=7)))
@settings(max_examples=150, deadline=None)
def test_widest_gap_equals_the_reference(grid):
    expected = reference_gap(grid) * RESOLUTION
    assert widest_gap_m(grid, RESOLUTION) == pytest.approx(expected)


def test_the_original_worlds_let_a_robot_of_five_cells_through(originals):
    for world in originals:
        assert widest_gap_m(world.grid, RESOLUTION) >= 5 * RESOLUTION - 1e-9


@given(path=paths, window=st.floats(0.0, 2.0))
@settings(max_examples=100, deadline=None)
def test_sharpest_turn_equals_the_reference(path, window):
    lengths = RESOLUTION * side_lengths(path)
    turning = heading_changes(path)
    at = np.cumsum(lengths)[:-1]
    expected = 0.0
    for first, last in itertools.combinations_with_replacement(range(len(turning)), 2):
        if at[last] - at[first] <= window + 1e-9:
            expected = max(expected, abs(sum(turning[first : last + 1])))
    assert sharpest_turn(turning, lengths, window) == pytest.approx(expected)


def test_clearance_is_between_surfaces_and_side_edges():
    grid = np.zeros((9, 9), bool)
    grid[4, 4] = True
    path = np.array([[4, 1], [1, 4], [7, 7], [0, 0]])
    expected = [2.5, 1.5, 1.5, 0.5]
    assert path_clearance(grid, path, 2.0) == pytest.approx(2 * np.array(expected))


def test_features_of_a_corridor_with_a_door():
    grid = np.zeros((11, 20), bool)
    grid[[0, -1]] = True
    grid[1:3, 10] = grid[8:10, 10] = True
    path = np.array([[5, 0], *([5, column] for column in range(20))])
    world = World("door", grid, path, footprint_cells=3)
    features = world_features(world)
    filled = 2 * 20 + 4
    expected = {
        "path_length_m": approx(19 * RESOLUTION),
        "tortuosity": 1,
        "lateral_shift_m": 0,
        "clearance_min_m": approx(2.5 * RESOLUTION),
        "clearance_p50_m": approx(4.5 * RESOLUTION),
        # 0.55 m are 3.67 cells: columns 8 to 12 are within 4.17 cells of the door's posts, three rows away
        "narrow_passages": 1,
        "narrow_share": approx(5 / 20),
        "longest_narrow_m": approx(4 * RESOLUTION),
        "widest_gap_m": approx(5 * RESOLUTION),
        "turning_total_rad": 0,
        "turns": 0,
        "reversals": 0,
        "filled_share": approx(filled / (11 * 20)),
    }
    assert {name: features[name] for name in expected} == expected


def test_turning_of_a_zigzag():
    path = np.array([[5, 0], [5, 1], [4, 2], [4, 3], [5, 4], [5, 5]])
    features = world_features(World("zigzag", np.zeros((11, 6), bool), path))
    length_m = (3 + 2 * math.sqrt(2)) * RESOLUTION
    expected = {
        "turns": 4,
        "turning_total_rad": approx(math.pi),
        "reversals": 2,  # left, right, right, left
        "turning_sharpest_rad": approx(math.pi / 2),
        "turning_rad_per_m": approx(math.pi / length_m),
    }
    assert {name: features[name] for name in expected} == expected


def test_a_path_of_one_cell_has_finite_features():
    path = np.array([[2, 2], [2, 2]])
    features = world_features(World("still", np.zeros((5, 5), bool), path))
    assert len(features) == 22
    assert np.isfinite(list(features.values())).all()


def test_repeats_in_place_are_dropped_and_returns_are_kept():
    path = np.array([[0, 0], [0, 0], [0, 1], [0, 1], [0, 0]])
    assert without_repeats(path).tolist() == [[0, 0], [0, 1], [0, 0]]


def test_features_of_originals_are_finite_and_symmetric(originals):
    for original in originals[::7]:
        last = len(original.grid) - 1
        path = np.abs(original.path - [last, 0])
        world = World("as it is", original.grid, original.path)
        mirrored = World("mirrored", original.grid[::-1].copy(), path)
        features = world_features(mirrored)
        assert np.isfinite(list(features.values())).all()
        assert world_features(world) == pytest.approx(features, rel=1e-7, abs=1e-12)
