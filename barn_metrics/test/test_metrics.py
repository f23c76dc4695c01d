"""The metrics against slow references, against values worked out by hand and against the published numbers."""

import math

import numpy as np
import pytest
from hypothesis import example, given, settings
from hypothesis import strategies as st
from hypothesis.extra.numpy import array_shapes, arrays
from numpy.testing import assert_allclose, assert_array_equal
from refusals import refused

from barn_metrics.metrics import (
    CELL_METRICS,
    CORRECTED,
    FORMULAS,
    METRIC_NAMES,
    Formula,
    WorldMetrics,
    as_formula,
    cell_metrics,
    mean_metrics,
    metric_maps,
    tortuosity,
    world_metrics,
)
from barn_metrics.report import TABLE_II
from barn_worlds.base.errors import WorldError
from barn_worlds.worlds.world import World


def path_metrics(cspace, path, formula="corrected"):
    return mean_metrics(cell_metrics(cspace, path, formula), path)


COMPASS = [(0, 1), (1, 1), (1, 0), (1, -1), (0, -1), (-1, -1), (-1, 0), (-1, 1)]
CIRCLE = [
    *[(0, 1), (1, 2), (1, 1), (2, 1), (1, 0), (2, -1), (1, -1), (1, -2)],
    *[(0, -1), (-2, -1), (-1, -1), (-1, -2), (-1, 0), (-2, 1), (-1, 1), (-1, 2)],
]
ANGLES_DEG = {4: [0, 45, 90, 135], 8: [0, 22.5, 45, 67.5, 90, 112.5, 135, 157.5]}


def _grid_with(shape, cells):
    grid = np.zeros(shape, bool)
    for row, column in cells:
        grid[row % shape[0], column % shape[1]] = True
    return grid


grids = arrays(
    bool,
    array_shapes(min_dims=2, max_dims=2, min_side=1, max_side=14),
    elements=st.booleans(),
)
sparse_grids = st.builds(
    _grid_with,
    st.tuples(st.integers(1, 25), st.integers(1, 25)),
    st.lists(st.tuples(st.integers(0, 24), st.integers(0, 24)), max_size=12),
)


def _look(cspace, cell, direction=(0, 0), steps=0):
    """Return the content of the cell so many steps away: "outside", "occupied" or "free"."""
    row = round(cell[0] + steps * direction[0])
    column = round(cell[1] + steps * direction[1])
    if not (0 <= row < cspace.shape[0] and 0 <= column < cspace.shape[1]):
        return "outside"
    return "occupied" if cspace[row, column] else "free"


def _ray(cspace, cell, direction):
    """Return the number of free cells from the cell itself on, and what ends the ray."""
    count = 0
    while _look(cspace, cell, direction, count) == "free":
        count += 1
    return count, _look(cspace, cell, direction, count)


def reference_closest(cspace, cell):
    distances = [math.dist(cell, other) for other in np.argwhere(cspace)]
    return min(distances, default=math.inf)


def reference_visibility(cspace, cell, corrected):
    rays = [_ray(cspace, cell, direction) for direction in COMPASS]
    if corrected:
        lengths = np.hypot(*np.transpose(COMPASS))
        return lengths @ [count for count, _ in rays] / 8
    ended = [count for count, end in rays if end == "occupied"]
    return sum(ended) // len(ended) if ended else math.nan


def reference_dispersion(cspace, cell, variant):
    signs = []
    by_angle = sorted(CIRCLE, key=lambda way: math.atan2(*way) % (2 * math.pi))
    for direction in by_angle if variant == "ordered" else CIRCLE:
        is_oblique = abs(direction[0]) + abs(direction[1]) == 3
        is_long = variant == "published" and max(direction) < 2
        points = 2 if is_oblique and not is_long else 3
        steps = range(1, points + 1)
        neighbors = [_look(cspace, cell, direction, step) for step in steps]
        signs.append("occupied" in neighbors)
    return sum(signs[k] != signs[k - 1] for k in range(16))


def reference_characteristic(cspace, cell, axes):
    """Walk along the true angle: whole steps of the longer component, the shorter one to the nearest cell."""
    lengths = []
    for angle in np.radians(ANGLES_DEG[axes]):
        direction = np.array([math.sin(angle), math.cos(angle)])
        direction /= abs(direction).max()
        there, _ = _ray(cspace, cell, direction)
        back, _ = _ray(cspace, cell, -direction)
        lengths.append((there + back - 2) * np.hypot(*direction))
    return min(lengths)


def reference(cspace, cell, formula):
    return [
        reference_closest(cspace, cell),
        reference_visibility(cspace, cell, formula.visibility == "corrected"),
        reference_dispersion(cspace, cell, formula.dispersion),
        reference_characteristic(cspace, cell, formula.axes),
    ]


