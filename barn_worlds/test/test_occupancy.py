"""Maps of worlds: the original ones, and the true cylinders at finer resolutions."""

import numpy as np
import pytest

from barn_worlds.base.errors import WorldError
from barn_worlds.formats.map_server import read_map
from barn_worlds.worlds import cells as geometry
from barn_worlds.worlds.dataset import open_dataset
from barn_worlds.worlds.world import World


def test_historical_maps_equal_the_original_ones(original_folder):
    dataset = open_dataset(original_folder)
    for index in dataset.indices:
        published = read_map(original_folder / "map_files" / f"yaml_{index}.yaml")
        ours = dataset.load(index).occupancy_map(historical=True)
        assert published.data.shape == (66, 30)
        assert (published.resolution, published.origin_x, published.origin_y) == (0.15, -4.5, 0.0)
        assert np.array_equal(ours.data, published.data), index
        assert (ours.resolution, ours.origin_x, ours.origin_y) == pytest.approx((0.15, -4.5, 0.0))


def solid(world):
    """Return the centres (n, 2) of all cylinders, those included that stand where .world files leave them out."""
    hollow = np.argwhere(geometry.hollow(world.grid))
    return np.concatenate([world.cylinders_m, geometry.cell_centres(hollow, world.rows, world.resolution_m)])


def test_cells_of_the_map_are_those_the_cylinders_stand_in(small_world):
    occupancy = small_world.occupancy_map()
    row, col = np.nonzero(occupancy.data == 100)
    centres = np.stack(
        [
            occupancy.origin_x + (col + 0.5) * occupancy.resolution,
            occupancy.origin_y + (row + 0.5) * occupancy.resolution,
        ],
        axis=1,
    )
    assert {tuple(c) for c in centres.round(6).tolist()} == {tuple(c) for c in solid(small_world).round(6).tolist()}
    assert len(row) - len(small_world.cylinders_m) == geometry.hollow(small_world.grid).sum() > 0
    assert set(np.unique(occupancy.data)) == {0, 100}


@pytest.mark.parametrize("resolution_m", [0.03, 0.05, 0.1, 0.4])
def test_other_resolutions_occupy_what_a_cylinder_reaches_into(small_world, resolution_m):
    occupancy = small_world.occupancy_map(resolution_m)
    height, width = occupancy.data.shape
    left = occupancy.origin_x + np.arange(width) * resolution_m
    below = occupancy.origin_y + np.arange(height) * resolution_m
    expected = np.zeros((height, width), bool)
    for x, y in solid(small_world):
        dx = np.maximum(0.0, np.maximum(left - x, x - left - resolution_m))
        dy = np.maximum(0.0, np.maximum(below - y, y - below - resolution_m))
        expected |= np.hypot(dx[None], dy[:, None]) < small_world.cylinder_radius_m - 1e-9
    assert np.array_equal(occupancy.data == 100, expected)
    x_min, _, x_max, y_max = small_world.bounds_m
    assert width * resolution_m >= x_max - x_min - 1e-9
    assert height * resolution_m >= y_max - 1e-9


def test_sizes_are_bounded():
    wide = World("wide", np.zeros((2000, 2000), bool), np.array([[0, 0]]))
    with pytest.raises(WorldError, match="too large"):
        wide.occupancy_map(0.01)
    with pytest.raises(WorldError, match=r"at least 0\.005 m, got 0"):
        wide.occupancy_map(0.0)
