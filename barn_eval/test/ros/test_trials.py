"""Trials over ROS: real processes over real DDS, each test on a domain of its own."""

import importlib.util
import json
import os
import re
import shlex
import signal
import socket
import struct
import subprocess
import sys
import threading
from collections import Counter
from contextlib import suppress
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
import ros_runs as ros
import yaml
from planners import recorded
from ros_runs import nothing_left  # noqa: F401 (a fixture)
from rosbags.rosbag2 import Reader
from waiting import barn_words, run_python, until

from barn_eval.results.bags.movers import compute_gaps
from barn_eval.results.bags.recorded import read_recorded_trial
from barn_eval.results.folder import read_results
from barn_eval.ros.supervision import start
from barn_eval.ros.supervision.process import SupervisedProcess
from barn_eval.running.runner import RunError
from barn_eval.trials.protocol import CHALLENGE, DYNABARN, PAPER_2020
from barn_eval.trials.result import Outcome
from barn_eval.trials.run_config import RunConfig
from barn_eval.trials.spec import simulator_config
from barn_worlds.base.arrays import COMPILING_NOTE, unit_vectors
from barn_worlds.base.errors import ExitCode
from barn_worlds.geometry.bodies import wall_bodies
from barn_worlds.geometry.footprint import Footprint
from barn_worlds.messages.cdr import jazzy_types
from barn_worlds.messages.topics import (
    BAND,
    CANDIDATES,
    COSTMAP,
    DIAGNOSTICS,
    LOCAL_PLAN,
    PLAN,
    SCAN,
)
from barn_worlds.robots.files import find_robot_files, load_robot
from barn_worlds.ros.domain import reserve_domain

MOVING = ("/moving_obstacles", "/moving_obstacles/poses")
TRANSFORMS = {"/tf", "/tf_static"}
HAS_TRANSFORMS = importlib.util.find_spec("tf2_msgs") is not None
# They may come after the verdict, when the trial is over.
SHOWN_AFTER_COMMANDS = {
    topic.path for topic in (PLAN, LOCAL_PLAN, COSTMAP, BAND, CANDIDATES, DIAGNOSTICS)
}


def write_robot(folder):
    """A robot of one's own, from a file: a TurtleBot 3 Waffle that is slower."""
    content = yaml.safe_load(find_robot_files()["turtlebot3_waffle"].read_text("utf-8"))
    content["drive"]["max_speed_m_s"] = 0.2
    file = folder / "mine.yaml"
    file.write_text(yaml.safe_dump(content | {"name": "own_robot"}), "utf-8")
    return load_robot(file)


@pytest.mark.parametrize(
    "protocol, robot, planner",
    [
        (PAPER_2020, "jackal", "eband"),
        (DYNABARN, "jackal", "dwa"),
        (CHALLENGE, "own_robot", "mppi"),
    ],
    ids=lambda messages: getattr(messages, "name", messages),
)
def test_lockstep_and_direct_trials_are_the_same_step_by_step(
    tmp_path, protocol, robot, planner
):
    # Eight seconds with and without a map, and among moving obstacles: every reading,
    # scan and command, to a bit.
    dataset, worlds = ("dynabarn60", "7") if protocol.arena else ("barn300", "100")
    protocol = replace(protocol, limit_s=8.0, timeout_time_s=8.0)
    driven = write_robot(tmp_path) if robot == "own_robot" else load_robot(robot)
    simulator = simulator_config(protocol, robot=driven)
    plan = ros.make_plan(
        protocol, planner=planner, worlds=worlds, dataset=dataset, simulator=simulator
    )
    (result,) = ros.drive(tmp_path / "ros", plan)
    (spec,) = plan.trials()
    direct = recorded(spec, tmp_path / "direct").result
    assert result.repeatable() | {"mode": "direct"} == direct.repeatable()
    bag = tmp_path / "ros" / "bags" / spec.trial_id
    over_ros = ros.messages(bag)
    messages = ros.messages(tmp_path / "direct")
    names = "odom ground_truth/odom scan cmd_vel score outcome score_text"
    for name in names.split():
        stamps, expected = (
            [stamp for stamp, _ in messages_by_topic[f"/{name}"]]
            for messages_by_topic in (over_ros, messages)
        )
        assert stamps == expected  # and their bytes: see below
    assert len(messages["/odom"]) > 100
    assert len(messages["/score"]) > 10
    assert len(messages["/world"]) == 1
    for topic in MOVING:
        assert (len(messages.get(topic, [])) > 50) == protocol.arena
    outcomes = [outcome.data for _, outcome in messages["/outcome"]]
    assert (outcomes[0], outcomes[-1]) == ("running", result.outcome.value)
    assert messages["/score"][-1][1].data == result.scores.challenge
    assert len(over_ros["/goal_pose"]) > 10 or not protocol.map_given
    assert_equal_bytes(ros.unstamped(bag), ros.unstamped(tmp_path / "direct"))


