"""`barn robots`, its page and its Python functions, and worlds in the size of a robot."""

import json
import re
from dataclasses import replace

import numpy as np
import pytest
from PIL import Image
from refusals import refused
from waiting import ROOT

import barn_eval as barn
from barn_eval.api.worlds import generate, resize
from barn_eval.ros.supervision.nodes import name_robot
from barn_eval.trials import identity
from barn_eval.trials.protocol import PROTOCOLS
from barn_eval.trials.spec import simulator_config
from barn_metrics.metrics import world_metrics
from barn_sim.config import robot_of, with_robot
from barn_worlds.base.errors import BarnError
from barn_worlds.datasets.dataset import dataset_files, open_dataset
from barn_worlds.datasets.generate import narrowness
from barn_worlds.robots.files import ROBOTS, load_robot
from barn_worlds.worlds.cspace import configuration_space, through_region

CHALLENGE = PROTOCOLS["challenge"]


def test_list(succeed, printed):
    out = succeed("robots")
    assert all(name in out for name in ROBOTS)
    entries = printed("robots")
    assert [entry["robot"] for entry in entries] == list(ROBOTS)
    husky = {"drive": "skid_steer", "length [m]": 0.99, "speed [m/s]": 1.0}
    assert entries[0] | husky == entries[0]


@pytest.mark.parametrize("name", list(ROBOTS))
def test_show(succeed, printed, tmp_path, name):
    out = succeed(f"robots {name} --out robot.png")
    assert out.startswith(name)
    assert "mass_kg" in out and "kg m2" in out and "sources" in out
    pixels = np.asarray(Image.open(tmp_path / "robot.png").convert("L"))
    assert pixels.std() > 10.0
    lidar = printed(f"robots {name}")["lidar"]
    assert lidar["beams"] == ROBOTS[name].lidar.beams


def test_show_draws_vectors(succeed, tmp_path):
    succeed("robots turtlebot4 --out robot.svg")
    assert "<svg" in (tmp_path / "robot.svg").read_text("utf-8")


@pytest.mark.parametrize(
    "words, message",
    [
        ("none.yaml", "none.yaml: No such file or directory"),
        ("husk", "unknown robot 'husk'; did you mean 'husky'?"),
        (
            "turtlebot4 --out robot.doc",
            "error: robot.doc: must end in .png, .svg or .pdf\n",
        ),
    ],
)
def test_mistakes_are_one_line(rejected, words, message):
    assert message in rejected(f"robots {words}")


def test_tasks_of_other_robots_have_fingerprints_of_their_own():
    jackal = simulator_config(CHALLENGE, {})
    husky = with_robot(jackal, barn.robots.load("husky"))
    tasks = [identity.task_content(CHALLENGE, config) for config in (jackal, husky)]
    assert tasks[0]["robot"] != tasks[1]["robot"]
    assert identity.first_difference(*tasks) is not None
    # whoever changes it makes earlier results those of another task
    assert identity.fingerprint(tasks[0]) == "5f8fd772dd52"


def test_the_simulator_node_gets_robots_by_name_or_file(tmp_path):
    husky = simulator_config(CHALLENGE, {}, barn.robots.load("husky"))
    assert name_robot(husky, tmp_path) == "husky"
    heavier = replace(husky, chassis=replace(husky.chassis, mass_kg=80.0))
    file = name_robot(heavier, tmp_path)
    assert barn.robots.load(file) == robot_of(heavier)


def page():
    path = ROOT / "docs" / "robots.md"
    if not path.is_file():
        pytest.skip("the repository's documentation is not beside this package")
    return path.read_text("utf-8")


def test_the_file_that_the_page_shows_is_a_robot(tmp_path):
    text = re.search(r"(?ms)^```yaml\n(.*?)^```", page())[1]
    (tmp_path / "mine.yaml").write_text(text, "utf-8")
    robot = barn.robots.load(tmp_path / "mine.yaml")
    slip = 1.0 + (robot.chassis.wheelbase_m / robot.chassis.track_m) ** 2
    assert robot.drive.wheel_separation_multiplier == pytest.approx(slip, abs=0.005)


def test_the_table_of_the_page_has_the_numbers_of_the_files():
    table = {}
    for name, text in re.findall(r"(?m)^\| `(\w+)`.*? \|(.*)\|$", page()):
        cells = text.split("|")
        if len(cells) == 6:
            table[name] = [cell.strip() for cell in cells]
    assert set(table) == set(ROBOTS)
    for name, (_, size, mass, speed, turn, _) in table.items():
        robot = ROBOTS[name]
        long = f"{robot.length_m:.3f}"
        wide = f"{robot.width_m:.3f}"
        is_round = robot.chassis.is_round
        assert size == (f"round, {long}" if is_round else f"{long} x {wide}")
        assert float(mass) == pytest.approx(robot.chassis.mass_kg, abs=0.05)
        assert float(speed) == robot.drive.max_speed_m_s
        assert float(turn) == robot.drive.max_yaw_rate_rad_s


