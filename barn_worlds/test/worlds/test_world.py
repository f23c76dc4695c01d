"""A world checks what it is made of and stands where the original ones stand, and so does its map."""

import dataclasses

import numpy as np
import pytest
from refusals import refused

from barn_worlds.base.errors import WorldError
from barn_worlds.datasets.dataset import open_dataset
from barn_worlds.formats.map_server import read_map
from barn_worlds.worlds import cells as geometry
from barn_worlds.worlds.world import World

OPEN = np.zeros((30, 30), bool)
STRAIGHT = np.stack([np.full(30, 15), np.arange(30)], axis=1)


def test_cells_stand_where_the_gazebo_files_put_them():
    cells = np.argwhere(~OPEN)
    centers = geometry.cell_centers(cells, 30, 0.15)
    assert np.allclose(centers, [-4.425, 5.175] + 0.15 * cells, atol=1e-12)
    assert np.array_equal(geometry.containing_cells(centers, 30, 0.15), cells)


def test_historical_conversion_is_that_of_the_original_tools():
    world = World("w", OPEN, STRAIGHT)
    historical = [-4.575, 5.075] + 0.15 * STRAIGHT
    assert np.allclose(world.path_m(historical=True), historical, atol=1e-12)
    assert np.allclose(world.path_m() - historical, [0.15, 0.10], atol=1e-12)


def test_containment_is_a_back_wall_and_two_side_walls():
    containment_m = World("w", OPEN, STRAIGHT).containment_m
    walls = set(map(tuple, containment_m.round(6).tolist()))
    back = {(round(-0.075 - 0.15 * k, 6), 0.075) for k in range(30)}
    sides = {
        (x, round(0.075 + 0.15 * k, 6)) for k in range(34) for x in (-0.075, -4.425)
    }
    assert walls == back | sides
    assert max(y for _, y in walls) == 5.025


def test_hollow_interiors_are_left_out_of_the_cylinders(small_world):
    shown = np.zeros_like(small_world.grid)
    cells = geometry.containing_cells(small_world.obstacles_m, 9, 0.15)
    shown[tuple(cells.T)] = True
    # rows 0 to 3 of columns 4 to 8 are filled: rows 1 and 2 are surrounded in columns 5 to 7
    hidden = np.zeros_like(shown)
    hidden[1:3, 5:8] = True
    assert np.array_equal(small_world.grid & ~shown, hidden)
    outside = len(small_world.containment_m)
    assert len(small_world.cylinders_m) == len(small_world.obstacles_m) + outside


def test_path_length_counts_repeated_cells_once():
    path = np.array([[5, 0], [5, 0], [5, 1], [6, 2], [6, 3]])
    length_m = 0.15 * (2 + np.sqrt(2))
    assert World("w", OPEN, path).path_length_m == pytest.approx(length_m)


def test_arrays_are_copies_that_cannot_be_written():
    grid = OPEN.copy()
    path = STRAIGHT.copy()
    world = World("w", grid, path)
    grid[3] = True
    path[0] = 0
    assert not world.grid.any()
    assert world.path[0].tolist() == [15, 0]
    for array in (
        world.grid,
        world.path,
        world.cspace,
        world.obstacles_m,
        world.containment_m,
    ):
        with pytest.raises(ValueError, match="read-only"):
            array[0] = 0


def test_checksum_tells_content_but_not_names_apart():
    world = World("w", OPEN, STRAIGHT)
    assert dataclasses.replace(world, name="other").checksum == world.checksum
    for change in (
        {"path": STRAIGHT[1:]},
        {"footprint_cells": 3},
        {"resolution_m": 0.1},
    ):
        assert dataclasses.replace(world, **change).checksum != world.checksum
    filled = OPEN.copy()
    filled[0, 0] = True
    assert dataclasses.replace(world, grid=filled).checksum != world.checksum


