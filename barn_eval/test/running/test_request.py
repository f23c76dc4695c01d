"""Campaigns from YAML and options: what comes out, and what is refused in one line."""

import re
from pathlib import Path

import pytest
import yaml
from refusals import refused
from text_tables import answers_of, rows_of

from barn_eval.running.command_files import read_node_parameters, write_node_parameters
from barn_eval.running.request import RunRequest, read_request
from barn_eval.trials.protocol import CHALLENGE
from barn_eval.trials.ros_config import RosConfig
from barn_eval.trials.run_config import (
    ExecutionConfig,
    PlannerChoice,
    RunConfig,
    fill_placeholders,
)
from barn_eval.trials.spec import simulator_config
from barn_worlds.base.config import as_dict, from_dict
from barn_worlds.base.errors import BarnError
from barn_worlds.base.types import Pose2D

FILE = """
schema_version: 1
dataset: barn300
worlds: 0-9
planners:
  - dwa
  - name: eband
    preset: challenge
    overrides: {band.external_gain: 2.0}
repetitions: 3
protocol: challenge
simulator: {lidar.noise_m: 0.02}
seed: 7
bags: failed
execution: {workers: 4, trial_limit_s: 90.0}
out: results
"""


OPTIONS = """
worlds: 0-9
planners: dwa,eband:challenge
settings: {eband: {band.external_gain: 2.0}}
repetitions: 3
protocol: challenge
simulator: {lidar.noise_m: 0.02}
seed: 7
bags: failed
workers: 4
trial_limit_s: 90.0
out: results
"""


@pytest.fixture
def file(tmp_path):
    path = tmp_path / "campaign.yaml"
    path.write_text(FILE)
    return path


def test_a_file_says_it_all(file):
    rules = {
        "protocol": CHALLENGE,
        "simulator": simulator_config(CHALLENGE, {"lidar.noise_m": 0.02}),
    }
    rules |= {
        "dataset": "barn300",
        "worlds": "0-9",
        "repetitions": 3,
        "seed": 7,
        "bags": "failed",
    }
    planners = (
        PlannerChoice("dwa"),
        PlannerChoice("eband", "challenge", {"band.external_gain": 2.0}),
    )
    execution = ExecutionConfig(workers=4, trial_limit_s=90.0)
    assert read_request(file, {}) == RunRequest(
        RunConfig(planners=planners, **rules), execution, Path("results")
    )


def test_options_say_the_same(file):
    options = yaml.safe_load(OPTIONS)
    assert read_request(None, options) == read_request(file, {})


def test_an_option_counts_instead_of_what_the_file_says(file):
    campaign = read_request(
        file, {"seed": 8, "workers": 1, "worlds": None, "out": "elsewhere"}
    )
    assert (campaign.config.seed, campaign.config.worlds) == (8, "0-9")
    assert (campaign.execution.workers, campaign.execution.trial_limit_s) == (1, 90.0)
    assert campaign.out == Path("elsewhere")


def test_a_configuration_comes_back_from_plain_data(file):
    config = read_request(file, {}).config
    assert from_dict(RunConfig, as_dict(config), "run.json") == config
    assert config.ros == RosConfig()


def test_trials_share_everything_but_the_planner(file):
    first, second, *_ = read_request(file, {"worlds": "0"}).config.trials()
    assert (first.planner, second.planner) == ("dwa", "eband")
    assert first.preset == second.preset == "challenge"
    assert second.overrides == {"band.external_gain": 2.0}
    assert first.planner_config != second.planner_config
    assert (first.task, first.simulator) == (second.task, second.simulator)
    assert first.run_seed == second.run_seed == 7
    assert first.world is second.world


def test_one_planner_drives_twice_under_two_names():
    planners = "dwa,fast=dwa:fast_dwa"
    settings = {"fast": {"dwa.path_weight": 0.3}}
    options = {"planners": planners, "settings": settings, "worlds": "0"}
    config = read_request(None, options).config
    assert from_dict(RunConfig, as_dict(config), "run.json") == config
    dwa, fast = config.trials()
    assert [dwa.trial_id, fast.trial_id] == ["dwa_w0000_r00", "fast_w0000_r00"]
    assert fast.description()["planner"]["entry"] == "dwa"
    assert fast.speed_cap_mps == 2 * dwa.speed_cap_mps
    assert dwa.planner_seed != fast.planner_seed
    options |= {"planners": "dwa:fast_dwa", "settings": settings["fast"]}
    (alone,) = read_request(None, options).config.trials()
    assert fast.planner_config == alone.planner_config


