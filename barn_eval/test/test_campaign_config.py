"""Campaigns from YAML and options: what comes out, and what is refused in one line."""

from pathlib import Path

import pytest

from barn_eval.experiments.config import CampaignConfig, ExecutionConfig, PlannerChoice, read_campaign
from barn_eval.trials.protocol import CHALLENGE
from barn_eval.trials.spec import simulator_config
from barn_worlds.config import as_dict, from_dict
from barn_worlds.errors import BarnError

FILE = """
schema_version: 1
dataset: barn300
worlds: 0-9
planners:
  - dwa
  - name: eband
    preset: challenge
    overrides: {some.gain: 2.0}
repetitions: 3
protocol: challenge
simulator: {lidar.noise_m: 0.02}
seed: 7
bags: failed
execution: {workers: 4, trial_limit_s: 90.0}
out: results
"""


@pytest.fixture
def file(tmp_path):
    path = tmp_path / "campaign.yaml"
    path.write_text(FILE)
    return path


def test_a_file_says_it_all(file):
    campaign = read_campaign(file, {})
    assert campaign.out == Path("results")
    assert campaign.execution == ExecutionConfig(workers=4, trial_limit_s=90.0)
    config = campaign.config
    assert config.planners == (PlannerChoice("dwa"), PlannerChoice("eband", "challenge", {"some.gain": 2.0}))
    assert config.protocol == CHALLENGE
    assert config.simulator == simulator_config(CHALLENGE, {"lidar.noise_m": 0.02})
    assert (config.worlds, config.repetitions, config.seed, config.bags) == ("0-9", 3, 7, "failed")


def test_options_say_the_same(file):
    options = {
        "worlds": "0-9",
        "planners": "dwa,eband:challenge",
        "settings": {"eband": {"some.gain": 2.0}},
        "repetitions": 3,
        "protocol": "challenge",
        "simulator": {"lidar.noise_m": 0.02},
        "seed": 7,
        "bags": "failed",
        "workers": 4,
        "trial_limit_s": 90.0,
        "out": Path("results"),
    }
    assert read_campaign(None, options) == read_campaign(file, {})


def test_an_option_counts_instead_of_what_the_file_says(file):
    campaign = read_campaign(file, {"seed": 8, "workers": 1, "worlds": None, "out": "elsewhere"})
    assert (campaign.config.seed, campaign.config.worlds) == (8, "0-9")
    assert (campaign.execution.workers, campaign.execution.trial_limit_s) == (1, 90.0)
    assert campaign.out == Path("elsewhere")


def test_a_configuration_comes_back_from_plain_data(file):
    config = read_campaign(file, {}).config
    assert from_dict(CampaignConfig, as_dict(config), "run.json") == config


def test_plans_share_everything_but_the_planner(file):
    first, second = read_campaign(file, {}).config.plans()
    assert (first.planner, second.planner) == ("dwa", "eband")
    assert (second.preset, second.overrides) == ("challenge", {"some.gain": 2.0})
    assert first.seed == second.seed == 7
    assert first.simulator == second.simulator


def test_options_of_mode_ros_reach_the_plans():
    options = {"mode": "ros", "planners": "mine", "planner_command": "run me", "bags": "failed", "out": "x"}
    (plan,) = read_campaign(None, options | {"ros": {"restart_planner": "each_trial"}}).config.plans()
    assert (plan.mode, plan.planner_command) == ("ros", "run me")
    assert (plan.ros.restart_planner, plan.ros.bags) == ("each_trial", "failed")


@pytest.mark.parametrize(
    ("options", "words"),
    [
        ({"planners": "dwa,dwa:challenge"}, "names 'dwa' twice; run two campaigns and use `barn compare`"),
        ({"planners": []}, "must name at least one planner"),
        ({"planners": 3}, "planners must be a list of names, got 3"),
        ({"planners": [{"nam": "dwa"}]}, "planners: unknown key 'nam'; did you mean 'name'?"),
        (
            {"settings": {"ebadn": {"a": 1}}},
            "of planner 'ebadn', which is not in the campaign; did you mean 'eband'?",
        ),
        ({"repetitions": 0}, "repetitions must be from 1 to 99, got 0"),
        ({"seed": -1}, "campaign.yaml: seed must be"),
        ({"protocol": "papper"}, "unknown protocol 'papper'; did you mean 'paper'?"),
        ({"protocol": {"base": "paper"}}, "protocol must be a name or a YAML file, got"),
        ({"mode": "dirct"}, "did you mean 'direct'?"),
        ({"planner_command": "run me"}, "planner_command needs mode ros"),
        ({"planner_command": "run me", "mode": "ros"}, "starts one planner; name one planner only"),
        ({"ros": {"restart_planner": "never"}}, "ros needs mode ros"),
        ({"mode": "ros", "ros": {"bags": "none"}}, "ros.bags must not be given"),
        ({"mode": "ros", "engine": "ray"}, "mode ros needs engine local"),
        ({"engine": "slurm"}, "execution: engine must be one of local, ray, got 'slurm'"),
        ({"address": "head:6379"}, "execution: address needs engine ray"),
        ({"workers": -1}, "execution: workers must be"),
        ({"simulator": {"lidar.beam": 3}}, "did you mean 'lidar.beams'?"),
        ({"out": ""}, "out must be a folder, got ''"),
        ({"out": None, "repetitons": 3}, "unknown key 'repetitons'; did you mean 'repetitions'?"),
    ],
)
def test_mistakes_are_told_in_one_line(file, options, words):
    with pytest.raises(BarnError) as error:
        read_campaign(file, options)
    assert words in str(error.value)
    assert "\n" not in str(error.value)


@pytest.mark.parametrize(
    ("text", "words"),
    [
        ("schema_version: 2\n", "schema_version must be 1, got 2"),
        ("- a\n", "must be a mapping"),
        ("a: [\n", "not YAML"),
        ("schema_version: 1\nout: x\nexecution: {worker: 2}\n", "unknown key 'worker'; did you mean 'workers'?"),
        ("schema_version: 1\n", "out must be a folder, got None"),
    ],
)
def test_mistakes_in_the_file_name_it(tmp_path, text, words):
    path = tmp_path / "campaign.yaml"
    path.write_text(text)
    with pytest.raises(BarnError) as error:
        read_campaign(path, {})
    assert str(error.value).startswith(str(path))
    assert words in str(error.value)