def test_a_free_running_trial_meets_movers_where_scans_do(tmp_path):
    protocol = replace(DYNABARN, limit_s=5.0, timeout_time_s=5.0)
    setup = replace(ros.PATIENT, lockstep=False, real_time_factor=2.0)
    plan = ros.make_plan(
        protocol, setup, planner="gap", worlds="7", dataset="dynabarn60"
    )
    (result,) = ros.drive(tmp_path / "ros", plan)
    (spec,) = plan.trials()
    assert result.outcome in (Outcome.TIMEOUT, Outcome.COLLISION)
    assert result.motion.phase_s == spec.phase_s
    bag = read_recorded_trial(tmp_path / "ros" / "bags" / spec.trial_id)
    tracks = spec.world.tracks
    moving = bag.moving
    assert len(moving.times_s) > 40
    expected = tracks.over(moving.times_s + spec.phase_s)[0]
    np.testing.assert_allclose(moving.places, expected, atol=1e-9)
    walls = wall_bodies(spec.world.walls)
    point = Footprint(np.zeros((1, 2)), 1e-9)
    for item in bag.items[SCAN][::10]:
        robot = bag.pose(bag.index_at(item.time_s))
        is_hit = np.isfinite(item.content.ranges)
        angles = item.content.angles()[is_hit]
        ranges = item.content.ranges[is_hit].astype(float)
        ends = ranges[:, None] * unit_vectors(angles)
        hits = (robot @ bag.lidar).transform(ends)
        points = np.column_stack([hits, np.zeros(len(hits))])
        place = tracks.at(spec.phase_s + item.time_s)[0]
        places = np.repeat(place[None], len(hits), axis=0)
        gaps_m = compute_gaps(moving.bodies, walls, places, points, point)
        assert np.quantile(gaps_m, 0.95) < 0.1


def assert_equal_bytes(ros, direct):
    """Every message of a direct bag is in that of ROS, byte for byte.

    DDS fills up to a multiple of four.
    """
    transforms = set() if HAS_TRANSFORMS else TRANSFORMS
    assert set(direct) - set(ros) == transforms
    assert len(direct) > 12 + len(transforms)
    # A simulator over ROS repeats its frames, at time 0, until the first step.
    over_ros = dict(ros)
    if HAS_TRANSFORMS:
        repeated = len(ros["/tf"]) - len(direct["/tf"])
        over_ros["/tf"] = ros["/tf"][repeated:]
        stamp = slice(8, 16)
        first = direct["/tf"][0][stamp]
        assert {data[stamp] for data in ros["/tf"][: repeated + 1]} == {first}
    for topic in set(direct) - transforms:
        if topic == "/goal_pose":
            # sent again when the evaluator comes to it: equal but for the stamp
            goals = {data[12:] for data in over_ros[topic]}
            assert goals == {data[12:] for data in direct[topic]}
            continue
        if topic not in SHOWN_AFTER_COMMANDS:
            assert len(over_ros[topic]) == len(direct[topic]), topic
        for got, expected in zip(over_ros[topic], direct[topic], strict=False):
            size = len(expected)
            assert got[:size] == expected, topic
            padding = bytes(-size % 4)
            assert got[size:] == padding[: len(got) - size], topic
        assert len(direct[topic]) - len(over_ros[topic]) <= 1


