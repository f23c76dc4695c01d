"""What neither a planner nor a busy machine can do to a trial over ROS.

Real processes over real DDS.
"""

import os
import signal
import subprocess
import sys
import threading
import time
from dataclasses import replace

import pytest
from ros_runs import (
    EACH,
    SHORT,
    drive,
    drive_kinds,
    make_plan,
    messages,
    node_process,
    nothing_left,  # noqa: F401 (a fixture)
)
from waiting import until

from barn_eval.ros.supervision.process import ProcessError
from barn_eval.trials.result import Outcome
from barn_worlds.ros.domain import reserve_domain


def test_scores_cannot_be_forged(tmp_path):
    messages = {
        "poses": "/foreign publishes /odom",
        "older_stamps": "/foreign publishes /clock",
        "no_contact": "/foreign publishes /collision",
        "score": "/foreign publishes /score",
        "twin": "2 nodes are named /simulator",
        "parameters": "/foreign set start_y_m of simulator",
        "reset": "/foreign called simulator/reset",
        "pause": "/foreign called simulator/pause",
    }
    *results, last = drive_kinds(tmp_path, *messages, "drives")
    for message, result in zip(messages.values(), results, strict=True):
        assert result.detail == message
        assert (result.outcome, result.fault) == (Outcome.INTERFERENCE, "planner")
        assert (result.scores.success, result.scores.challenge) == (False, 0.0)
        assert result.measures.driven_m < 2.0
    # whoever comes after is judged by what the simulator says, as if nobody had been
    # there before
    assert (last.outcome, last.remarks) == (Outcome.TIMEOUT, "")
    assert 0.5 < last.measures.driven_m < 1.3


@pytest.mark.parametrize("is_public", [False, True])
def test_the_truth_is_public_only_on_request(tmp_path, is_public):
    setup = replace(EACH, ground_truth=is_public)
    (result,) = drive_kinds(tmp_path, "curious", setup=setup)
    assert result.outcome is Outcome.TIMEOUT
    assert (tmp_path / "starts.heard").exists() is is_public
    assert result.remarks == (
        "/foreign subscribed to /ground_truth/odom; "
        "2 publishers on /cmd_vel: /foreign, /foreign"
    )
    heard = messages(tmp_path / "run" / "bags" / result.trial_id)
    # the bag has it all the same
    assert len(heard["/ground_truth/odom"]) == len(heard["/scan"])


def test_a_command_that_cannot_be_read_is_the_planners_fault(tmp_path):
    (broken,) = drive_kinds(tmp_path, "broken_command")
    assert (broken.outcome, broken.fault) == (Outcome.INVALID_COMMAND, "planner")
    assert broken.detail == "command (nan m/s, nan rad/s) is not finite"


def test_an_earlier_simulator_is_not_the_planners_fault(tmp_path, monkeypatch):
    with reserve_domain({}) as domain:
        pass
    monkeypatch.setenv("ROS_DOMAIN_ID", str(domain))
    monkeypatch.setenv("ROS_AUTOMATIC_DISCOVERY_RANGE", "LOCALHOST")
    words = "-m barn_sim.ros.simulator --ros-args -r __node:=gazebo"
    other = [sys.executable, *words.split()]
    stranger = subprocess.Popen(other, stderr=subprocess.PIPE, text=True)
    try:
        next(line for line in stranger.stderr if "world_0" in line)
        words = f"^ROS_DOMAIN_ID {domain}: /gazebo publishes /"
        with pytest.raises(ProcessError, match=words):
            list(drive(tmp_path / "run", make_plan(ros=EACH)))
    finally:
        stranger.kill()
        stranger.communicate()
    assert not (tmp_path / "run" / "results.jsonl").exists()
    assert not (tmp_path / "run" / "logs" / "planner.log").exists()


def test_an_evaluator_without_processor_time_is_waited_for(
    tmp_path,
    nothing_left,  # noqa: F811
):
    longer = replace(
        SHORT, limit_s=20.0, timeout_time_s=20.0, collision_ends_trial=False
    )
    bags = tmp_path / "run" / "bags"
    part = bags / "foreign_w0000_r00.partial" / "foreign_w0000_r00_0.mcap"

    def suspend():
        for size in (10_000, 100_000, 200_000):
            until(lambda size=size: part.exists() and part.stat().st_size > size)
            (pid,) = node_process(nothing_left, "barn_eval.ros.evaluator")
            os.kill(pid, signal.SIGSTOP)
            time.sleep(1.0)  # dozens of cycles, far more than publishers keep
            os.kill(pid, signal.SIGCONT)

    suspended = threading.Thread(target=suspend, daemon=True)
    suspended.start()
    (result,) = drive_kinds(tmp_path, "talks", protocol=longer)
    suspended.join(timeout=600.0)
    assert not suspended.is_alive()
    assert result.measures.unanswered_cycles == 0
    bag = messages(tmp_path / "run" / "bags" / result.trial_id)
    cycles = len(bag["/odom"])
    assert cycles > 200
    for topic in ("/scan", "/amcl_pose", "/clock"):
        assert len(bag[topic]) == cycles
    for topic in ("/cmd_vel", "/thoughts"):
        assert len(bag[topic]) in (cycles - 1, cycles)