@pytest.mark.parametrize(
    "change, message",
    [
        ({"name": ""}, "must have 1 to 200 characters"),
        (
            {"grid": np.zeros(30, bool)},
            r"grid must be a two-dimensional array, got \(30,\)",
        ),
        ({"grid": np.zeros((0, 5), bool)}, "1 to 2000 cells wide and long"),
        ({"grid": np.zeros((2001, 5), bool)}, "1 to 2000 cells wide and long"),
        ({"grid": np.full((30, 30), 2)}, "zeros and ones, got 2 in row 0, column 0"),
        ({"grid": np.full((30, 30), np.nan)}, "zeros and ones, got nan in row 0"),
        ({"grid": np.full((30, 30), "a")}, "zeros and ones, got values of type <U1"),
        ({"grid": [[0]]}, r"two-dimensional array, got \[\[0\]\]"),
        ({"path": STRAIGHT[:, :1]}, r"rows and columns \(n, 2\)"),
        ({"path": STRAIGHT[:0]}, "1 to 1000000 cells, got 0"),
        ({"path": STRAIGHT + 0.5}, "whole numbers"),
        ({"path": np.full((3, 2), np.nan)}, "whole numbers"),
        (
            {"path": STRAIGHT + [0, 1]},
            r"path leaves the grid of \(30, 30\) at \[15, 30\]",
        ),
        ({"path": STRAIGHT[::2]}, r"neighboring cell, got \[15, 0\] then \[15, 2\]"),
        ({"grid": ~OPEN}, r"path goes through the filled cell \[15, 0\]"),
        ({"resolution_m": 0.0}, "resolution must be from 0.01 to 10 m"),
        ({"resolution_m": float("nan")}, "resolution must be from 0.01 to 10 m"),
        ({"footprint_cells": 4}, "odd number of cells from 1 to 4000, got 4"),
        ({"footprint_cells": 0}, "footprint must be an odd number"),
    ],
)
def test_what_is_no_world_is_refused_in_one_line(change, message):
    with refused(message, WorldError):
        World(**{"name": "w", "grid": OPEN, "path": STRAIGHT, **change})


def test_original_worlds_have_the_published_path_lengths(original_folder):
    dataset = open_dataset(original_folder)
    table = np.loadtxt(
        original_folder / "trials.csv", delimiter=",", skiprows=1, usecols=(0, 1)
    )
    assert len(table) == len(dataset.world_numbers) > 0
    for index, length_m in table:
        world = dataset.load(int(index))
        assert world.path_length_m == pytest.approx(length_m, abs=1e-5)


def test_historical_maps_equal_the_original_ones(original_folder):
    dataset = open_dataset(original_folder)
    place = (0.15, -4.5, 0.0)
    for index in dataset.world_numbers:
        published = read_map(original_folder / "map_files" / f"yaml_{index}.yaml")
        ours = dataset.load(index).occupancy_map(historical=True)
        assert published.data.shape == (66, 30)
        assert np.array_equal(ours.data, published.data), index
        assert (published.resolution, *published.origin) == place
        assert (ours.resolution, *ours.origin) == pytest.approx(place)


@pytest.mark.parametrize("resolution_m", [None, 0.03, 0.05, 0.1, 0.4])
def test_a_map_is_occupied_where_a_cylinder_reaches(small_world, resolution_m):
    occupancy = small_world.occupancy_map(resolution_m)
    assert occupancy.resolution == (resolution_m or small_world.resolution_m)
    resolution_m = occupancy.resolution
    height, width = occupancy.data.shape
    left = occupancy.origin_x + np.arange(width) * resolution_m
    below = occupancy.origin_y + np.arange(height) * resolution_m
    expected = np.zeros((height, width), bool)
    # where .world files leave cylinders out
    hollow = np.argwhere(geometry.hollow_cells(small_world.grid))
    hollow_m = geometry.cell_centers(hollow, small_world.rows, 0.15)
    for x, y in np.concatenate([small_world.cylinders_m, hollow_m]):
        dx = np.maximum(0.0, np.maximum(left - x, x - left - resolution_m))
        dy = np.maximum(0.0, np.maximum(below - y, y - below - resolution_m))
        distances = np.hypot(dx[None], dy[:, None])
        expected |= distances < small_world.cylinder_radius_m - 1e-9
    assert np.array_equal(occupancy.data, np.where(expected, 100, 0))
    x_min, _, x_max, y_max = small_world.bounds_m
    assert width * resolution_m >= x_max - x_min - 1e-9
    assert height * resolution_m >= y_max - 1e-9


def test_sizes_are_bounded():
    wide = World("wide", np.zeros((2000, 2000), bool), np.array([[0, 0]]))
    with refused("too large", WorldError):
        wide.occupancy_map(0.01)
    with refused(r"at least 0\.005 m, got 0", WorldError):
        wide.occupancy_map(0.0)