def test_a_whole_trial_succeeds_and_its_bag_holds_everything(tmp_path):
    plan = ros.make_plan(CHALLENGE)
    folder = tmp_path / "run"
    (result,) = ros.run(folder, plan)
    assert (result.outcome, result.remarks) == (Outcome.SUCCESS, "")
    assert (result.wall_clock.missed_cycles, result.wall_clock.missed_share) == (0, 0.0)
    assert result.wall_clock.compute_p50_ms > 0.0
    assert read_results(folder) == [result]
    bag = tmp_path / "run" / "bags" / result.trial_id
    with Reader(bag) as reader:
        counts = Counter(connection.topic for connection, _, _ in reader.messages())
        for connection, _, data in reader.messages():
            jazzy_types().deserialize_cdr(data, connection.msgtype)
    description = yaml.safe_load((bag / "metadata.yaml").read_text())
    custom = description["rosbag2_bagfile_information"]["custom_data"]
    assert custom["barn.result.result"] and custom["barn.trial.specification"]
    cycles = round(result.scores.duration_s / plan.protocol.control_period_s)
    for topic in ("/scan", "/odom", "/collision"):
        assert counts[topic] == cycles + 1
    assert counts["/clock"] > cycles
    assert (counts["/cmd_vel"], counts["/robot_description"]) == (cycles, 1)
    display = (
        "plan local_plan local_costmap/costmap candidates score outcome score_text"
    )
    others = "goal_pose joint_states amcl_pose ground_truth/odom diagnostics"
    topics = {f"/{name}" for name in f"{display} {others}".split()}
    assert topics | (TRANSFORMS if HAS_TRANSFORMS else set()) <= set(counts)
    # what was put away is not run again
    log = folder / "logs" / "simulator.log"
    before = log.read_bytes()
    assert ros.run(folder, plan) == [result]
    assert log.read_bytes() == before


def test_every_planner_fault_is_an_outcome(tmp_path):
    kinds = {
        "wrong_type": Outcome.WRONG_MESSAGE_TYPE,
        "silent": Outcome.NO_FIRST_MOTION,
        "nan": Outcome.INVALID_COMMAND,
        "dies": Outcome.PLANNER_DIED,
        "exits": Outcome.PLANNER_DIED,
        "hangs": Outcome.PLANNER_STALLED,
        "apart": Outcome.TIMEOUT,
        "one_shot": Outcome.TIMEOUT,  # drives, and ends when there is nothing more to do, as the one after it
    }
    options = {"setup": ros.QUICK, "repetitions": len(kinds) + 1}
    results = ros.drive_kinds(tmp_path, *kinds, **options)
    assert [result.outcome for result in results] == [*kinds.values(), Outcome.TIMEOUT]
    by_kind = dict(zip(kinds, results, strict=False))
    assert by_kind["wrong_type"].detail == (
        "no publisher on /cmd_vel; a String publisher exists on /cmd_vel, but this run expects Twist or TwistStamped"
    )
    assert by_kind["dies"].detail == "the planner was killed by SIGKILL"
    assert by_kind["exits"].detail == "the planner exited with code 3"
    assert by_kind["silent"].wall_clock.missed_cycles >= 1
    assert "; no node publishes /missing_path" in by_kind["silent"].detail
    assert "no command for 5 s" in by_kind["hangs"].detail
    for kind in ("nan", "dies", "exits", "hangs"):
        # 30 good cycles went before, and are in the trajectory
        assert by_kind[kind].measures.driven_m > 0.3, kind
    names = {path.name for path in tmp_path.glob("run/bags/*")}
    assert names == {result.trial_id for result in results}


def test_a_timer_on_simulated_time_is_found_out_and_not_waited_for(tmp_path):
    setup = replace(ros.PATIENT, command_wait_s=2.0)
    protocol = replace(ros.SHORT, limit_s=6.0, timeout_time_s=6.0)
    first, second = ros.drive_kinds(
        tmp_path, "timer", setup=setup, protocol=protocol, repetitions=2
    )
    for result in (first, second):
        clock = result.wall_clock
        assert result.outcome is Outcome.TIMEOUT
        assert (clock.planner_rate_hz, clock.rate_source) == (5.0, "found")
        assert (clock.compute_clock, clock.missed_cycles) == ("processor", 0)
        # The planner's own time, without what passes from one timer to the next.
        assert clock.compute_p50_ms < 100.0
    stamps = [
        stamp
        for stamp, _ in ros.messages(tmp_path / "run" / "bags" / second.trial_id)[
            "/cmd_vel"
        ]
    ]
    assert set(np.diff(stamps)) == {200_000_000}


