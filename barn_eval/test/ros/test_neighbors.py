"""Planners that others have written.

Goals by action, managed nodes, other names, and what is said of their faults.
"""

import json
import os
import re
import signal
import subprocess
import sys
import time
from dataclasses import replace
from pathlib import Path

import ros_runs as ros
from refusals import refused
from ros_runs import nothing_left  # noqa: F401 (a fixture)
from waiting import run_python, with_search_path

from barn_eval.results.bags.bagfile import BagFile
from barn_eval.results.folder import read_results
from barn_eval.ros.supervision.process import ProcessError
from barn_eval.trials.protocol import PAPER_2020
from barn_eval.trials.result import Outcome
from barn_worlds.base.errors import ExitCode
from barn_worlds.ros.domain import reserve_domain

NEIGHBOUR = Path(__file__).parents[1].joinpath("neighbour_planner.py")


def test_a_managed_planner_gets_its_goal_by_action(tmp_path, with_extra_messages):
    notes = tmp_path / "notes"
    setup = replace(ros.MANAGED, goal_by="action", lifecycle_nodes=("managed",))
    command = ros.foreign(NEIGHBOUR, "managed", notes)
    # so that the action's answer arrives before the end on a busy machine too
    longer = replace(ros.SHORT, limit_s=3.5)
    plan = ros.make_plan(longer, setup, "managed", command, repetitions=3)
    folder = tmp_path / "run"
    results = ros.run(folder, plan)
    verdicts = ("executing", "aborted (error 104)", "succeeded")
    for result, verdict in zip(results, verdicts, strict=True):
        assert (result.outcome, result.planner_verdict) == (Outcome.TIMEOUT, verdict)
    assert read_results(folder) == results
    first, second, third = (f"goal {number} in odom: 10.0" for number in (1, 2, 3))
    events = ["active", first, "canceled", second, "refused", third]
    assert notes.read_text().splitlines() == events
    recorded = ros.messages(folder / "bags" / results[0].trial_id)
    # a type of others is recorded with the definition that its package has
    _, costmap = recorded["/costmap_raw"][-1]
    assert (costmap.metadata.layer, list(costmap.data)) == ("master", [1, 2, 3])
    # transforms are published, and recorded, where tf2_msgs is installed
    odom, base = recorded["/tf"][-1][1].transforms
    assert (odom.header.frame_id, odom.child_frame_id) == ("map", "odom")
    assert (base.header.frame_id, base.child_frame_id) == ("odom", "base_link")


def test_a_managed_node_that_stays_inactive_is_named(tmp_path, with_extra_messages):
    # the node has to tell its state within them
    patience = replace(ros.PATIENT.patience, lifecycle_s=8.0, settle_s=60.0)
    nodes = {"planner_node": "managed", "lifecycle_nodes": ("/absent",)}
    setup = replace(ros.MANAGED, goal_by="action", patience=patience, **nodes)
    command = ros.foreign(NEIGHBOUR, "inactive", tmp_path / "notes")
    plan = ros.make_plan(ros.SHORT, setup, "managed", command)
    (result,) = ros.drive(tmp_path / "run", plan)
    assert result.outcome is Outcome.PLANNER_NOT_READY
    assert result.detail.removesuffix("; use_sim_time is off in /managed") == (
        "the lifecycle node /absent is not there; the lifecycle node /managed is inactive (waited 8 s)"
    )


def test_an_action_whose_type_is_not_installed_is_one_line(tmp_path):
    kind = "no_such_msgs/action/Drive"
    setup = replace(ros.QUICK, goal_by="action", goal_action_type=kind)
    words = f"^goal_action_type '{kind}': no_such_msgs is not inst"
    with refused(words, ProcessError):
        ros.drive_kinds(tmp_path, "drives", setup=setup)


def test_what_is_missing_is_said(tmp_path):
    # the limit for all but the first, so that nothing is waited for that has to come
    setup = replace(ros.EACH, patience=replace(ros.PATIENT.patience, gate_s=5.0))
    driven, absent = ros.drive_kinds(tmp_path, "drives", "elsewhere", setup=setup)
    assert driven.outcome is Outcome.TIMEOUT
    assert absent.outcome is Outcome.PLANNER_NOT_READY
    assert re.search(
        r"no publisher on /cmd_vel; .*; no node of a planner is seen on ROS domain \d+, discovery range LOCALHOST: "
        r"compare the planner's environment \(waited 5 s\)$",
        absent.detail,
    )


def test_wall_clock_planners_and_best_effort_ones_differ(tmp_path):
    wall_clock, best_effort = ros.drive_kinds(tmp_path, "wall_clock", "best_effort")
    assert wall_clock.outcome is Outcome.NO_FIRST_MOTION
    assert re.match(
        r"moved less than .*; use_sim_time is off in /foreign$", wall_clock.detail
    )
    assert best_effort.outcome is Outcome.TIMEOUT
    assert best_effort.measures.driven_m > 0.3


