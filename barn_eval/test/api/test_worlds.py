"""Maps of one's own and worlds in which obstacles move, from the command line and from Python."""

import json
import re

import numpy as np
import pytest
from PIL import Image
from planners import recorded, spec_of

import barn_eval as barn
from barn_eval.analysis.sources import read_source, read_worlds
from barn_eval.results.bags.bagfile import BagFile
from barn_eval.trials.protocol import CHALLENGE, DYNABARN
from barn_eval.verification.check import check_folder
from barn_worlds.base.errors import BarnError, ConfigError
from barn_worlds.base.types import OccupancyMap, Pose2D
from barn_worlds.datasets.dataset import open_dataset
from barn_worlds.formats.map_server import write_map
from barn_worlds.messages.cdr import deserialize
from barn_worlds.messages.topics import MOVING_POSES


@pytest.fixture
def room(tmp_path):
    """Return the file of a room of 5 x 4 m with a pillar, its corner at (10, -2) in the map frame."""
    data = np.zeros((40, 50), np.int8)
    data[[0, -1]] = data[:, [0, -1]] = 100
    data[18:22, 24:26] = 100
    write_map(OccupancyMap(data, 0.1, 10.0, -2.0), tmp_path / "room.yaml")
    return tmp_path / "room.yaml"


def run(folder, dataset, *options):
    return (
        "run",
        "--dataset",
        dataset,
        "--planner",
        "gap",
        "--execution",
        "engine=inline",
        "--out",
        folder,
        *options,
    )


def test_a_trial_drives_from_the_chosen_start_to_the_chosen_goal(
    room, command, tmp_path
):
    world = open_dataset(room).load(0)
    results = barn.run(
        dataset=room,
        planners="gap",
        out=tmp_path / "out",
        engine="inline",
        progress=False,
    )
    trial = results.trial(0)
    assert trial.result.world_checksum == world.checksum
    first = trial.trajectory.iloc[0]
    assert (first.x_m, first.y_m) == pytest.approx(
        (world.start.x, world.start.y), abs=0.05
    )
    course = CHALLENGE.course(world)
    assert (course.start, course.goal) == (world.start, world.goal)
    assert results.trials[0].scores.optimal_time_s == course.optimal_time_s
    assert course.reference_length_m == pytest.approx(world.path_length_m, abs=0.15)
    assert (
        command("report", tmp_path / "out", "--out", tmp_path / "report.html")[0] == 0
    )
    assert check_folder(tmp_path / "out").problems == []


def test_a_course_given_for_a_run_is_in_rows_and_pages(room, command, tmp_path):
    done = command(*run("out", room, "--course", "11,-1,0:14,1", "--json"))
    assert done[0] == 0
    (row,) = json.loads(done[1])["results"]
    source = read_source(tmp_path / "out")
    world = read_worlds([(source.results[0], source)])[row["world_checksum"]]
    assert (world.start, world.goal.x, world.goal.y) == (
        Pose2D(11.0, -1.0, 0.0),
        14.0,
        1.0,
    )
    assert row["scores"]["path_length_m"] == world.path_length_m
    again = command("show", room, "--course", "11,-1,0:14,1", "--out", "room.png")
    assert again[0] == 0 and (tmp_path / "room.png").stat().st_size > 5000


@pytest.mark.parametrize(
    ("course", "message"),
    [
        (
            "12.5,0,0:14,1",
            "room: start (12.5, 0) is blocked: robot jackal would touch an obstacle there",
        ),
        (
            "11,-1,0:11.5,-1",
            "start and goal are 0.50 m apart, which is arrival under protocol challenge",
        ),
        ("11,-1:14,1", "--course '11,-1:14,1': must be X,Y,YAW:X,Y of start and goal"),
    ],
)
def test_impossible_courses_are_refused_before_driving(
    room, rejected, tmp_path, course, message
):
    assert message in rejected(*run("out", room, "--course", course))
    assert not (tmp_path / "out" / "results.jsonl").exists()


def test_the_environment_starts_episodes_where_the_map_says(room):
    environment = pytest.importorskip(
        "barn_eval.learning.environment", reason="needs Gymnasium"
    )
    world = open_dataset(room).load(0)
    reward = {"reward.progress_along": "straight"}
    env = environment.JackalEnv(dataset=str(room), **reward)
    _, info = env.reset(seed=1)
    assert info["way_left_m"] == pytest.approx(world.start.distance(world.goal))
    env.close()