def test_a_clock_and_a_planner_that_wait_for_each_other_are_nobodys_fault(tmp_path):
    patience = replace(ros.PATIENT.patience, command_s=2.0)
    setup = replace(ros.PATIENT, patience=patience)
    (result,) = ros.drive_kinds(tmp_path, "timer", setup=setup)
    assert (result.outcome, result.fault) == (Outcome.NO_FIRST_MOTION, "environment")
    assert "--ros planner_rate_hz" in result.detail
    assert result.wall_clock.attempts == 1


def test_a_free_running_trial_with_late_commands_is_marked(tmp_path):
    setup = replace(ros.PATIENT, lockstep=False, real_time_factor=1.0)
    (result,) = ros.drive_kinds(tmp_path, "dozes", setup=setup)
    # of 50 scans a second, five in ten are not answered
    assert result.wall_clock.missed_share >= 0.15
    assert result.wall_clock.is_late
    assert "without a command in time" in result.remarks


def test_faults_of_the_set_up_are_repeated_and_change_no_row(tmp_path, nothing_left):  # noqa: F811
    protocol = replace(
        ros.SHORT, limit_s=10.0, timeout_time_s=10.0, collision_ends_trial=False
    )
    command = ros.foreign(ros.FOREIGN, tmp_path / "starts", "drives")
    plan = ros.make_plan(
        protocol, planner="drives", planner_command=command, repetitions=3
    )
    folder = tmp_path / "run"
    simulator = "barn_sim.ros.simulator"
    evaluator = "barn_eval.ros.evaluator"

    def kill(pids):
        for pid in pids:
            os.kill(pid, signal.SIGKILL)

    deeds = {
        0: lambda: kill(ros.node_process(nothing_left, simulator)),
        1: lambda: kill(ros.node_process(nothing_left, evaluator)),
        2: lambda: kill(ros.launchers(nothing_left, str(ros.FOREIGN))),
    }

    def disturb():
        for repetition, deed in deeds.items():
            name = f"drives_w0000_r{repetition:02d}"
            part = folder / "bags" / f"{name}.partial" / f"{name}_0.mcap"
            # it is driving
            until(lambda part=part: part.exists() and part.stat().st_size > 10_000)
            deed()

    threading.Thread(target=disturb, daemon=True).start()
    notices = []
    results = list(ros.drive(folder, plan, notices.append))
    assert [result.repetition for result in results] == [0, 1, 2]
    for text in (
        "simulator was killed by SIGKILL in trial drives_w0000_r00",
        "drives_w0000_r00 is repeated: simulator_died, the simulator was killed by SIGKILL",
        "evaluator was killed by SIGKILL in trial drives_w0000_r01",
        "planner was lost with its launcher in trial drives_w0000_r02",
        "drives_w0000_r02 is repeated: planner_died, the planner was lost with its launcher",
    ):
        assert any(notice.startswith(text) for notice in notices), text
    reasons = (
        "simulator_died, the simulator was killed by SIGKILL",
        "the evaluator was killed by SIGKILL",
        "planner_died, the planner was lost with its launcher",
    )
    undisturbed = ros.drive(tmp_path / "undisturbed", plan)
    for result, reason, other in zip(results, reasons, undisturbed, strict=True):
        clock = result.wall_clock
        assert (clock.attempts, clock.repeated) == (2, reason)
        assert result.repeatable() == other.repeatable()
        assert result.outcome is Outcome.TIMEOUT


def listeners(pid):
    """Return (address, port), as the kernel writes them, of the sockets of a process
    that a network could reach.
    """
    sockets = set()
    for entry in Path(f"/proc/{pid}/fd").iterdir():
        with suppress(FileNotFoundError):  # closed meanwhile
            sockets.add(str(entry.readlink()))
    addresses = set()
    for name in ("udp", "tcp", "udp6", "tcp6"):
        table = Path(f"/proc/{pid}/net/{name}").read_text()
        for words in map(str.split, table.splitlines()[1:]):
            if f"socket:[{words[9]}]" in sockets:
                addresses.add(tuple(words[1].split(":")))
    return addresses


