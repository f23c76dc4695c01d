"""Maps of one's own, from the picture to the report: start and goal are the map's, the run's, or chosen."""

import json

import numpy as np
import pytest

import barn_eval as barn
from barn_eval.analysis.sources import read_source, read_worlds
from barn_eval.experiments.check import check_folder
from barn_eval.trials.protocol import CHALLENGE, KNOWN_MAP
from barn_worlds.base.types import OccupancyMap, Pose2D
from barn_worlds.formats.map_server import write_map
from barn_worlds.robots.files import load_robot
from barn_worlds.worlds.dataset import open_dataset


@pytest.fixture
def room(tmp_path):
    """Return the file of a room of 5 x 4 m with a pillar, its corner at (10, -2) in the map frame."""
    data = np.zeros((40, 50), np.int8)
    data[[0, -1]] = data[:, [0, -1]] = 100
    data[18:22, 24:26] = 100
    write_map(OccupancyMap(data, 0.1, 10.0, -2.0), tmp_path / "room.yaml")
    return tmp_path / "room.yaml"


def run(folder, dataset, *options):
    return ("run", "--dataset", dataset, "--planner", "gap", "--execution", "engine=inline", "--out", folder, *options)


def test_a_trial_drives_from_the_chosen_start_to_the_chosen_goal(room, command, tmp_path):
    world = open_dataset(room).load(0)
    results = barn.run(dataset=room, planners="gap", out=tmp_path / "out", engine="inline", progress=False)
    trial = results.trial(0)
    assert trial.result.world_checksum == world.checksum
    first = trial.trajectory.iloc[0]
    assert (first.x_m, first.y_m) == pytest.approx((world.start.x, world.start.y), abs=0.05)
    course = CHALLENGE.course(world)
    assert (course.start, course.goal) == (world.start, world.goal)
    assert results.trials[0].scores.optimal_time_s == course.optimal_time_s
    assert course.reference_length_m == pytest.approx(world.path_length_m, abs=0.15)
    assert command("report", tmp_path / "out", "--out", tmp_path / "report.html")[0] == 0
    assert check_folder(tmp_path / "out").problems == []


def test_a_course_given_for_a_run_is_that_of_its_rows_and_of_its_pages(room, command, tmp_path):
    done = command(*run("out", room, "--course", "11,-1,0:14,1", "--json"))
    assert done[0] == 0
    (row,) = json.loads(done[1])["results"]
    source = read_source(tmp_path / "out")
    world = read_worlds([(source.results[0], source)])[row["world_checksum"]]
    assert (world.start, world.goal.x, world.goal.y) == (Pose2D(11.0, -1.0, 0.0), 14.0, 1.0)
    assert row["scores"]["path_length_m"] == world.path_length_m
    again = command("show", room, "--course", "11,-1,0:14,1", "--out", "room.png")
    assert again[0] == 0 and (tmp_path / "room.png").stat().st_size > 5000


def test_a_course_replaces_the_protocols_rules_in_worlds_of_the_benchmark():
    dataset = open_dataset("barn300").driven(load_robot("jackal"), (-2.25, 3.0, 1.57, -2.25, 4.5))
    course = KNOWN_MAP.course(dataset.load(0))
    assert (course.start, course.goal.y) == (Pose2D(-2.25, 3.0, 1.57), 4.5)
    assert open_dataset("barn300").load(0).start is None


@pytest.mark.parametrize(
    ("course", "message"),
    [
        ("12.5,0,0:14,1", "room: start (12.5, 0) is blocked: robot jackal would touch an obstacle there"),
        ("11,-1,0:12.5,0", "room: goal (12.5, 0) is blocked"),
        ("11,-1,0:20,0", "room: goal (20, 0) is off the map"),
        ("11,-1,0:11.5,-1", "start and goal are 0.50 m apart, which is arrival under protocol challenge"),
        ("11,-1:14,1", "--course '11,-1:14,1': must be X,Y,YAW:X,Y of start and goal"),
    ],
)
def test_courses_that_cannot_be_driven_are_refused_before_anything_is(room, rejected, tmp_path, course, message):
    assert message in rejected(*run("out", room, "--course", course))
    assert not (tmp_path / "out" / "results.jsonl").exists()


def test_a_protocol_whose_maps_are_shifted_is_refused_for_ones_own_map(room, rejected):
    assert "has start and goal of its own; protocol paper2020" in rejected(*run("out", room, "--protocol", "paper2020"))


def test_the_environment_starts_episodes_where_the_map_says(room):
    environment = pytest.importorskip("barn_eval.learning.environment", reason="needs Gymnasium")
    world, reward = open_dataset(room).load(0), {"reward.progress_along": "straight"}
    made = environment.JackalEnv(dataset=str(room), **reward)
    _, info = made.reset(seed=1)
    assert info["way_left_m"] == pytest.approx(world.start.distance(world.goal))
    made.close()