def test_what_nobody_says_has_its_default():
    request = read_request(None, {})
    assert (request.config, request.execution) == (RunConfig(), ExecutionConfig())
    assert request.out.parent == Path("out")


SETTINGS = """
dwa | {dwa: {dwa.max_speed_mps: 0.2}} | [{dwa.max_speed_mps: 0.2}]
dwa | {dwa.max_speed_mps: 0.2} | [{dwa.max_speed_mps: 0.2}]
dwa | {dwa.dwa.max_speed_mps: 0.2} | [{dwa.max_speed_mps: 0.2}]
gap | {max_speed_mps: 0.2} | [{max_speed_mps: 0.2}]
gap | {gap.max_speed_mps: 0.2} | [{max_speed_mps: 0.2}]
dwa,gap | {gap.max_speed_mps: 0.2, dwa.dwa.max_speed_mps: 1} | [{dwa.max_speed_mps: 1}, {max_speed_mps: 0.2}]
"""


@pytest.mark.parametrize("planners, settings, overrides", rows_of(SETTINGS))
def test_a_setting_names_its_planner_where_there_are_several(
    planners, settings, overrides
):
    settings, overrides = map(yaml.safe_load, (settings, overrides))
    request = read_request(None, {"planners": planners, "settings": settings})
    assert [planner.overrides for planner in request.config.planners] == overrides
    assert len(request.config.trials()) == 300 * len(overrides)


def test_settings_of_mode_ros_and_bags_belong_to_the_experiment():
    options = {
        "mode": "ros",
        "planners": "mine",
        "planner_command": "run me",
        "bags": "failed",
        "out": "x",
    }
    ros = {"restart_planner": "each_trial", "patience.gate_s": 60.0}
    experiment = read_request(None, options | {"ros": ros}).config
    assert experiment.planners == (PlannerChoice("mine", command="run me"),)
    assert experiment.bags == "failed"
    assert experiment.ros.restart_planner == "each_trial"
    assert experiment.ros.patience.gate_s == 60.0
    ros = {"restart_planner": "each_trial", "patience": {"gate_s": 60.0}}
    nested = read_request(None, options | {"ros": ros})
    assert nested.config == experiment


@pytest.mark.parametrize(
    "ros",
    [
        {"remap": ["scan:=/front/scan"]},
        {"remap": {"scan": "/front/scan"}},
        {"remap.scan": "/front/scan"},
    ],
)
def test_topics_are_renamed_by_rules_or_one_by_one(ros):
    options = {"planners": "gap", "mode": "ros", "out": "x", "ros": ros}
    assert read_request(None, options).config.ros.remap == ("scan:=/front/scan",)
    wrong = options | {"ros": {"remap.scan": "front scan"}}
    with refused("remap must be of the form FROM:=TO"):
        read_request(None, wrong)


def test_suite_nodes_and_foreign_commands_drive_together(tmp_path):
    file = tmp_path / "mixed.yaml"
    file.write_text(
        "schema_version: 1\nmode: ros\nout: x\n"
        "planners: [dwa, {name: mine, command: python3 mine.py}, {command: ros2 run theirs their_planner}]\n"
    )
    expected = (
        PlannerChoice("dwa"),
        PlannerChoice("mine", command="python3 mine.py"),
        PlannerChoice("their_planner", command="ros2 run theirs their_planner"),
    )
    assert read_request(file, {}).config.planners == expected
    assert read_request(file, {"planners": "mine,dwa"}).config.planners == (
        expected[1],
        expected[0],
    )
    commands = ("mine=python3 mine.py", "their_planner=ros2 run theirs their_planner")
    options = {
        "mode": "ros",
        "out": "x",
        "planners": "dwa",
        "planner_command": commands,
    }
    assert read_request(None, options).config.planners == expected