def test_nothing_listens_beyond_loopback_or_is_left_running(
    tmp_path,
    nothing_left,  # noqa: F811
):
    planner = f"--planner simple --planner-command '{ros.foreign(ros.EXAMPLE)}'"
    options = f"--worlds 0 --mode ros --bags all --out {tmp_path}/run"
    command = barn_words(f"run {planner} {options}")
    run = subprocess.Popen(command, cwd=tmp_path, stderr=subprocess.PIPE, text=True)
    partial_bags = "run/bags/*.partial/*.mcap"
    until(lambda: list(tmp_path.glob(partial_bags)) or run.poll() is not None)
    # nodes, their launchers, the command
    until(lambda: len(ros.marked(nothing_left)) >= 7)
    pids = ros.marked(nothing_left)
    addresses = {address for pid in pids for address in listeners(pid)}
    assert len(addresses) >= 6  # two ports of each node, at least
    (loopback,) = struct.unpack("=L", socket.inet_aton("127.0.0.1"))
    assert {address for address, _ in addresses} == {f"{loopback:08X}"}
    for pid in pids:
        assert "/dev/shm/fastrtps" not in Path(f"/proc/{pid}/maps").read_text()
    run.terminate()
    _, errors = run.communicate(timeout=600)
    assert run.returncode != 0
    assert "Traceback" not in errors
    until(lambda: not ros.marked(nothing_left))
    assert (tmp_path / "run" / "run.json").exists()
    assert not (tmp_path / "run" / "results.jsonl").exists()


@pytest.mark.parametrize(
    "words, problem",
    [
        ("--ros-args -p worlds", "ROS arguments: "),
        ("worlds:=3", "argument 'worlds:=3': a node has no options"),
        (
            "--ros-args -p wolds:=3 -p protocol:=x",
            "unknown parameter 'wolds'; did you mean 'worlds'?",
        ),
    ],
)
def test_wrong_arguments_end_the_evaluator_in_a_line(words, problem):
    words = f"barn_eval.ros.evaluator:main {words}"
    done = run_python(start.__file__, *words.split(), check=False)
    assert done.returncode == ExitCode.REFUSED
    assert f"evaluator: {problem}" in done.stderr.replace("[evaluator]:", "evaluator:")
    assert "Traceback" not in done.stderr


def test_the_nodes_started_by_hand(tmp_path, monkeypatch):
    # As with `ros2 run` in three terminals: no supervisor, another name and another
    # topic for the commands.
    with reserve_domain({}) as domain:
        monkeypatch.setenv("ROS_DOMAIN_ID", str(domain))
        monkeypatch.setenv("ROS_AUTOMATIC_DISCOVERY_RANGE", "LOCALHOST")
        out = f"-p out:={tmp_path}/run -p simulator_node:=/jackal"
        programs = {
            "barn_sim.ros.simulator:main": "-p lockstep:=true -r __node:=jackal",
            "barn_planners.ros.planner:main_dwa": "-p command_type:=twist_stamped",
            "barn_eval.ros.evaluator:main": f"{out} -p worlds:=3 -p planner:=mine",
        }
        nodes = []
        for program, options in programs.items():
            words = f"{program} --ros-args -r cmd_vel:=/drive {options}".split()
            command = [sys.executable, start.__file__, *words]
            log = tmp_path / f"{program}.log"
            nodes.append(SupervisedProcess(program, command, os.environ, log))
        try:
            nodes[2].wait(600.0)
            assert nodes[2].end == "exited with code 0", nodes[2].log.read_text()
        finally:
            for node in nodes:
                node.stop()
    log = nodes[2].log.read_text()
    assert "1 of 1 trials to do, protocol challenge" in log
    simulator = "/jackal (ros2 run barn_sim simulator)"
    assert f"waiting for {simulator} and for a planner on /drive" in log
    for node in nodes[:2]:
        assert COMPILING_NOTE in node.log.read_text()
    assert "[1/1] mine_w0003_r00: success in " in log
    assert re.search(r"success 100%, mean challenge metric 0\.\d+\n", log)
    assert f"results in {tmp_path}/run; for a report: barn report" in log
    (result,) = read_results(tmp_path / "run")
    assert (result.trial_id, result.outcome) == ("mine_w0003_r00", Outcome.SUCCESS)
    # nobody told the evaluator
    assert result.preset == result.planner_config == ""
    assert result.task == RunConfig().trials([3])[0].task
    assert "/drive" in ros.messages(tmp_path / "run" / "bags" / result.trial_id)