def test_barn_tb4_is_what_its_command_makes(tmp_path):
    tool = pytest.importorskip(
        "regenerate", reason="the repository's qa folder is not beside this package"
    )
    for name in tool.DATA_SETS:
        copy = open_dataset(tool.write_data_set(name, tmp_path))
        shipped = open_dataset(name)
        assert copy.checksum == shipped.checksum
        assert {**copy.manifest, "made_by": ""} == {**shipped.manifest, "made_by": ""}
        manifest = dataset_files()[name].with_suffix(".manifest.json")
        assert json.loads(manifest.read_text()) == shipped.manifest


def test_every_world_of_barn_tb4_has_a_path_for_its_robot():
    robot = load_robot("turtlebot4")
    dataset = open_dataset("barn_tb4")
    assert dataset.world_numbers == tuple(range(100))
    assert dataset.manifest["robot"] == "turtlebot4"
    worlds = [dataset.load(index) for index in dataset.world_numbers]
    assert len({world.checksum for world in worlds}) == 100
    for world in worlds:
        cells = robot.footprint_cells(world.resolution_m)
        assert cells == world.footprint_cells
        assert world.resolution_m == pytest.approx(0.15 * 0.171 / 0.254, abs=0.001)
        cspace = configuration_space(world.grid, cells)
        assert through_region(cspace) is not None
        assert not cspace[tuple(world.path.T)].any()
    order = [narrowness(world) for world in worlds]
    assert order == sorted(order)
    closest = [world_metrics(world).closest_obstacle for world in worlds]
    usual_worlds = map(open_dataset("barn300").load, range(300))
    usual = [world_metrics(world).closest_obstacle for world in usual_worlds]
    low, high = np.quantile(usual, [0.05, 0.95])
    assert min(closest) < low < high < max(closest)


def test_worlds_kept_are_spread_over_the_order(tmp_path):
    options = {"per_set": 1, "seed": 3, "robot": "turtlebot4"}
    whole = list(generate(**options).values())
    selection = generate(tmp_path / "few.npz", keep=4, **options).values()
    for world, place in zip(selection, (0, 4, 7, 11), strict=True):
        assert world.checksum == whole[place].checksum
    assert len(generate(keep=1, **options)) == 1
    with refused("keep must be at most the 12 generated worlds, got 13"):
        generate(keep=13, **options)


def test_robots_too_large_for_a_data_set_are_refused(rejected):
    message = rejected("run --dataset barn_tb4 --worlds 0 --planner gap --out unused")
    ways = "with paths for 5 x 5 cells of 0.101 m: robot jackal takes 7 x 7"
    assert f"barn_tb4 is made for robot turtlebot4, {ways}" in message
    dataset = open_dataset("barn_tb4")
    for fits in ("turtlebot4", "turtlebot3_burger", "turtlebot3_waffle"):
        dataset.require_fit(load_robot(fits), dataset.world_numbers)
    open_dataset("barn300").require_fit(load_robot("husky"), [0])
    gymnasium = pytest.importorskip("gymnasium")
    pytest.importorskip("barn_eval.gym")
    with refused("barn_tb4 is made for robot turtlebot4", BarnError):
        gymnasium.make("barn/Jackal-v0", dataset="barn_tb4", robot="husky")


def test_resized_worlds_have_equal_grids_in_robot_cells(tmp_path):
    worlds = barn.worlds.load("barn300", "0,150,299")
    for robot, side_m in (("jackal", 0.15), ("turtlebot4", 0.101), ("husky", 0.293)):
        resized = resize(worlds, robot)
        for index, world in resized.items():
            assert world.resolution_m == side_m and world.footprint_cells == 5
            assert (world.grid == worlds[index].grid).all()
            assert (world.path == worlds[index].path).all()
    for index, world in resize(worlds, "jackal").items():
        assert world.checksum == worlds[index].checksum
    written = open_dataset(barn.worlds.save(resized, tmp_path / "husky.npz"))
    assert written.world_numbers == (0, 150, 299)
    assert written.load(150).checksum == resized[150].checksum
    arena = barn.worlds.load("dynabarn60", "0")[0]
    surveyed = replace(worlds[0], built_m=worlds[0].planned_m)
    for world in (arena, surveyed):
        message = "and surveyed positions are in meters and cannot be resized"
        with refused(message, BarnError):
            resize({0: world}, "husky")