def test_arenas_are_generated_drawn_and_exported(command, tmp_path):
    which = {"classes": ["easy", "hard"], "per_class": 2, "seed": 5}
    worlds = barn.worlds.generate_moving(tmp_path / "own.npz", **which)
    dataset = open_dataset(tmp_path / "own.npz")
    assert dataset.world_numbers == (0, 1, 2, 3)
    assert {k: w.checksum for k, w in worlds.items()} == {
        k: dataset.load(k).checksum for k in dataset.world_numbers
    }
    assert [w.checksum for w in barn.worlds.generate_moving(**which).values()] == [
        w.checksum for w in worlds.values()
    ]
    for target, selected in (
        ("sheet.png", "all"),
        ("one.png", "1"),
        ("also.png", "1"),
        ("one.gif", "1"),
    ):
        assert (
            command("show", selected, "--dataset", "own.npz", "--out", target)[0] == 0
        )
    assert Image.open(tmp_path / "one.gif").n_frames > 50
    assert (tmp_path / "also.png").read_bytes() == (tmp_path / "one.png").read_bytes()
    for form, file in (("sdf", "world_1.sdf"), ("yaml", "world_1.world.yaml")):
        assert (
            command(
                "worlds", "convert", "own.npz", form, "--format", form, "--worlds", 1
            )[0]
            == 0
        )
        assert (tmp_path / form / file).is_file()
    assert open_dataset(tmp_path / "yaml").load(1).checksum == dataset.load(1).checksum


@pytest.mark.parametrize("crossing", [False, True])
def test_worlds_of_a_data_set_get_moving_obstacles(command, tmp_path, crossing):
    which = {"source": "barn300", "select": "3,7", "crossing": crossing, "obstacles": 3}
    barn.worlds.generate_moving(tmp_path / "own.npz", ["easy"], **which)
    moving = open_dataset(tmp_path / "own.npz")
    still = open_dataset("barn300")
    assert moving.world_numbers == (3, 7)
    for index in moving.world_numbers:
        assert len(moving.load(index).moving) == 3
        assert (moving.load(index).grid == still.load(index).grid).all()
    assert command("metrics", "own.npz")[0] == 0  # of what stands


@pytest.mark.parametrize(
    ("arguments", "complaint"),
    [
        (
            ["show", "0-59", "--dataset", "dynabarn60", "--out", "x.gif"],
            "an animation shows one world, got 60",
        ),
        (["show", "3", "--out", "x.gif"], "world_3: nothing moves in it"),
        (
            ["worlds", "convert", "dynabarn60", "x", "--format", "original"],
            "has no place for walls and moving",
        ),
        (
            ["metrics", "dynabarn60", "--worlds", "3"],
            "dynabarn_3: is an arena; these metrics are of worlds whose",
        ),
        (
            ["difficulty", "predict", "dynabarn60", "--worlds", "3"],
            "dynabarn_3: is an arena; models are of worlds",
        ),
    ],
)
def test_a_mistake_is_one_clear_line_and_leaves_nothing(rejected, arguments, complaint):
    assert complaint in rejected(*arguments)


def test_from_python_a_mistake_is_an_error_of_the_suite():
    for wrong, message in (
        ({"source": "barn300"}, "one class of motion must be named"),
        (
            {"crossing": True},
            "crossings and a number of obstacles are for the worlds of a data set",
        ),
        ({"classes": ["esy"]}, "unknown class 'esy'; did you mean 'easy'?"),
        ({"parameters": {"radius": 1}}, "did you mean 'radius_m'?"),
    ):
        with pytest.raises(ConfigError, match=re.escape(message)):
            barn.worlds.generate_moving(**wrong)
    with pytest.raises(BarnError, match="exists already"):
        barn.worlds.generate_moving(open_dataset("dynabarn60").load(0).provenance.path)


def test_the_bag_of_a_trial_has_the_true_poses_of_its_phase(tmp_path):
    spec = spec_of(30, DYNABARN)
    result = recorded(spec, tmp_path / "bag").result
    assert result.motion.phase_s == spec.phase_s == spec.description()["phase_s"] > 0.0
    poses = [
        item
        for item in BagFile(tmp_path / "bag").messages()
        if item.topic == MOVING_POSES.path
    ]
    assert len(poses) >= 10 * result.scores.duration_s - 1
    for item in poses:
        expected = spec.world.tracks.at(spec.phase_s + item.stamp_ns * 1e-9)[0]
        positions = [
            (pose.position.x, pose.position.y)
            for pose in deserialize(item.data, MOVING_POSES.type_name).poses
        ]
        np.testing.assert_allclose(positions, expected, atol=1e-9)


def test_repetitions_have_phases_that_planners_share():
    phases = [
        spec_of(30, DYNABARN, repetition=repetition).phase_s for repetition in range(5)
    ]
    assert len(set(phases)) == 5
    assert spec_of(30, DYNABARN, "dwa").phase_s == phases[0]
