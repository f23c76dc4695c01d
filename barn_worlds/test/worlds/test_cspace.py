"""C-space against SciPy and the original data, regions against a flood fill."""

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from hypothesis.extra import numpy as npst
from refusals import refused
from scipy import ndimage

from barn_worlds.base.errors import WorldError
from barn_worlds.datasets.dataset import open_dataset
from barn_worlds.worlds.cspace import configuration_space, label_regions, through_region

GRIDS = npst.arrays(bool, st.tuples(st.integers(1, 14), st.integers(1, 14)))


@given(GRIDS, st.integers(0, 8).map(lambda k: 2 * k + 1))
def test_the_cspace_is_filled_where_the_footprint_is(grid, side):
    assert np.array_equal(
        configuration_space(grid, side),
        ndimage.maximum_filter(grid, side, mode="constant"),
    )


@pytest.mark.parametrize("side", [0, -1, 2, 4])
def test_footprints_that_have_no_middle_cell_are_refused(side):
    with refused("footprint must be an odd number", WorldError):
        configuration_space(np.zeros((3, 3), bool), side)


def test_cspaces_equal_the_original_ones(original_folder):
    dataset = open_dataset(original_folder)
    for index in dataset.world_numbers:
        expected = np.load(original_folder / "cspace_files" / f"cspace_{index}.npy")
        world = dataset.load(index)
        assert world.footprint_cells == 5
        assert np.array_equal(world.cspace, expected == 1), index


@given(GRIDS, st.sampled_from([4, 8]))
def test_regions_are_labeled_and_counted_in_reading_order(free, neighbors):
    structure = ndimage.generate_binary_structure(2, 1 if neighbors == 4 else 2)
    expected = np.zeros(free.shape, int)
    counts = [0]
    for row, column in np.argwhere(free):
        if not expected[row, column]:
            seed = np.zeros_like(free)
            seed[row, column] = True
            region = ndimage.binary_propagation(seed, structure, free)
            expected[region] = len(counts)
            counts.append(region.sum())
    labels, sizes = label_regions(free, neighbors)
    assert np.array_equal(labels, expected)
    assert sizes.tolist() == counts


@given(GRIDS)
def test_the_region_through_is_the_largest_at_both_ends(cspace):
    labels, _ = ndimage.label(~cspace)
    sizes = np.bincount(labels[~cspace], minlength=1)
    # of several largest, the first in reading order counts, which need not be the same at both ends
    first, last = (
        max(np.unique(labels[:, end]), key=sizes.__getitem__) for end in (0, -1)
    )
    region = through_region(cspace)
    assert (region is not None) == (first == last != 0)
    assert region is None or np.array_equal(region, labels == first)


def test_the_first_of_equal_regions_counts():
    free = np.zeros((8, 7), bool)
    free[0, 1:] = free[:, 6] = free[7] = True
    arch = free.copy()
    free[2:6, :5] = True  # within the arch, nearer to the beginning of the first column
    free[5, 4] = False
    assert np.array_equal(through_region(~free), arch)
    assert free.sum() == 2 * arch.sum()