@pytest.mark.parametrize("formula", [*FORMULAS.values(), Formula(dispersion="even")])
@given(cspace=st.one_of(grids, sparse_grids))
@example(cspace=np.zeros((1, 1), bool))
@example(cspace=np.zeros((3, 17), bool))
@example(cspace=np.pad(np.zeros((5, 9), bool), ((1, 1), (0, 0)), constant_values=True))
@settings(max_examples=30, deadline=None)
def test_every_free_cell_equals_the_plain_reference(formula, cspace):
    free = np.argwhere(~cspace)
    expected = [reference(cspace, tuple(cell), formula) for cell in free.tolist()]
    metrics = cell_metrics(cspace, free, formula)
    assert_allclose(metrics, np.reshape(expected, (-1, 4)), rtol=0, atol=1e-9)


@pytest.mark.parametrize("formula, within", [("published", 1e-9), ("corrected", 1e-6)])
def test_a_formula_gives_the_values_that_it_is_named_after(originals, formula, within):
    for world in originals:
        ours = path_metrics(world.cspace, world.path, formula).as_array()
        theirs = getattr(world, formula)
        assert_allclose(ours, theirs, rtol=0, atol=within)
    assert len(originals) == 50


def test_the_published_dimension_differs_from_its_paths(originals):
    """What docs/metrics.md says of Table II: the paper's maximum over cells is 20.00."""
    largest = max(
        cell_metrics(world.cspace, world.path, "published")[:, 3].max()
        for world in originals
    )
    assert largest == 22 > TABLE_II["characteristic_dimension"]["maximum"]


@given(cspace=sparse_grids)
@settings(max_examples=40, deadline=None)
def test_maps_hold_cell_values_and_nothing_where_occupied(cspace):
    maps = metric_maps(cspace)
    free = np.argwhere(~cspace)
    values = cell_metrics(cspace, free)
    assert list(maps) == [metric.name for metric in CELL_METRICS]
    for column, picture in enumerate(maps.values()):
        assert_array_equal(picture[~cspace], values[:, column])
        assert np.isnan(picture[cspace]).all()


def test_repeated_cells_count_as_often_as_they_occur():
    grid = np.zeros((5, 6), bool)
    grid[0] = True
    path = [[1, 0], [2, 1], [3, 2]]
    once = path_metrics(grid, np.array(path))
    twice = path_metrics(grid, np.array([path[0], *path]))
    assert (once.closest_obstacle, twice.closest_obstacle) == (2, 1.75)
    assert once.tortuosity == twice.tortuosity == 1


@pytest.mark.parametrize(
    "path, expected",
    [
        ([[3, 4]], 1),
        ([[3, 4], [3, 4]], 1),
        ([[3, 4], [3, 5], [3, 4]], math.inf),
        ([[0, 0], [1, 1], [0, 2]], pytest.approx(math.sqrt(2))),
    ],
)
def test_tortuosity_of_paths_without_a_chord(path, expected):
    assert tortuosity(np.array(path)) == expected


@pytest.mark.parametrize(
    "cells, message",
    [
        ([[0, 0], [1, 1]], r"occupied C-space cell \[1, 1\]"),
        ([[-1, 0]], "leaves the grid"),
        ([[4, 0]], "leaves the grid"),
        ([[0, 5]], "leaves the grid"),
        ([[0.5, 0.0]], "whole rows"),
    ],
)
def test_cells_where_the_metrics_have_no_meaning_are_refused(cells, message):
    grid = np.zeros((4, 5), bool)
    grid[1, 1] = True
    with refused(message, WorldError):
        path_metrics(grid, np.array(cells))


def test_a_cspace_of_other_values_is_refused():
    with refused("bools", WorldError):
        path_metrics(np.zeros((4, 5), int), np.array([[0, 0]]))


def test_a_robot_that_does_not_fit_is_named_with_its_world():
    grid = np.zeros((7, 7), bool)
    grid[0] = grid[6] = True
    path = np.array([[2, column] for column in range(7)])
    fits = World("fits", grid, path, footprint_cells=3)
    assert world_metrics(fits).closest_obstacle == 1
    with refused(r"^tight: .*\[2, 0\] \(footprint 5 cells\)$", WorldError):
        world_metrics(World("tight", grid, path, footprint_cells=5))


def test_formulas_have_clear_names_and_unknown_ones_are_refused():
    assert as_formula("corrected") is CORRECTED is as_formula(CORRECTED)
    with refused("did you mean 'published'"):
        as_formula("publishd")
    with refused("must be 4 or 8, got 6"):
        Formula(axes=6)
    with refused("visibility"):
        Formula(visibility="rounded")
    assert tuple(WorldMetrics.__dataclass_fields__) == METRIC_NAMES
