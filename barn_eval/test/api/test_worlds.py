"""Maps of one's own and worlds in which obstacles move, from the command line and from
Python.
"""

import re

import numpy as np
import pytest
import yaml
from PIL import Image
from planners import recorded, spec_of
from refusals import refused
from text_tables import answers_of

import barn_eval as barn
from barn_eval.analysis.sources import read_source, read_worlds
from barn_eval.results.bags.bagfile import BagFile
from barn_eval.trials.protocol import CHALLENGE, DYNABARN
from barn_eval.verification.check import check_folder
from barn_worlds.base.errors import BarnError
from barn_worlds.base.types import OccupancyMap, Pose2D
from barn_worlds.datasets.dataset import open_dataset
from barn_worlds.formats.map_server import write_map
from barn_worlds.messages.cdr import deserialize
from barn_worlds.messages.topics import MOVING_POSES


@pytest.fixture
def room(tmp_path):
    """Return the file of a room of 5 x 4 m with a pillar, its corner at (10, -2) in the
    map frame.
    """
    data = np.zeros((40, 50), np.int8)
    data[[0, -1]] = data[:, [0, -1]] = 100
    data[18:22, 24:26] = 100
    write_map(OccupancyMap(data, 0.1, 10.0, -2.0), tmp_path / "room.yaml")
    return tmp_path / "room.yaml"


def run(folder, dataset, options):
    line = f"run --dataset {dataset} --planner gap --execution engine=inline"
    return f"{line} --out {folder} {options}"


def test_a_trial_drives_from_the_chosen_start_to_the_chosen_goal(
    room, succeed, tmp_path
):
    world = open_dataset(room).load(0)
    options = {"engine": "inline", "progress": False}
    results = barn.run(dataset=room, planners="gap", out=tmp_path / "out", **options)
    trial = results.trial(0)
    assert trial.result.world_checksum == world.checksum
    first = trial.trajectory.iloc[0]
    assert first.x_m == pytest.approx(world.start.x, abs=0.05)
    assert first.y_m == pytest.approx(world.start.y, abs=0.05)
    course = CHALLENGE.course(world)
    assert (course.start, course.goal) == (world.start, world.goal)
    assert results.trials[0].scores.optimal_time_s == course.optimal_time_s
    assert course.reference_length_m == pytest.approx(world.path_length_m, abs=0.15)
    succeed("report out --out report.html")
    assert check_folder(tmp_path / "out").problems == []


def test_a_course_given_for_a_run_is_in_rows_and_pages(
    room, succeed, printed, tmp_path
):
    (row,) = printed(run("out", room, "--course 11,-1,0:14,1"))["results"]
    source = read_source(tmp_path / "out")
    world = read_worlds([(source.results[0], source)])[row["world_checksum"]]
    assert world.start == Pose2D(11.0, -1.0, 0.0)
    assert world.goal.position == (14.0, 1.0)
    assert row["scores"]["path_length_m"] == world.path_length_m
    succeed(f"show {room} --course 11,-1,0:14,1 --out room.png")
    assert (tmp_path / "room.png").stat().st_size > 5000


@pytest.mark.parametrize(
    "course, message",
    [
        (
            "12.5,0,0:14,1",
            "room: start (12.5, 0) is blocked: robot jackal would touch an obstacle there",
        ),
        (
            "11,-1,0:11.5,-1",
            "start and goal are 0.50 m apart, which counts as arrival under protocol challenge",
        ),
        (
            "11,-1:14,1",
            "--course '11,-1:14,1': must be X,Y,YAW:X,Y, the start and goal",
        ),
    ],
)
def test_impossible_courses_are_refused_before_driving(
    room, rejected, tmp_path, course, message
):
    assert message in rejected(run("out", room, f"--course {course}"))
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


