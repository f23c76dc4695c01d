"""Worlds in the size of a robot: the shipped barn_tb4, sets that are thinned, and worlds resized for another robot."""

import json

import numpy as np
import pytest

import barn_eval as barn
from barn_eval.worlds import generate, resize
from barn_metrics.metrics import world_metrics
from barn_worlds.base.errors import BarnError, ConfigError
from barn_worlds.robots.files import load_robot
from barn_worlds.worlds.cspace import configuration_space, through_region
from barn_worlds.worlds.dataset import open_dataset, shipped
from barn_worlds.worlds.generate import narrowness


def test_barn_tb4_is_what_its_command_makes(tmp_path):
    tool = pytest.importorskip("regenerate", reason="the repository's qa folder is not beside this package")
    for name in tool.DATA_SETS:
        made, there = open_dataset(tool.write_data_set(name, tmp_path)), open_dataset(name)
        assert made.checksum == there.checksum
        assert {**made.manifest, "made_by": ""} == {**there.manifest, "made_by": ""}
        assert json.loads(shipped()[name].with_suffix(".manifest.json").read_text()) == there.manifest


def test_every_world_of_barn_tb4_has_a_way_for_its_robot_and_they_rise_from_wide_to_narrow():
    robot, dataset = load_robot("turtlebot4"), open_dataset("barn_tb4")
    assert dataset.indices == tuple(range(100)) and dataset.manifest["robot"] == "turtlebot4"
    found = [dataset.load(index) for index in dataset.indices]
    assert len({world.checksum for world in found}) == 100
    for world in found:
        cells = robot.footprint_cells(world.resolution_m)
        assert (cells, world.resolution_m) == (world.footprint_cells, pytest.approx(0.15 * 0.171 / 0.254, abs=0.001))
        cspace = configuration_space(world.grid, cells)
        assert through_region(cspace) is not None and not cspace[tuple(world.path.T)].any()
    order = [narrowness(world) for world in found]
    assert order == sorted(order)
    closest = np.array([world_metrics(world).closest_obstacle for world in found])
    usual = [world_metrics(open_dataset("barn300").load(index)).closest_obstacle for index in range(300)]
    assert closest.min() < np.quantile(usual, 0.05) and closest.max() > np.quantile(usual, 0.95)


def test_worlds_kept_are_spread_over_the_order(tmp_path):
    asked = {"per_set": 1, "seed": 3, "robot": "turtlebot4"}
    whole = [world.checksum for world in generate(**asked).values()]
    kept = [world.checksum for world in generate(tmp_path / "few.npz", keep=4, **asked).values()]
    assert kept == [whole[k] for k in (0, 4, 7, 11)]
    assert len(generate(keep=1, **asked)) == 1
    with pytest.raises(ConfigError, match="keep must be at most the 12 worlds made, got 13"):
        generate(keep=13, **asked)


def test_robots_that_take_more_cells_than_the_data_set_is_made_for_are_refused(rejected):
    said = rejected("run", "--dataset", "barn_tb4", "--worlds", "0", "--planner", "gap", "--out", "unused")
    assert (
        "barn_tb4 is made for robot turtlebot4, with ways for 5 x 5 cells of 0.101 m: robot jackal takes 7 x 7" in said
    )
    dataset = open_dataset("barn_tb4")
    for fits in ("turtlebot4", "turtlebot3_burger", "turtlebot3_waffle"):
        dataset.require_fit(load_robot(fits), dataset.indices)
    open_dataset("barn300").require_fit(load_robot("husky"), [0])
    gymnasium = pytest.importorskip("gymnasium")
    pytest.importorskip("barn_eval.gym")
    with pytest.raises(BarnError, match="barn_tb4 is made for robot turtlebot4"):
        gymnasium.make("barn/Jackal-v0", dataset="barn_tb4", robot="husky")


def test_resized_worlds_have_the_same_grids_in_cells_of_the_robots(tmp_path):
    chosen = barn.worlds.load("barn300", "0,150,299")
    for robot, side_m in (("jackal", 0.15), ("turtlebot4", 0.101), ("husky", 0.293)):
        made = resize(chosen, robot)
        for index, world in made.items():
            assert world.resolution_m == side_m and world.footprint_cells == 5
            assert (world.grid == chosen[index].grid).all() and (world.path == chosen[index].path).all()
    assert [one.checksum for one in resize(chosen, "jackal").values()] == [one.checksum for one in chosen.values()]
    written = open_dataset(barn.worlds.save(made, tmp_path / "husky.npz"))
    assert written.indices == (0, 150, 299) and written.load(150).checksum == made[150].checksum
    with pytest.raises(BarnError, match="walls, moving obstacles and arenas are in metres and cannot be resized"):
        resize(barn.worlds.load("dynabarn60", "0"), "husky")
