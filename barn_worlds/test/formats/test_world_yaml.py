"""Worlds with walls and motion: written and read again as .npz and YAML; malformed files refused in one line."""

import re
from pathlib import Path

import numpy as np
import pytest
import yaml
from archives import members, repack
from refusals import refused

from barn_worlds.base.errors import BarnError
from barn_worlds.datasets.dataset import open_dataset
from barn_worlds.datasets.generate_motion import build_arena
from barn_worlds.formats.dataset_file import read_dataset_file, write_dataset_file
from barn_worlds.formats.npz import encode_npy
from barn_worlds.formats.world_yaml import world_yaml, write_world_yaml
from barn_worlds.moving.motion import Motion, MovingObstacle, Wall
from barn_worlds.worlds.world import World

KEYS = ((0.0, 1.0, 2.0), (1.1, 3.0, 2.0), (4.0, 3.0, 5.0))
CIRCLING = Motion(
    "polynomial", 3.3, coefficients_m=((0.1, 0.2), (1.0, 2.0), (-1.0, -2.0))
)
MOVING = (
    MovingObstacle("gazebo", radius_m=0.5, motion=Motion("gazebo", 5.0, KEYS)),
    MovingObstacle(
        "linear",
        radius_m=0.1,
        height_m=2.0,
        phase_s=0.7,
        motion=Motion("linear", 4.0, KEYS),
    ),
    MovingObstacle(
        "box", "box", size_x_m=0.3, size_y_m=1.7, yaw_rad=0.3, motion=CIRCLING
    ),
    MovingObstacle("again", radius_m=0.25, motion=Motion("gazebo", 5.0, KEYS)),
)


@pytest.fixture
def scenes(small_world):
    """An arena, a static world, and one with walls and motion, by number."""
    grid = small_world.grid
    path = small_world.path
    turning = np.array([[6, 0], [6, 1], [6, 1], [5, 2], [4, 3], [4, 3], [4, 3]])
    return {
        0: build_arena("arena", MOVING[:2]),
        3: small_world,
        7: World(
            "both",
            grid,
            path,
            0.2,
            3,
            walls=(Wall(1.0, 2.0, 3.0, 0.1, 0.4, 2.0),),
            moving=MOVING,
        ),
        8: World("turns", grid, turning, footprint_cells=1, moving=MOVING[2:3]),
    }


@pytest.fixture
def dataset_file(scenes, tmp_path):
    """A data set file with the worlds of `scenes`."""
    write_dataset_file(tmp_path / "scenes.npz", "scenes", scenes)
    return tmp_path / "scenes.npz"


def assert_same(copy, world):
    assert copy.checksum == world.checksum
    for part in ("name", "walls", "moving", "corner_m"):
        assert getattr(copy, part) == getattr(world, part)
    assert np.array_equal(copy.path, world.path) and np.array_equal(
        copy.grid, world.grid
    )


def test_worlds_with_motion_come_back_from_a_data_set_file(dataset_file, scenes):
    dataset = open_dataset(dataset_file)
    assert dataset.world_numbers == (0, 3, 7, 8) and dataset.manifest["schema"] == 2
    for index, world in scenes.items():
        assert_same(dataset.load(index), world)
    motions = read_dataset_file(dataset_file).arrays["motion_kind"]
    assert len(motions) == 3  # equal motions are stored once


def test_static_data_sets_are_written_as_before(small_world, tmp_path):
    write_dataset_file(tmp_path / "static.npz", "static", {3: small_world})
    assert "moving.npy" not in members(tmp_path / "static.npz")
    assert read_dataset_file(tmp_path / "static.npz").manifest["schema"] == 1


def test_worlds_with_motion_come_back_from_yaml(scenes, tmp_path):
    for index, world in scenes.items():
        write_world_yaml(world, tmp_path / "folder" / f"w_{index}.world.yaml")
    dataset = open_dataset(tmp_path / "folder")
    assert dataset.world_numbers == tuple(scenes)
    for index, world in scenes.items():
        assert_same(dataset.load(index), world)
        alone = open_dataset(tmp_path / "folder" / f"w_{index}.world.yaml")
        assert alone.load(index).checksum == world.checksum


def test_every_world_of_dynabarn_survives_yaml(tmp_path):
    dataset = open_dataset("dynabarn60")
    for index in dataset.world_numbers[::15]:
        write_world_yaml(dataset.load(index), tmp_path / "one.world.yaml")
        copy = open_dataset(tmp_path / "one.world.yaml").load(0)
        assert_same(copy, dataset.load(index))


def test_dynabarn60_is_what_was_published():
    dataset = open_dataset("dynabarn60")
    assert dataset.world_numbers == tuple(range(60))
    assert "MIT" in dataset.manifest["licence"]
    assert "DynaBARN" in dataset.manifest["credit"]
    assert "Zifan Xu" in dataset.manifest["data"]
    for first, difficulty, low, high in (
        (0, "easy", 5, 14),
        (20, "medium", 15, 19),
        (40, "hard", 20, 24),
    ):
        worlds = [dataset.load(index) for index in range(first, first + 20)]
        difficulties = {world.provenance.parameters["difficulty"] for world in worlds}
        assert difficulties == {difficulty}
        counts = [len(world.moving) for world in worlds]
        assert (min(counts), max(counts)) == (low, high)
    worlds = map(dataset.load, dataset.world_numbers)
    assert len({obstacle for world in worlds for obstacle in world.moving}) == 469


