"""`barn robots`, its Python functions, and robots by name or file where worlds take one."""

import json
import re
import shutil
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from PIL import Image

import barn_eval as barn
from barn_eval.ros.supervision.nodes import robot_of_simulator
from barn_eval.trials import identity
from barn_eval.trials.protocol import PROTOCOLS
from barn_eval.trials.spec import simulator_config
from barn_sim.config import robot_of, with_robot
from barn_worlds.robots.files import ROBOTS, shipped_robots

CHALLENGE = PROTOCOLS["challenge"]


def test_list(command):
    code, out, _ = command("robots")
    assert code == 0
    assert all(name in out for name in ROBOTS)
    entries = json.loads(command("robots", "--json")[1])
    assert [one["robot"] for one in entries] == list(ROBOTS)
    husky = entries[0]
    assert (husky["drive"], husky["length [m]"], husky["speed [m/s]"]) == ("skid_steer", 0.99, 1.0)


@pytest.mark.parametrize("name", list(ROBOTS))
def test_show(command, tmp_path, name):
    code, out, _ = command("robots", name, "--out", "robot.png")
    assert code == 0
    assert out.startswith(name)
    assert "mass_kg" in out and "kg m2" in out and "sources" in out
    pixels = np.asarray(Image.open(tmp_path / "robot.png").convert("L"))
    assert pixels.std() > 10.0
    assert json.loads(command("robots", name, "--json")[1])["lidar"]["beams"] == ROBOTS[name].lidar.beams


def test_show_draws_vectors_and_refuses_other_pictures(command, tmp_path):
    assert command("robots", "turtlebot4", "--out", "robot.svg")[0] == 0
    assert "<svg" in (tmp_path / "robot.svg").read_text("utf-8")
    code, _, err = command("robots", "turtlebot4", "--out", "robot.doc")
    assert (code, err) == (1, "error: robot.doc: must end in .png, .svg or .pdf\n")


@pytest.mark.parametrize(
    "robot, said",
    [
        ("none.yaml", "none.yaml: No such file or directory"),
        ("husk", "unknown robot 'husk'; did you mean 'husky'?"),
    ],
)
def test_mistakes_are_one_line(rejected, robot, said):
    assert said in rejected("robots", robot)


def test_robots_from_python(tmp_path):
    assert "jackal" in barn.robots.names()
    assert barn.robots.load("jackal").name == "jackal"
    path = barn.robots.draw("husky").save(tmp_path / "husky.png")
    assert path.stat().st_size > 10_000


def test_worlds_take_a_robot_by_name_or_file(tmp_path):
    """A robot gets worlds in its size."""
    mine = shutil.copy(shipped_robots()["husky"], tmp_path / "mine.yaml")
    changes = {"initial_fill": 0.15}
    made = [barn.worlds.generate(per_set=1, seed=4, parameters=changes, robot=str(one)) for one in ("husky", mine)]
    assert (made[0][0].footprint_cells, made[0][0].resolution_m) == (5, 0.293)
    assert made[0][0].checksum == made[1][0].checksum


def test_tasks_of_other_robots_have_fingerprints_of_their_own():
    jackal = simulator_config(CHALLENGE, {})
    husky = with_robot(jackal, barn.robots.load("husky"))
    tasks = [identity.task(CHALLENGE, config) for config in (jackal, husky)]
    assert tasks[0]["robot"] != tasks[1]["robot"]
    assert identity.first_difference(*tasks) is not None
    # whoever changes it makes earlier results those of another task
    assert identity.fingerprint(tasks[0]) == "d17b28a36f5f"


def test_the_simulator_node_gets_robots_by_name_and_others_by_a_file(tmp_path):
    husky = simulator_config(CHALLENGE, {}, barn.robots.load("husky"))
    assert robot_of_simulator(husky, tmp_path) == "husky"
    heavier = replace(husky, chassis=replace(husky.chassis, mass_kg=80.0))
    file = robot_of_simulator(heavier, tmp_path)
    assert barn.robots.load(file) == robot_of(heavier)


def rows_of_page(cells):
    """The rows of the tables of the page that have so many cells, by the name of the robot that comes first."""
    lines = [[cell.strip() for cell in line.split("|")[1:-1]] for line in page().splitlines() if line.startswith("| `")]
    shown = {line[0].split("`")[1]: line[1:] for line in lines if len(line) == cells}
    assert set(shown) == set(ROBOTS)
    return shown


def page():
    path = Path(__file__).resolve().parents[2] / "docs" / "robots.md"
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
    for name, (_, size, mass, speed, turn, _) in rows_of_page(7).items():
        robot = ROBOTS[name]
        long, wide = f"{robot.length_m:.3f}", f"{robot.width_m:.3f}"
        assert size == (f"round, {long}" if robot.chassis.round else f"{long} x {wide}")
        assert float(mass) == pytest.approx(robot.chassis.mass_kg, abs=0.05)
        assert (float(speed), float(turn)) == (robot.drive.max_speed_m_s, robot.drive.max_yaw_rate_rad_s)
