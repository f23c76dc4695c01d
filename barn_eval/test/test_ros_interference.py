"""A planner cannot change its own score over ROS, and what it tries is told: real processes over real DDS."""

import subprocess
import sys
from dataclasses import replace

import pytest
from ros_runs import EACH, drive, drive_kinds, make_plan, messages, nothing_left  # noqa: F401

from barn_eval.ros.supervision import ProcessError
from barn_eval.trials.outcome import Outcome
from barn_worlds.ros.domain import reserved_domain


def test_scores_cannot_be_forged(tmp_path):
    said = {
        "poses": "/foreign publishes /odom",
        "older_stamps": "/foreign publishes /clock",
        "no_contact": "/foreign publishes /collision",
        "score": "/foreign publishes /score",
        "twin": "2 nodes are named /simulator",
        "parameters": "/foreign set start_y_m of simulator",
        "reset": "/foreign called simulator/reset",
        "pause": "/foreign called simulator/pause",
    }
    *results, last = drive_kinds(tmp_path, *said, "drives")
    assert {kind: result.detail for kind, result in zip(said, results, strict=True)} == said
    assert {result.outcome for result in results} == {Outcome.INTERFERENCE}
    assert {(result.fault, result.scores.success, result.scores.challenge) for result in results} == {
        ("planner", False, 0.0)
    }
    assert all(result.measures.driven_m < 2.0 for result in results)
    # whoever comes after is judged by what the simulator says, as if nobody had been there before
    assert (last.outcome, last.remarks) == (Outcome.TIMEOUT, "")
    assert 0.5 < last.measures.driven_m < 1.3


@pytest.mark.parametrize("asked_for", [False, True])
def test_the_truth_is_on_the_planners_domain_only_where_asked_for_and_readers_are_named(tmp_path, asked_for):
    (result,) = drive_kinds(tmp_path, "curious", setup=replace(EACH, ground_truth=asked_for))
    assert result.outcome is Outcome.TIMEOUT
    assert (tmp_path / "starts.heard").exists() is asked_for
    assert result.remarks == "/foreign subscribed to /ground_truth/odom; 2 publishers on /cmd_vel: /foreign, /foreign"
    heard = messages(tmp_path / "run" / "bags" / result.trial_id)
    assert len(heard["/ground_truth/odom"]) == len(heard["/scan"])  # the bag has it all the same


def test_a_command_that_cannot_be_read_is_the_planners_fault(tmp_path):
    (broken,) = drive_kinds(tmp_path, "broken_command")
    refused = "command (nan m/s, nan rad/s) is not finite"
    assert (broken.outcome, broken.fault, broken.detail) == (Outcome.INVALID_COMMAND, "planner", refused)


def test_a_simulator_that_was_there_before_the_planner_is_not_the_planners_fault(tmp_path, monkeypatch):
    with reserved_domain({}) as domain:
        pass
    monkeypatch.setenv("ROS_DOMAIN_ID", str(domain))
    monkeypatch.setenv("ROS_AUTOMATIC_DISCOVERY_RANGE", "LOCALHOST")
    other = [sys.executable, "-m", "barn_sim.ros.simulator", "--ros-args", "-r", "__node:=gazebo"]
    stranger = subprocess.Popen(other, stderr=subprocess.PIPE, text=True)
    try:
        next(line for line in stranger.stderr if "world_0" in line)
        with pytest.raises(ProcessError, match=rf"^ROS_DOMAIN_ID {domain}: /gazebo publishes /"):
            list(drive(tmp_path / "run", make_plan(ros=EACH)))
    finally:
        stranger.kill()
        stranger.communicate()
    assert not (tmp_path / "run" / "results.jsonl").exists()
    assert not (tmp_path / "run" / "logs" / "planner.log").exists()
