"""The simulator node running freely, with commands of either kind, and with parameters that it cannot start with."""

import signal

import numpy as np
import pytest

rclpy = pytest.importorskip("rclpy", reason="ROS 2 is not installed")

from geometry_msgs.msg import Twist, TwistStamped  # noqa: E402
from rclpy.qos import qos_profile_sensor_data  # noqa: E402
from sensor_msgs.msg import LaserScan  # noqa: E402
from simulator_peer import LIMIT_S, Peer, Process, says, stamp_of  # noqa: E402

pytestmark = pytest.mark.usefixtures("own_domain")


def test_runs_freely_at_the_rates_of_its_sensors_and_complains_of_a_wrong_type() -> None:
    process = Process(real_time_factor=4.0, command_type="twist", **{"lidar.rate_hz": 40.0, "lidar.beams": 100})
    peer = Peer(TwistStamped)
    try:
        # best effort: a reliable subscription would not be served
        scans = []
        peer.node.create_subscription(LaserScan, "scan", scans.append, qos_profile_sensor_data)
        peer.wait(lambda: len(scans) > 100)
        peer.wait(lambda: any(says(m, "TwistStamped") for m in peer.heard["/diagnostics"]))
        spacing = np.diff([stamp_of(message) for message in scans])
        assert np.median(spacing) == 25_000_000
        assert (spacing > 0).all()
        assert not (spacing % 25_000_000).any()  # some may be lost, many on a busy machine
        odometry = np.diff([stamp_of(message) for message in peer.heard["/odom"]])
        assert np.median(odometry) == 20_000_000
        assert not peer.heard["/scan"]
    finally:
        peer.close()
        code, output = process.stop(signal.SIGTERM)
    assert code == 0
    assert "Traceback" not in output
    assert output.count("this run expects geometry_msgs/msg/Twist") == 1


@pytest.mark.parametrize(
    ("parameters", "reason"),
    [
        ({"world": 4711}, "no world 4711"),
        ({"dataset": "/nowhere"}, "/nowhere"),
        ({"physics.tick_s": 0.003}, "whole physics steps of 0.003 s"),
        ({"seed": -1}, "seed"),
        ({"lidar.beams": "many"}, "lidar.beams"),
    ],
)
def test_a_bad_start_is_one_line_and_exit_code_1(parameters: dict, reason: str) -> None:
    process = Process(**parameters)
    output, _ = process.process.communicate(timeout=LIMIT_S)
    assert process.process.returncode == 1
    lines = [line for line in output.splitlines() if line.startswith("simulator: ")]
    assert len(lines) == 1
    assert reason in lines[0]
    assert "Traceback" not in output


def test_commands_without_guarantee_of_delivery_are_heard_too() -> None:
    process = Process(real_time_factor=4.0, **{"lidar.beams": 100})
    peer = Peer()
    try:
        unsure = peer.node.create_publisher(Twist, "cmd_vel", qos_profile_sensor_data)
        command = Twist()
        command.linear.x = 0.5

        def moves() -> bool:
            unsure.publish(command)
            return any(one.twist.twist.linear.x > 0.4 for one in peer.heard["/ground_truth/odom"])

        peer.wait(moves)
    finally:
        peer.close()
        code, output = process.stop()
    assert code == 0
    assert "commands come best-effort as Twist" in output
