"""The simulator node with other robots, as a process of its own in lockstep with this test."""

from dataclasses import replace

import pytest

rclpy = pytest.importorskip("rclpy", reason="ROS 2 is not installed")

from simulator_peer import TRIAL, Peer, Process, assert_equal, commands  # noqa: E402

from barn_sim.body.model import joint_names, robot_description  # noqa: E402
from barn_sim.config import RunConfig, with_robot  # noqa: E402
from barn_sim.simulator import Simulator  # noqa: E402
from barn_worlds.base.types import Pose2D  # noqa: E402
from barn_worlds.robots.files import load_robot, shipped_robots  # noqa: E402
from barn_worlds.worlds.dataset import open_dataset  # noqa: E402


@pytest.fixture
def start_node(own_domain):
    """Start the node with parameters, and a peer; both end after a test."""
    started = []

    def start(**parameters):
        process, peer = Process(lockstep=True, start_paused=True, **parameters), Peer()
        started.append((process, peer))
        return process, peer

    yield start
    for process, peer in started:
        peer.close()
        process.stop()


def expected_of(config, sent):
    simulator = Simulator(open_dataset("barn300").load(120), config, Pose2D(-2.25, 3.5, 1.57), 42)
    readings = [simulator.sense(), *(simulator.step(command) for command in sent)]
    simulator.close()
    return readings


def test_robots_over_ros_equal_the_core_to_the_last_bit(start_node, tmp_path):
    """TurtleBot 4 by its name at the start, then another by its file at a reset, with all of its parameters."""
    robot = load_robot("turtlebot4")
    each = {"rate_hz": 20.0, "sweeps": False, "noise_m": 0.02}  # a scan for each command
    process, peer = start_node(robot="turtlebot4", **{f"lidar.{key}": value for key, value in each.items()})
    peer.fresh_trial(**TRIAL)
    sent = commands(60)
    peer.drive(sent)
    config = with_robot(RunConfig(), robot)
    config = replace(config, lidar=replace(config.lidar, **each))  # what was set has precedence
    assert_equal(peer.heard, expected_of(config, sent))
    assert tuple(peer.heard["/joint_states"][0].name) == joint_names(robot.chassis)
    peer.wait(lambda: peer.description == robot_description(config.lidar, robot.chassis))

    other = load_robot("turtlebot3_waffle")
    file = tmp_path / "mine.yaml"
    file.write_text(shipped_robots()["turtlebot3_waffle"].read_text("utf-8"), "utf-8")
    config = with_robot(RunConfig(), other)
    config = replace(config, lidar=replace(config.lidar, **each))
    named = {
        f"{part}.{key}": value
        for part in ("drive", "lidar", "odometry")
        for key, value in vars(getattr(config, part)).items()
    }
    settings = {"robot": str(file), "physics.wheel_friction": other.wheel_friction, **named}
    peer.fresh_trial(**{name.replace(".", "__"): value for name, value in settings.items()}, **TRIAL)
    peer.drive(sent)
    assert_equal(peer.heard, expected_of(config, sent))
    assert tuple(peer.heard["/joint_states"][0].name) == joint_names(other.chassis)
    peer.wait(lambda: peer.description == robot_description(other.lidar, other.chassis))

    assert peer.set(robot="huskie")[0].successful
    answer = peer.reset()
    assert not answer.success
    assert "unknown robot 'huskie'; did you mean 'husky'?" in answer.message
    code, output = process.stop()
    assert code == 0 and "Traceback" not in output


def test_an_unknown_robot_is_one_line(own_domain):
    process = Process(robot="husk")
    output, _ = process.process.communicate(timeout=600)
    assert process.process.returncode == 1
    assert "simulator: unknown robot 'husk'; did you mean 'husky'?" in output
    assert "Traceback" not in output
