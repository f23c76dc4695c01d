"""The simulator node running freely, with commands of either kind, with other robots, and unable to start."""

import signal
from contextlib import ExitStack, closing
from dataclasses import replace

import numpy as np
import pytest
import yaml

rclpy = pytest.importorskip("rclpy", reason="ROS 2 is not installed")

from geometry_msgs.msg import Twist, TwistStamped  # noqa: E402
from rclpy.qos import qos_profile_sensor_data  # noqa: E402
from sensor_msgs.msg import LaserScan  # noqa: E402
from simulator_peer import (  # noqa: E402
    TRIAL,
    Driver,
    assert_equal,
    commands,
    simulator_process,
    stamp_of,
)

from barn_sim.body.model import joint_names, robot_description  # noqa: E402
from barn_sim.config import RunConfig, with_robot  # noqa: E402
from barn_worlds.base.errors import ExitCode  # noqa: E402
from barn_worlds.robots.files import find_robot_files, load_robot  # noqa: E402

pytestmark = pytest.mark.usefixtures("private_domain")


@pytest.fixture
def started():
    """Starts the node with parameters and a peer that commands by messages of a type; both end after the test."""
    with ExitStack() as ends:

        def start(command=Twist, **parameters):
            process = simulator_process(**parameters)
            ends.callback(process.stop)
            return process, ends.enter_context(closing(Driver(command)))

        yield start


def test_runs_freely_at_sensor_rates_and_rejects_wrong_types(started):
    rates = {"real_time_factor": 4.0, "lidar.rate_hz": 40.0, "lidar.beams": 100}
    process, peer = started(TwistStamped, command_type="twist", **rates)
    # Best effort here, reliably in the peer: both are served.
    scans = []
    peer.node.create_subscription(
        LaserScan, "scan", scans.append, qos_profile_sensor_data
    )
    peer.wait(lambda: len(scans) > 100)
    peer.wait(lambda: peer.is_warned("TwistStamped"))
    spacing = np.diff([stamp_of(message) for message in scans])
    assert np.median(spacing) == 25_000_000
    assert (spacing > 0).all()
    assert not (spacing % 25_000_000).any()  # some may be lost, many on a busy machine
    odometry = np.diff([stamp_of(message) for message in peer.heard["/odom"]])
    assert np.median(odometry) == 20_000_000
    assert len(peer.heard["/scan"]) > 50
    code, output = process.stop(signal.SIGTERM)
    assert code == 0
    assert "Traceback" not in output
    assert output.count("this run expects geometry_msgs/msg/Twist") == 1


BAD_STARTS = """
- [{world: 4711}, no world 4711]
- [{robot: husk}, "unknown robot 'husk'; did you mean 'husky'?"]
- [{physics.tick_s: 0.003}, whole physics steps of 0.003 s]
- [{lidar.beams: many}, lidar.beams]
- [{"": 0}, "ROS arguments: "]
"""


@pytest.mark.parametrize("parameters, reason", yaml.safe_load(BAD_STARTS))
def test_a_bad_start_is_refused_in_one_line(parameters, reason):
    code, output = simulator_process(**parameters).end()
    assert code == ExitCode.REFUSED
    lines = [line for line in output.splitlines() if line.startswith("simulator: ")]
    assert len(lines) == 1
    assert reason in lines[0]
    assert "Traceback" not in output


def test_commands_without_guarantee_of_delivery_are_heard_too(started):
    process, peer = started(real_time_factor=4.0, **{"lidar.beams": 100})
    unsure = peer.node.create_publisher(Twist, "cmd_vel", qos_profile_sensor_data)
    command = Twist()
    command.linear.x = 0.5

    def moves():
        unsure.publish(command)
        return any(
            message.twist.twist.linear.x > 0.4
            for message in peer.heard["/ground_truth/odom"]
        )

    peer.wait(moves)
    code, output = process.stop()
    assert code == 0
    assert "commands come best-effort as Twist" in output


EACH = {
    "rate_hz": 20.0,
    "sweeps": False,
    "noise_m": 0.02,
}  # of the lidar: a scan for each command


def test_robots_over_ros_equal_the_core_to_the_last_bit(started, tmp_path):
    """TurtleBot 4 by its name at the start, then another by its file at a reset, with all of its parameters."""
    robot = load_robot("turtlebot4")
    lidar = {f"lidar.{key}": value for key, value in EACH.items()}
    process, peer = started(
        lockstep=True, start_paused=True, robot="turtlebot4", **lidar
    )
    peer.fresh_trial(**TRIAL)
    sent = commands(60)
    peer.drive(sent)
    config = with_robot(RunConfig(), robot)
    config = replace(
        config, lidar=replace(config.lidar, **EACH)
    )  # what was set has precedence
    assert_equal(peer.heard, config, sent)
    assert tuple(peer.heard["/joint_states"][0].name) == joint_names(robot.chassis)
    peer.wait(
        lambda: peer.description.data == robot_description(config.lidar, robot.chassis)
    )

    other = load_robot("turtlebot3_waffle")
    file = tmp_path / "mine.yaml"
    file.write_text(find_robot_files()["turtlebot3_waffle"].read_text("utf-8"), "utf-8")
    config = with_robot(RunConfig(), other)
    config = replace(config, lidar=replace(config.lidar, **EACH))
    named = {
        f"{part}.{key}": value
        for part in ("drive", "lidar", "odometry")
        for key, value in vars(getattr(config, part)).items()
    }
    settings = {
        "robot": str(file),
        "physics.wheel_friction": other.wheel_friction,
        **named,
    }
    peer.fresh_trial(
        **{name.replace(".", "__"): value for name, value in settings.items()}, **TRIAL
    )
    peer.drive(sent)
    assert_equal(peer.heard, config, sent)
    assert tuple(peer.heard["/joint_states"][0].name) == joint_names(other.chassis)
    peer.wait(
        lambda: peer.description.data == robot_description(other.lidar, other.chassis)
    )

    assert peer.set(robot="huskie")[0].successful
    answer = peer.reset()
    assert not answer.success
    assert "unknown robot 'huskie'; did you mean 'husky'?" in answer.message
    code, output = process.stop()
    assert code == 0 and "Traceback" not in output
