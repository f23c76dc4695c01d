"""The bound of the shortest way: never above the shortest way, and hardly below it."""

import math

import numpy as np
import pytest
from scipy.sparse import csr_array
from scipy.sparse.csgraph import dijkstra
from scipy.spatial import cKDTree

from barn_worlds.geometry.shortest import CORNERS, MOST_CYLINDERS, shortest_path_bound_m

STEP = 0.05  # of the grid that ways are searched on by force, in m
PLACES = STEP * np.argwhere(np.ones((41, 41)))
MOVES = cKDTree(PLACES).query_pairs(
    3.7 * STEP, output_type="ndarray"
)  # up to three steps along and two across
ANGLE = math.atan(
    1.0 / 3.0
)  # the largest between two moves: a way of them is at most this much longer than a free one
LONGER = 1.0 / math.cos(0.5 * ANGLE)


def by_force(start, goal, centers, radius):
    """Return the shortest way on a grid, in m, inf without one: never shorter than the shortest way there is."""
    begin = PLACES[MOVES[:, 0], None]
    move = np.diff(PLACES[MOVES], axis=1)
    shares = ((centers - begin) * move).sum(axis=2) / (move**2).sum(axis=2)
    shares = np.clip(shares, 0.0, 1.0)
    off = begin + shares[..., None] * move - centers
    is_free = (np.hypot(off[..., 0], off[..., 1]) >= radius).all(axis=1)
    lengths_m = np.where(is_free, np.hypot(*move[:, 0].T), np.inf)
    ways = csr_array((lengths_m, tuple(MOVES.T)), shape=(len(PLACES), len(PLACES)))
    first, last = cKDTree(PLACES).query([start, goal])[1]
    return dijkstra(ways, directed=False, indices=first)[last]


@pytest.mark.parametrize("seed", range(12))
def test_the_bound_is_below_the_shortest_path_on_a_fine_grid(seed):
    rng = np.random.default_rng(seed)
    radius = rng.uniform(0.1, 0.25)
    centers = rng.uniform(0.3, 1.7, (9, 2))
    ends = np.array([0.0, 1.0]), np.array([2.0, 1.0])
    length = by_force(*ends, centers, radius)
    bound = shortest_path_bound_m(*ends, centers, radius)
    assert 2.0 <= bound <= length + 1e-9
    assert (
        bound >= length / LONGER - 0.1
    )  # what the grid's ways are longer by, and by which they keep off the discs


def test_around_one_disc_the_bound_is_the_taut_string():
    away = 2.0
    radius = 0.5
    ends = np.array([-away, 0.0]), np.array([away, 0.0])
    bound = shortest_path_bound_m(*ends, np.zeros((1, 2)), radius)

    def taut_m(radius):
        straight_m = math.sqrt(away**2 - radius**2)
        return 2.0 * (straight_m + radius * math.asin(radius / away))

    inner = radius * math.cos(math.pi / CORNERS)
    assert taut_m(inner) - 1e-9 <= bound <= taut_m(radius)


def test_through_a_gap_only_a_disc_goes_that_fits():
    wall = np.array([[0.0, 0.1 * k] for k in range(-30, 31) if abs(k) > 3])
    ends = np.array([-1.0, 0.0]), np.array([1.0, 0.0])
    assert shortest_path_bound_m(*ends, wall, 0.39) == 2.0
    assert shortest_path_bound_m(*ends, wall, 0.41) > 6.0


@pytest.mark.parametrize(
    "centers",
    [
        np.empty((0, 2)),
        np.array([[math.cos(0.1 * k), math.sin(0.1 * k)] for k in range(63)]),
        np.tile([5.0, 5.0], (MOST_CYLINDERS + 1, 1)),
    ],
    ids=["no discs", "shut in", "too many"],
)
def test_the_straight_line_is_the_bound_where_no_other_is_found(centers):
    assert shortest_path_bound_m(np.zeros(2), np.array([3.0, 4.0]), centers, 0.2) == 5.0