def test_the_node_that_leads_the_planner_is_waited_for(tmp_path):
    patience = replace(ros.PATIENT.patience, gate_s=5.0)
    setup = replace(ros.EACH, planner_node="late", patience=patience)
    late, absent = ros.drive_kinds(tmp_path, "late", "drives", setup=setup)
    assert late.outcome is Outcome.TIMEOUT
    # asked again where an answer is slow to come
    assert int((tmp_path / "starts.heard").read_text()) >= 2
    message = "the node /late (planner_node) is not there (waited 5 s)"
    assert (absent.outcome, absent.detail) == (Outcome.PLANNER_NOT_READY, message)


def test_a_robot_in_a_namespace_with_names_and_frames_of_its_own(tmp_path):
    setup = replace(
        ros.PATIENT,
        namespace="robot1",
        remap=("scan:=front/scan", "/clock:=/sim/clock"),
        map_frame="world",
        odom_frame="robot1/odom",
        base_frame="robot1/base_link",
        lidar_frame="robot1/front",
        command_type="twist_stamped",
    )
    plan = ros.make_plan(replace(PAPER_2020, limit_s=2.0, timeout_time_s=2.0), setup)
    folder = tmp_path / "run"
    (result,) = ros.drive(folder, plan)
    assert result.outcome is Outcome.TIMEOUT
    assert result.measures.driven_m > 0.2
    bag = folder / "bags" / result.trial_id
    heard = ros.messages(bag)
    frames = {
        "cmd_vel": "robot1/base_link",
        "front/scan": "robot1/front",
        "odom": "robot1/odom",
        "ground_truth/odom": "world",
        "goal_pose": "world",
        "map": "world",
    }
    for name, frame in frames.items():
        _, message = heard[f"/robot1/{name}"][-1]
        assert message.header.frame_id == frame
    assert heard["/robot1/odom"][-1][1].child_frame_id == "robot1/base_link"
    assert "/sim/clock" in heard
    assert not {"/cmd_vel", "/scan", "/robot1/scan", "/clock"} & set(heard)
    read = {message.topic for message in BagFile(bag).messages()}
    assert {"/odom", "/scan", "/cmd_vel", "/ground_truth/odom", "/collision"} <= read


def test_a_planner_of_others_in_a_namespace(tmp_path):
    names = "--ros-args -r __ns:=/robot1 -r scan:=front/scan"
    command = f"{ros.foreign(ros.EXAMPLE)} {names}"
    frames = {"namespace": "/robot1", "odom_frame": "robot1/odom"}
    setup = replace(ros.PATIENT, remap=("scan:=front/scan",), **frames)
    plan = ros.make_plan(ros.SHORT, setup, "simple", command)
    (result,) = ros.drive(tmp_path / "run", plan)
    assert result.outcome is Outcome.TIMEOUT
    assert result.measures.driven_m > 0.3
    heard = ros.messages(tmp_path / "run" / "bags" / result.trial_id)
    assert heard["/robot1/goal_pose"][-1][1].header.frame_id == "robot1/odom"
    assert "/robot1/map" not in heard


def test_an_interrupted_evaluator_ends_without_traceback(tmp_path):
    words = f"-m barn_eval.ros.evaluator --ros-args -p out:={tmp_path}/out"
    command = [sys.executable, *words.split()]
    with reserve_domain({}) as domain:
        environment = {**os.environ, "ROS_DOMAIN_ID": str(domain)}
        with subprocess.Popen(
            command, env=environment, stderr=subprocess.PIPE, text=True
        ) as evaluator:
            output = next(
                line for line in evaluator.stderr if "waiting for the services" in line
            )
            while evaluator.poll() is None:
                evaluator.send_signal(signal.SIGINT)
                time.sleep(0.005)
            output += evaluator.stderr.read()
    assert "Traceback" not in output
    # a signal that comes after Python's own handlers have gone ends what is left of the
    # process
    assert evaluator.returncode in (ExitCode.INTERRUPTED, -signal.SIGINT)


def test_the_rclpy_of_another_python_is_refused(tmp_path, monkeypatch):
    other = tmp_path / "other" / "rclpy"
    other.mkdir(parents=True)
    (other / "__init__.py").touch()
    (other / "_rclpy_pybind11.cpython-27-x86_64-linux-gnu.so").touch()
    environment = with_search_path(other.parent)
    info = run_python("-m", "barn_eval", "info", "--json", env=environment)
    off = json.loads(info.stdout)["optional"]["rclpy"]
    assert off.startswith(
        f"off: rclpy of {other} is for a different Python (cpython-27-x86_64-linux-gnu.so)"
    )
    words = f"run --mode ros --worlds 0 --planner gap --out {tmp_path}/out".split()
    ended = run_python("-m", "barn_eval", *words, check=False, env=environment)
    assert ended.returncode == 2
    assert f"mode ros: rclpy of {other} is for a different Python" in ended.stderr
    assert not (tmp_path / "out").exists()