def changed(text, **changes):
    """Return YAML text with some keys replaced; `moving__motion__x`: that of the first moving obstacle's motion."""
    content = yaml.safe_load(text)
    for name, value in changes.items():
        *parents, last = name.split("__")
        place = content
        for parent in parents:
            place = place[parent]
            place = place[0] if isinstance(place, list) else place
        place[last] = value
    return yaml.safe_dump(content)


WRONG = {
    "keys out of order": (
        {"moving__motion__keys": [[0, 0, 0], [2, 0, 0], [1, 0, 0]]},
        "moving[0].motion.keys[2] must be later than the key before, at 2 s, got 1 s",
    ),
    "a million keys": ({}, "more than the allowed 1000000 bytes"),
    "a key of text": (
        {"moving__motion__keys": [[0, 0, "a"]]},
        "moving[0].motion.keys[0][2] must be a number, got 'a'",
    ),
    "unknown key": ({"moving__radius": 1.0}, "moving[0].radius"),
    "wrong version": ({"schema_version": 2}, "schema_version must be 1, got 2"),
    "huge": ({"cells": [10**9, 10**9]}, "cells must be from 1 to 2000, got 1000000000"),
    "short row": (
        {"grid": ["..#"] * 45},
        "grid[0] must be 41 of the letters . and #, got '..#'",
    ),
    "few rows": ({"grid": ["..#"]}, "grid must have 45 rows, got 1"),
    "bent path": (
        {"path": [[0, 0], [3, 2]]},
        "path[1] must be in line with the cell before (row, column or diagonal), got [3, 2]",
    ),
    "path outside": (
        {"path": [[0, 0], [0, 41]]},
        "path[1] must be one of 45 x 41 cells, got [0, 41]",
    ),
    "no path": ({"path": []}, "path must have 1 to 1000000 cells, got 0"),
    "far corner": (
        {"corner_m": [1e9, 0.0]},
        "corner must be within 10000 m, got (1000000000.0, 0.0)",
    ),
    "flat wall": (
        {"walls__size_x_m": 0.0},
        "walls[0].size_x_m must be from 0.01 to 1000 m, got 0.0",
    ),
}


@pytest.mark.parametrize("case", WRONG)
def test_a_malformed_yaml_world_is_one_clear_line(case, scenes, tmp_path):
    changes, message = WRONG[case]
    file = tmp_path / "wrong.world.yaml"
    million = "moving: [{motion: {keys: [" + "[0,0,0]," * 10**6 + "]}}]"
    file.write_text(
        million
        if case == "a million keys"
        else changed(world_yaml(scenes[0]), **changes)
    )
    with refused(f"^{file}.*{re.escape(message)}", BarnError):
        open_dataset(file).load(0)


@pytest.mark.parametrize(
    "name, array, message",
    [
        ("motion_rows", np.array([3, -3, 9]), "motion must be 2 to 10000"),
        ("motion", np.zeros((9, 2)), "keys[0] must be time, x and y"),
        ("moving", np.array([2, 0, 4]), "world 8 is damaged: index 3 is out of bounds"),
        (
            "obstacle_motion",
            np.array([0, 1, 0, 1, 2, 0, 3]),
            "world 8 is damaged: index 3 is out of bounds",
        ),
        ("obstacle", np.full((7, 7), np.nan), "cannot convert float NaN to integer"),
        ("motion_kind", np.array([0, 1, 9]), "tuple index out of range"),
        ("corner_m", np.array([[np.inf, 0.0]] * 4), "corner must be within 10000 m"),
        (
            "wall",
            np.full((4, 6), np.nan),
            "x_m must be from -10000 to 10000 m, got nan",
        ),
    ],
)
def test_malformed_motion_in_a_data_set_file_is_one_clear_line(
    dataset_file, name, array, message
):
    repack(dataset_file, {f"{name}.npy": encode_npy(array)})
    with refused(re.escape(message), BarnError):
        dataset = open_dataset(dataset_file)
        for index in dataset.world_numbers:
            dataset.load(index)


def test_the_example_of_the_page_is_a_world(tmp_path):
    file = Path(__file__).parents[3] / "docs" / "dynamic.md"
    if not file.is_file():
        pytest.skip("the repository's docs are not beside this package")
    page = file.read_text("utf-8")
    (example,) = re.findall(r"(?ms)^```yaml\n(.*?)^```", page)
    path = tmp_path / "example.world.yaml"
    path.write_text(example)
    world = open_dataset(path).load(0)
    assert [obstacle.name for obstacle in world.moving] == ["person", "cart"]
    assert (len(world.walls), world.path_length_m) == (1, 20.0)
    path.write_text(example.replace("[20, 0.0", "[9, 0.0"))
    with pytest.raises(BarnError) as caught:
        open_dataset(path).load(0)
    assert str(caught.value).removeprefix(f"{path}: ") in page