COMMANDS = """
python examples/simple_planner.py
    simple_planner
/opt/venv/bin/python3.11 -I -X dev 'my planner.py' --speed=0.5
    my_planner
env A=1 python3 -m template_planner.node
    template_planner
ros2 run template_planner_cpp template_planner
    template_planner
bash examples/in_workspace.sh install/setup.bash ros2 run my_nav host --ros-args
    host
ros2 launch my_robot navigation.launch.py map:=true
    navigation
ros2 launch examples/nav2/nav2.launch.py controller:=rpp
    nav2
./build/drive --ros-args -r cmd_vel:=/drive
    drive
"""


@pytest.mark.parametrize("command, name", answers_of(COMMANDS))
def test_a_command_gives_its_planner_a_name(command, name):
    options = {"mode": "ros", "planner_command": command, "out": "x"}
    (planner,) = read_request(None, options).config.planners
    assert (planner.name, planner.command) == (name, command)


def test_a_package_is_a_command_and_an_input_belongs_to_its_planner(tmp_path):
    (tmp_path / "mine.py").write_text("def main(): ...\n")
    options = {
        "mode": "ros",
        "planner_package": f"ours={tmp_path}/mine.py --ros-args -p x:={{goal_x}}",
        "planner_command": "theirs=python theirs.py",
        "planner_input": "theirs={goal_x}\\n{goal_y}",
        "out": "x",
    }
    theirs, ours = read_request(None, options).config.planners
    assert ours.command == f"package:{tmp_path}/mine.py --ros-args -p x:={{goal_x}}"
    assert list(ours.files) == [f"{tmp_path}/mine.py"]
    assert theirs.input == "{goal_x}\n{goal_y}\n"
    assert ours.takes_goal_at_start
    assert theirs.takes_goal_at_start


def test_a_goal_is_written_as_ros_reads_numbers():
    text = "{goal_x} {goal_y} {goal_yaw} {frame} {other}"
    filled = fill_placeholders(text, Pose2D(10, -1e-9, 1.5707963), "odom")
    assert filled == "10.0 -0.0 1.570796 odom {other}"


MISTAKES = """
{planner_package: [nowhere], planners: [], mode: ros}
    planner package 'nowhere': no folder or Python file nowhere
{planner_package: 7, mode: ros}
    planner_package must be a text or a list of texts, got 7
{planner_command: mine=run me, planner_input: other=1, mode: ros}
    planner input 'other=1': must be NAME=TEXT, where NAME is a planner
{planner_input: '1', planners: dwa, mode: ros}
    planner 'dwa': only a planner with a command can have an input
{planners: 'dwa,dwa:challenge'}
    names 'dwa' twice; give one another name, such as dwa_2=dwa:challenge
{planners: 'gap=dwa'}
    planner 'gap': is a planner of the registry; give this dwa another name
{planners: []}
    must name at least one planner
{planners: 3}
    a planner must be a name, a Planner class or object, or a function of the observation, got 3
{planner_command: 7}
    planner_command must be a text or a list of texts, got 7
{planner_command: [[a]]}
    planner_command must be a text or a list of texts, got [['a']]
{planners: [{nam: dwa}]}
    planners: unknown key 'nam'; did you mean 'name'?
{settings: {ebadn: {a: 1}}}
    of planner 'ebadn', which is not part of the run; did you mean 'eband'?
{repetitions: 0}
    : repetitions must be from 1 to 99, got 0
{seed: -1}
    : seed must be
{protocol: papper}
    unknown protocol 'papper'; did you mean 'paper2020'?
{protocol: {base: paper2020}}
    protocol must be a name or a YAML file, got
{mode: dirct}
    did you mean 'direct'?
{planner_command: run me, planners: mine}
    planner 'mine': a planner command needs mode ros
{planner_command: run me, mode: ros}
    give it as NAME=COMMAND if there are several planners
{planner_command: [a, b], planners: [], mode: ros}
    give it as NAME=COMMAND
{planner_command: python dwa.py, planners: [], mode: ros}
    a name; 'dwa' is a planner of the suite
{planner_command: '''', planners: x, mode: ros}
    planner command "'": No closing quotation
{planner_command: ' ', planners: x, mode: ros}
    planner command must name a program, got ' '
{planners: a/b}
    planner 'a/b': a name must be 1 to 60 letters
{mode: ros, planner_command: dwa=mine}
    planner 'dwa': is a planner of the suite
{mode: ros, planner_command: E-Band=mine}
    planner 'E-Band': is a planner of the suite
{planners: [{name: x, command: y, preset: z}]}
    only registered planners have presets
{ros: {restart_planner: never}}
    the settings of ros need mode ros
{mode: ros, ros: {bags: none}}
    ros.bags is set by bags (--bags)
{mode: ros, ros: {lockstp: true}}
    did you mean 'lockstep'?
{execution: 3}
    execution must be a mapping
{settings: 5}
    settings must be a mapping
{settings: {1: 2}}
    parameters of planner '1'
{mode: ros, engine: ray}
    mode ros needs engine local
{engine: slurm}
    execution: engine must be one of local, ray, inline, got 'slurm'
{address: 'head:6379'}
    execution: address needs engine ray
{workers: -1}
    execution: workers must be
{simulator: {lidar.beam: 3}}
    did you mean 'lidar.beams'?
{out: ''}
    out must name a folder for the results
{out: null, repetitons: 3}
    unknown key 'repetitons'; did you mean 'repetitions'?
"""