def test_a_planner_that_cannot_import_the_suite_drives(tmp_path):
    without = (
        "import runpy, sys; sys.modules |= dict.fromkeys(sys.argv[2:]); "
        "runpy.run_path(sys.argv[1], {}, '__main__')"
    )
    suite = "barn_worlds barn_sim barn_planners barn_metrics barn_eval numba pybullet"
    command = [sys.executable, "-I", "-c", without, str(ros.EXAMPLE), *suite.split()]
    setup = replace(ros.PATIENT, lockstep=False, command_type="twist")
    plan = ros.make_plan(ros.SHORT, setup, "simple", shlex.join(command))
    (result,) = ros.drive(tmp_path / "run", plan)
    assert result.outcome is Outcome.TIMEOUT
    assert result.measures.driven_m > 0.3


@pytest.mark.parametrize(
    "command, words",
    [
        (
            "sh -c 'echo no such parameter; exit 1'",
            "exited with code 1 at its start, 3 times in a row.*such parameter",
        ),
        (
            "/does/not/exist",
            "the planner cannot be started: /does/not/exist: No such file or directory",
        ),
    ],
)
def test_a_planner_that_does_not_start_ends_the_run(tmp_path, command, words):
    plan = ros.make_plan(planner="broken", planner_command=command)
    with pytest.raises(RunError, match=f"(?s){words}"):
        ros.run(tmp_path / "run", plan)
    assert not (tmp_path / "run" / "results.jsonl").exists()


ASKING = """
import rclpy
from geometry_msgs.msg import Twist
from sensor_msgs.msg import LaserScan

def main():
    x, y = float(input("x? ")), float(input("y? "))
    print(f"goal {x:.1f} {y:.1f}", flush=True)
    rclpy.init()
    node = rclpy.create_node("asking")
    commands = node.create_publisher(Twist, "drive", 10)
    command = Twist()
    command.linear.x = 0.3
    answer = lambda scan: commands.publish(command)
    node.create_subscription(LaserScan, "front/scan", answer, 10)
    rclpy.spin(node)
"""


def test_a_planner_that_asks_for_its_goal_is_tried_and_driven(
    tmp_path,
):
    (tmp_path / "asking.py").write_text(ASKING)

    def barn(*words):
        """Run the barn command in the folder of the test; return code and output."""
        process = subprocess.run(
            barn_words(shlex.join(words)),
            cwd=tmp_path,
            capture_output=True,
            text=True,
            check=False,
        )
        return process.returncode, process.stdout + process.stderr

    package = ["--planner-package", "asking.py"]
    code, output = barn("try", *package)
    assert code == 3
    assert "it asks for input: --planner-input" in output

    package += ["--planner-input", "{goal_x}\\n{goal_y}", "--json"]
    code, output = barn("try", *package)
    assert code == 0, output
    seen = json.loads(output)
    assert seen["drives"]
    assert seen["topics"]["cmd_vel"] == "/drive"
    assert seen["topics"]["scan"] == "/front/scan"
    assert seen["ros"] == {
        "required_inputs": "[scan]",
        "remap": "[cmd_vel:=/drive, scan:=/front/scan]",
    }

    # The line that is printed, in worlds with a short limit.
    words = shlex.split(seen["run"].partition(" --out")[0])[1:]
    words += ["--out", "run", "--worlds", "0:2", "--protocol", "short.yaml"]
    (tmp_path / "short.yaml").write_text(
        "schema_version: 1\nbase: challenge\nname: short\nlimit_s: 2.0\nfirst_motion_limit_s: 2.0\n"
        "timeout_time_s: 2.0\n"
    )
    code, output = barn(*words, "--workers", "1")
    assert code == 0, output
    # Each trial has a planner of its own, which is given that trial's goal.
    (log,) = (tmp_path / "run" / "logs").rglob("planner.log")
    assert log.read_text().count("goal 10.0 0.0") == 2
