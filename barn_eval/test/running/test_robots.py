"""What --robot changes from the request to the board."""

import json
import math
from contextlib import closing
from dataclasses import replace

import numpy as np
import pytest
from planners import run_inline
from refusals import refused

import barn_eval as barn
from barn_eval.analysis.overview import reproduce
from barn_eval.analysis.sources import read_source
from barn_eval.results.bags.recorded import read_recorded_trial
from barn_eval.results.rows import unseal_line
from barn_eval.results.run_file import RunFile
from barn_eval.running.request import read_request
from barn_eval.trials import identity
from barn_eval.trials.protocol import CHALLENGE
from barn_eval.trials.result import SCHEMA_VERSION
from barn_eval.trials.spec import simulator_config
from barn_sim.config import PRESETS, robot_of, with_robot
from barn_worlds.base.config import as_dict
from barn_worlds.datasets.dataset import open_dataset
from barn_worlds.formats.dataset_file import write_dataset_file
from barn_worlds.robots.files import find_robot_files, load_robot, robot_yaml
from barn_worlds.worlds.course import cell_size_m

HUSKY = load_robot("husky")


def config_for(**options):
    return read_request(None, {"out": "unused", "worlds": "0", **options}).config


@pytest.fixture(scope="module")
def husky_worlds(tmp_path_factory):
    path = tmp_path_factory.mktemp("worlds") / "husky.npz"
    file = str(find_robot_files()["husky"])
    barn.worlds.generate(
        path, per_set=1, seed=5, robot=file, parameters={"initial_fill": 0.15}
    )
    return path


@pytest.fixture(scope="module")
def folders(husky_worlds, tmp_path_factory):
    """Results of a Husky and of a Jackal, of one trial each."""
    out = tmp_path_factory.mktemp("results")
    options = {
        "dataset": str(husky_worlds),
        "worlds": "0",
        "planners": "gap",
        "engine": "inline",
        "progress": False,
    }
    for name in ("husky", "jackal"):
        barn.run(**options, robot=name, out=out / name, bags="all")
    return out / "husky", out / "jackal"


def test_the_jackal_by_name_is_what_it_is_without():
    assert config_for(robot="jackal") == config_for()


def test_robots_by_name_file_and_object(tmp_path):
    mine = tmp_path / "mine.yaml"
    mine.write_text(
        find_robot_files()["husky"].read_text().replace("name: husky", "name: mine")
    )
    assert config_for(robot="husky").simulator.chassis == HUSKY.chassis
    assert config_for(robot=HUSKY).simulator == config_for(robot="husky").simulator
    # The content is the husky's, whatever its file calls it.
    simulator = config_for(
        robot=str(mine), simulator={"drive.max_speed_m_s": 0.5}
    ).simulator
    assert (simulator.chassis.name, simulator.drive.max_speed_m_s) == ("husky", 0.5)
    for wrong in ("huski", 7):
        with refused("robot"):
            config_for(robot=wrong)


def test_presets_keep_their_noise_for_other_robots():
    ideal = with_robot(PRESETS["ideal"], HUSKY)
    assert (
        ideal.lidar.noise_m,
        ideal.drive.command_latency_s,
        ideal.odometry.yaw_noise_rad,
    ) == (0.0, 0.0, 0.0)
    assert ideal.lidar.mount_x_m == HUSKY.lidar.mount_x_m
    preset = with_robot(PRESETS["known_map"], HUSKY)
    assert preset.localisation == PRESETS["known_map"].localisation
    assert robot_of(preset) == replace(HUSKY, summary="", sources={})


def test_tasks_and_planners_differ_by_robot():
    husky = config_for(robot="husky", planners="dwa")
    jackal = config_for(planners="dwa")
    (husky_trial,), (other,) = husky.trials([0]), jackal.trials([0])
    assert husky_trial.task != other.task
    assert husky_trial.planner_config != other.planner_config
    larger = math.hypot(0.495, 0.335) / math.hypot(0.254, 0.215)
    assert husky_trial.overrides["dwa.max_speed_mps"] == pytest.approx(0.5 * larger)
    assert other.overrides == {}


def test_content_decides_the_task_not_the_name(tmp_path):
    light = replace(HUSKY, chassis=replace(HUSKY.chassis, mass_kg=50.0))
    renamed = replace(light, chassis=replace(light.chassis, name="mine"))
    trials = [config_for(robot=robot).trials([0])[0] for robot in (light, renamed)]
    assert [trial.simulator.chassis.name for trial in trials] == ["husky (own)", "mine"]
    assert trials[0].task == trials[1].task
    assert trials[0].task != config_for(robot="husky").trials([0])[0].task
    earlier = RunFile.for_run(tmp_path, config_for(robot=light), trials[:1])
    earlier.require_same_run(
        RunFile.for_run(tmp_path, config_for(robot=renamed), trials[1:])
    )

    # Rows of earlier versions have a fingerprint with the name in it.
    config = as_dict(config_for(robot=renamed))
    robot = identity.named_robot_sha256(renamed.chassis)
    named = {
        "protocol": config["protocol"],
        "simulator": config["simulator"],
        "robot": robot,
        **identity.CODE_VERSIONS,
    }
    run = {"schema_version": SCHEMA_VERSION, "experiment": config, "robot": robot}
    run["code_versions"] = identity.CODE_VERSIONS
    (tmp_path / "run.json").write_text(json.dumps(run))
    run_file = RunFile.read(tmp_path)
    assert run_file.task_fingerprint == trials[1].task
    for task in ("", trials[1].task, identity.fingerprint(named)):
        assert run_file.has_task(task)
    assert not run_file.has_task("0123456789ab")