@pytest.mark.parametrize("options, words", answers_of(MISTAKES))
def test_mistakes_are_told_in_one_line(file, options, words):
    with refused(re.escape(words), BarnError):
        read_request(file, yaml.safe_load(options))


def test_files_that_a_command_names_are_known_by_their_content(tmp_path):
    parameters = tmp_path / "p.yaml"
    script = tmp_path / "planner.py"
    parameters.write_text("a: 1")
    script.touch()
    command = f"python {script} --params-file {parameters} params_file:={parameters} other.yaml --fast=yes"

    file = tmp_path / "c.yaml"
    file.write_text(
        f"schema_version: 1\nmode: ros\nplanners: [{{name: mine, command: '{command}'}}]\n"
    )

    def read_configs():
        requests = [
            read_request(file, {}),
            read_request(None, {"planner_command": command, "mode": "ros"}),
        ]
        return [item.config for item in requests]

    before = [item.planners[0].files for item in read_configs()]
    assert before[0] == before[1]
    assert set(before[0]) == {str(parameters), str(script)}
    earlier = [
        item.resolve_planner(item.planners[0]).planner_config for item in read_configs()
    ]
    parameters.write_text("a: 2")
    changed = read_configs()[0]
    assert changed.planners[0].files[str(script)] == before[0][str(script)]
    assert changed.planners[0].files[str(parameters)] != before[0][str(parameters)]
    assert changed.resolve_planner(changed.planners[0]).planner_config not in earlier


def test_parameters_that_nodes_tell_are_kept_and_may_not_change(tmp_path):
    logs = tmp_path / "out" / "logs"
    logs.mkdir(parents=True)
    write_node_parameters(logs, logs, "mine", '{"/a speed": "0.5", "/b": "tells none"}')
    write_node_parameters(logs, logs, "mine", '{"/a speed": "0.5", "/c turn": "1.0"}')
    write_node_parameters(logs, logs, "another_mine", '{"/a speed": "1.0"}')
    assert read_node_parameters(logs, "mine") == {
        "/a speed": "0.5",
        "/b": "tells none",
        "/c turn": "1.0",
    }
    with refused(r"planner 'mine': parameter /a speed was '0.5' there, is '0.6' now"):
        write_node_parameters(logs, logs, "mine", '{"/a speed": "0.6"}')


def test_a_ros_domain_of_the_user_has_one_worker(monkeypatch):
    monkeypatch.setenv("ROS_DOMAIN_ID", "7")
    assert read_request(None, {"mode": "ros"}).execution.workers == 1
    assert read_request(None, {"mode": "direct"}).execution.workers == 0
    with refused(
        r"workers: must be 1 with ROS_DOMAIN_ID 7, got 2; use --workers 1, or"
    ):
        read_request(None, {"mode": "ros", "workers": 2})
