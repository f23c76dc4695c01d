"""C-space and flood fill against plain versions and the original data."""

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from hypothesis.extra import numpy as npst

from barn_worlds.base.errors import WorldError
from barn_worlds.worlds.cspace import configuration_space, label_regions, through_region
from barn_worlds.worlds.dataset import open_dataset

GRIDS = npst.arrays(bool, st.tuples(st.integers(1, 14), st.integers(1, 14)))


def plain_cspace(grid, side):
    reach = side // 2
    result = np.zeros_like(grid)
    for row, col in np.ndindex(grid.shape):
        result[row, col] = grid[max(0, row - reach) : row + reach + 1, max(0, col - reach) : col + reach + 1].any()
    return result


def plain_regions(free, steps):
    """Regions as a set of frozen sets of cells."""
    left = {tuple(cell) for cell in np.argwhere(free).tolist()}
    regions = set()
    while left:
        region, border = set(), {left.pop()}
        while border:
            row, col = border.pop()
            region.add((row, col))
            near = {(row + dr, col + dc) for dr, dc in steps} & left
            left -= near
            border |= near
        regions.add(frozenset(region))
    return regions


FOUR = [(0, 1), (1, 0), (0, -1), (-1, 0)]
EIGHT = [*FOUR, (1, 1), (1, -1), (-1, 1), (-1, -1)]


@given(GRIDS, st.integers(0, 8).map(lambda k: 2 * k + 1))
def test_cspace_equals_the_plain_rule_for_any_footprint(grid, side):
    assert np.array_equal(configuration_space(grid, side), plain_cspace(grid, side))


@pytest.mark.parametrize("side", [0, -1, 2, 4])
def test_footprints_that_have_no_middle_cell_are_refused(side):
    with pytest.raises(WorldError, match="footprint must be an odd number"):
        configuration_space(np.zeros((3, 3), bool), side)


def test_cspaces_equal_the_original_ones(original_folder):
    dataset = open_dataset(original_folder)
    for index in dataset.indices:
        expected = np.load(original_folder / "cspace_files" / f"cspace_{index}.npy")
        world = dataset.load(index)
        assert world.footprint_cells == 5
        assert np.array_equal(world.cspace, expected == 1), index


@given(GRIDS, st.sampled_from([4, 8]))
def test_regions_equal_the_plain_ones(free, neighbours):
    labels, sizes = label_regions(free, neighbours)
    found = {frozenset(map(tuple, np.argwhere(labels == label).tolist())) for label in range(1, len(sizes))}
    assert found == plain_regions(free, FOUR if neighbours == 4 else EIGHT)
    assert np.array_equal(labels == 0, ~free)
    assert sizes.tolist() == [0, *(np.count_nonzero(labels == label) for label in range(1, len(sizes)))]


@given(GRIDS)
def test_the_region_through_is_the_largest_at_both_ends(cspace):
    regions = plain_regions(~cspace, FOUR)
    last = cspace.shape[1] - 1
    at_start = [region for region in regions if any(col == 0 for _, col in region)]
    at_end = [region for region in regions if any(col == last for _, col in region)]
    region = through_region(cspace)
    if region is None:
        largest = max(map(len, at_start), default=0), max(map(len, at_end), default=0)
        both = [r for r in at_start if r in at_end and (len(r), len(r)) == largest]
        # several largest: the first in reading order counts, which need not be the same at both ends
        ties = sum(len(r) == largest[0] for r in at_start) + sum(len(r) == largest[1] for r in at_end)
        assert not both or ties > 2
    else:
        cells = frozenset(map(tuple, np.argwhere(region).tolist()))
        assert cells in at_start
        assert cells in at_end
        assert len(cells) == max(map(len, at_start)) == max(map(len, at_end))