def test_arenas_are_generated_drawn_and_exported(succeed, tmp_path):
    which = {"classes": ["easy", "hard"], "per_class": 2, "seed": 5}
    worlds = barn.worlds.generate_moving(tmp_path / "own.npz", **which)
    dataset = open_dataset(tmp_path / "own.npz")
    assert dataset.world_numbers == (0, 1, 2, 3)
    again = barn.worlds.generate_moving(**which)
    for number, world in worlds.items():
        assert world.checksum == dataset.load(number).checksum
        assert world.checksum == again[number].checksum
    for shown in ("all --out sheet", "1 --out one", "1 --out also"):
        succeed(f"show --dataset own.npz {shown}.png")
    succeed("show 1 --dataset own.npz --out one.gif")
    assert Image.open(tmp_path / "one.gif").n_frames > 50
    assert (tmp_path / "also.png").read_bytes() == (tmp_path / "one.png").read_bytes()
    for form, file in (("sdf", "world_1.sdf"), ("yaml", "world_1.world.yaml")):
        succeed(f"worlds convert own.npz {form} --format {form} --worlds 1")
        assert (tmp_path / form / file).is_file()
    assert open_dataset(tmp_path / "yaml").load(1).checksum == dataset.load(1).checksum


@pytest.mark.parametrize("crossing", [False, True])
def test_worlds_of_a_data_set_get_moving_obstacles(succeed, tmp_path, crossing):
    which = {"source": "barn300", "select": "3,7", "crossing": crossing, "obstacles": 3}
    barn.worlds.generate_moving(tmp_path / "own.npz", ["easy"], **which)
    moving = open_dataset(tmp_path / "own.npz")
    still = open_dataset("barn300")
    assert moving.world_numbers == (3, 7)
    for index in moving.world_numbers:
        world = moving.load(index)
        assert len(world.moving) == 3
        assert (world.grid == still.load(index).grid).all()
    succeed("metrics own.npz")  # of what stands


MISTAKES = """
show 0-59 --dataset dynabarn60 --out x.gif
    an animation shows one world, got 60
show 3 --out x.gif
    world_3: nothing moves in it
worlds convert dynabarn60 x --format original
    cannot hold walls, moving obstacles, arenas or surveyed positions
metrics dynabarn60 --worlds 3
    dynabarn_3: is an arena or a map with a course of its own; metrics and difficulty
difficulty predict dynabarn60 --worlds 3
    dynabarn_3: is an arena or a map with a course of its own; metrics and difficulty
"""


@pytest.mark.parametrize("line, complaint", answers_of(MISTAKES))
def test_a_mistake_is_one_clear_line_and_leaves_nothing(rejected, line, complaint):
    assert complaint in rejected(line)


WRONG_MOTIONS = """
{source: barn300}
    take one class of motion, got 3
{crossing: true}
    crossing and obstacles are for the worlds of a data set
{classes: [esy]}
    unknown motion class 'esy'; did you mean 'easy'?
{parameters: {radius: 1}}
    did you mean 'radius_m'?
"""


def test_from_python_a_mistake_is_an_error_of_the_suite():
    for wrong, message in answers_of(WRONG_MOTIONS):
        with refused(re.escape(message)):
            barn.worlds.generate_moving(**yaml.safe_load(wrong))
    with refused("exists already", BarnError):
        barn.worlds.generate_moving(open_dataset("dynabarn60").load(0).provenance.path)


def test_the_bag_of_a_trial_has_the_true_poses_of_its_phase(tmp_path):
    spec = spec_of(30, DYNABARN)
    result = recorded(spec, tmp_path / "bag").result
    assert result.motion.phase_s == spec.phase_s == spec.description()["phase_s"] > 0.0
    messages = BagFile(tmp_path / "bag").messages()
    poses = [item for item in messages if item.topic == MOVING_POSES.path]
    assert len(poses) >= 10 * result.scores.duration_s - 1
    for item in poses:
        expected = spec.world.tracks.at(spec.phase_s + item.stamp_ns * 1e-9)[0]
        message = deserialize(item.data, MOVING_POSES.type_name)
        positions = [(pose.position.x, pose.position.y) for pose in message.poses]
        np.testing.assert_allclose(positions, expected, atol=1e-9)


def test_repetitions_have_phases_that_planners_share():
    phases = [spec_of(30, DYNABARN, repetition=k).phase_s for k in range(5)]
    assert len(set(phases)) == 5
    assert spec_of(30, DYNABARN, "dwa").phase_s == phases[0]