def test_a_robot_wider_than_all_passages_meets_scaled_worlds():
    corners = tuple((2.0 * x, 1.6 * y) for x, y in HUSKY.chassis.footprint_m)
    body = replace(HUSKY.chassis, name="wide", footprint_m=corners)
    wide = replace(HUSKY, chassis=body)
    (trial,) = config_for(robot=wide).trials([0])
    assert trial.world.resolution_m == cell_size_m(wide) == 0.585
    # The whole robot stands before the back wall.
    assert trial.course.start.y - 0.99 > trial.world.resolution_m
    # A husky is narrow enough for the worlds as they are.
    assert config_for(robot="husky").trials([0])[0].world.resolution_m == 0.15


def test_a_planner_that_cannot_drive_it_is_refused(rejected):
    message = rejected("run --worlds 0 --planner policy --robot husky --out unused")
    assert "the shipped policy was trained only for the Jackal" in message


def test_results_say_which_robot(folders):
    husky, jackal = folders
    assert read_source(husky).robot == "husky"
    again = reproduce(read_source(husky)).command
    assert "--robot husky" in again and "--sim" not in again
    assert "--robot" not in reproduce(read_source(jackal)).command
    recorded = read_recorded_trial(next((husky / "bags").iterdir()))
    assert recorded.chassis == HUSKY.chassis
    np.testing.assert_allclose(
        recorded.outline.extent_m, [-0.495, -0.335, 0.495, 0.335]
    )
    (row,) = barn.load(husky).trials
    assert row.measures.min_clearance_m == pytest.approx(
        float(np.nanmin(recorded.clearance_m)), abs=1e-6
    )


@pytest.mark.parametrize("verb", ["compare", "report", "leaderboard"])
def test_robots_are_not_mixed(verb, folders, rejected):
    message = rejected(
        verb, *folders, *(["--out", "x.html"] if verb == "report" else [])
    )
    assert (
        f"different robots cannot be compared: robot is 'husky' in {folders[0]}, 'jackal' in {folders[1]}"
        in message
    )


def test_metrics_are_those_of_the_robot(rejected):
    jackal_metrics = barn.worlds.metrics("barn300", "0")
    assert barn.worlds.metrics("barn300", "0", robot="jackal").equals(jackal_metrics)
    assert not barn.worlds.metrics("barn300", "0", robot="turtlebot4").equals(
        jackal_metrics
    )
    message = rejected("metrics barn300 --worlds 290 --robot husky")
    assert (
        "no path from the first to the last column for a robot of 7 x 7 cells"
        in message
    )


def test_environments_have_the_robot(husky_worlds):
    gymnasium = pytest.importorskip("gymnasium")
    pytest.importorskip("barn_eval.gym")
    options = {"render_mode": "rgb_array", "safety.enabled": True}
    env = gymnasium.make(
        "barn/Jackal-v0", dataset=str(husky_worlds), robot="husky", **options
    ).unwrapped
    env.reset(seed=0, options={"world": 0})
    assert env.simulator_config == simulator_config(CHALLENGE, {}, HUSKY)
    assert env._safety.half_length_m == 0.495
    assert env._safety.lidar_x_m == HUSKY.lidar.mount_x_m
    assert env.render().ndim == 3
    env.close()


def test_batched_environments_have_cells_of_one_size(husky_worlds, tmp_path):
    pytest.importorskip("gymnasium", reason="the environment is one of Gymnasium")
    from barn_eval.learning.environment import JackalVectorEnv  # noqa: PLC0415

    sized = open_dataset(husky_worlds).load(0)
    write_dataset_file(
        tmp_path / "mixed.npz", "mixed", {0: sized, 1: replace(sized, resolution_m=0.2)}
    )
    with refused("need worlds with cells of one size"):
        for seed in range(20):
            with closing(
                JackalVectorEnv(4, dataset=str(tmp_path / "mixed.npz"), robot="husky")
            ) as environments:
                environments.reset(seed=seed)


def test_a_robot_that_tips_over_ends_the_trial_by_no_fault_of_its_planner(tmp_path):
    robot = load_robot("turtlebot4")
    x, y, _ = robot.chassis.centre_of_mass_m
    chassis = replace(
        robot.chassis,
        name="pole",
        centre_of_mass_m=(x, y, 1.0),
        inertia_kg_m2=(1.0, 1.0, 0.2),
        body_height_m=1.5,
    )
    drive = replace(robot.drive, max_speed_m_s=1.0, max_acceleration_m_s2=20.0)
    path = tmp_path / "pole.yaml"
    path.write_text(robot_yaml(replace(robot, chassis=chassis, drive=drive)))
    out = tmp_path / "out"
    with refused("has no scored trial; gap_w0000_r00: robot pole tipped"):
        run_inline("0", "gap", robot=path, out=out)
    row = json.loads(unseal_line((out / "results.jsonl").read_text(), "row"))
    assert (row["outcome"], row["fault"]) == ("robot_tipped", "environment")
    assert row["detail"].startswith("robot pole tipped over: lower its centre_of_mas")
    assert barn.results.check(out).problems == []
