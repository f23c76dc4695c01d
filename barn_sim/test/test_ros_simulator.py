"""The simulator node as a process of its own, over DDS, in lockstep with this test and running freely."""

from __future__ import annotations

import math
import os
import signal
import subprocess
import sys
import time
from collections import defaultdict
from itertools import pairwise

import numpy as np
import pytest

rclpy = pytest.importorskip("rclpy")

from diagnostic_msgs.msg import DiagnosticArray  # noqa: E402
from geometry_msgs.msg import PoseWithCovarianceStamped, Twist, TwistStamped  # noqa: E402
from nav_msgs.msg import Odometry  # noqa: E402
from rcl_interfaces.srv import SetParameters  # noqa: E402
from rclpy.context import Context  # noqa: E402
from rclpy.executors import SingleThreadedExecutor  # noqa: E402
from rclpy.parameter import Parameter  # noqa: E402
from rosgraph_msgs.msg import Clock  # noqa: E402
from sensor_msgs.msg import JointState, LaserScan  # noqa: E402
from std_msgs.msg import Bool, String  # noqa: E402
from std_srvs.srv import SetBool, Trigger  # noqa: E402

from barn_sim.config import PRESETS  # noqa: E402
from barn_sim.simulator import Simulator  # noqa: E402
from barn_worlds.config import fields_of  # noqa: E402
from barn_worlds.dataset import open_dataset  # noqa: E402
from barn_worlds.ros.conversions import (  # noqa: E402
    LATCHED,
    from_odometry,
    from_pose,
    from_scan,
    from_time,
    reliable,
    to_twist,
    to_twist_stamped,
)
from barn_worlds.types import NANOSECONDS, Pose2D, Velocity2D  # noqa: E402

LIMIT_S = 60.0  # nothing here takes so long unless it hangs
TOPICS = {
    "/clock": Clock,
    "/odom": Odometry,
    "/ground_truth/odom": Odometry,
    "/amcl_pose": PoseWithCovarianceStamped,
    "/collision": Bool,
    "/joint_states": JointState,
    "/scan": LaserScan,
    "/diagnostics": DiagnosticArray,
}
DOMAIN = 11 + os.getpid() % 85


class Peer:
    """A node in this process that drives the simulator and keeps what it hears, in the order of arrival."""

    def __init__(self, command: type = Twist) -> None:
        self.context = Context()
        rclpy.init(context=self.context, domain_id=DOMAIN)
        self.node = rclpy.create_node("peer", context=self.context)
        self.executor = SingleThreadedExecutor(context=self.context)
        self.executor.add_node(self.node)
        self.heard: dict[str, list] = defaultdict(list)
        self.description = ""
        self.command_type = command
        self.commands = self.node.create_publisher(command, "cmd_vel", reliable(10))
        for topic, kind in TOPICS.items():
            self.node.create_subscription(kind, topic, self._listener(topic), reliable(1000))
        self.node.create_subscription(String, "robot_description", self._describe, LATCHED)

    def _listener(self, topic: str):
        def listen(message) -> None:
            self.heard[topic].append(message)

        return listen

    def _describe(self, message: String) -> None:
        self.description = message.data

    def wait(self, done, limit_s: float = LIMIT_S) -> None:
        deadline = time.monotonic() + limit_s
        while not done():
            assert time.monotonic() < deadline, "waited in vain"
            self.executor.spin_once(timeout_sec=0.1)

    def call(self, kind, name: str, request):
        client = self.node.create_client(kind, name)
        self.wait(client.service_is_ready)
        future = client.call_async(request)
        self.wait(future.done)
        self.node.destroy_client(client)
        return future.result()

    def set(self, **values):
        request = SetParameters.Request(
            parameters=[Parameter(name.replace("__", "."), value=v).to_parameter_msg() for name, v in values.items()]
        )
        return self.call(SetParameters, "/simulator/set_parameters", request).results

    def pause(self, on: bool):
        return self.call(SetBool, "/simulator/pause", SetBool.Request(data=on))

    def reset(self):
        return self.call(Trigger, "/simulator/reset", Trigger.Request())

    def step(self):
        return self.call(Trigger, "/simulator/step", Trigger.Request())

    def send(self, velocity: Velocity2D) -> None:
        message = to_twist(velocity) if self.command_type is Twist else to_twist_stamped(velocity, 0, "base_link")
        self.commands.publish(message)

    def connected(self) -> bool:
        topics = ["/clock", "/odom", "/scan"]
        there = all(self.node.count_publishers(topic) == 1 for topic in topics)
        return there and self.commands.get_subscription_count() == 1

    def forget(self) -> None:
        self.heard.clear()

    def fresh_trial(self, **values) -> None:
        """Pause, set parameters, reset and forget what was heard before."""
        assert self.pause(True).success
        assert all(result.successful for result in self.set(**values))
        answer = self.reset()
        assert answer.success, answer.message
        self.wait(self.connected)
        quiet_since = time.monotonic()
        while time.monotonic() - quiet_since < 0.3:  # until what was still on its way has arrived
            self.executor.spin_once(timeout_sec=0.05)
            if any(self.heard[topic] for topic in ("/scan", "/odom")):
                quiet_since = time.monotonic()
            self.forget()

    def drive(self, commands: list[Velocity2D]) -> None:
        """Answer each scan by the next command."""
        assert self.pause(False).success
        for count, velocity in enumerate(commands, 1):
            self.wait(lambda count=count: len(self.heard["/scan"]) >= count)
            self.send(velocity)
        self.wait(lambda: len(self.heard["/scan"]) > len(commands))
        assert self.pause(True).success

    def close(self) -> None:
        self.executor.shutdown()
        self.node.destroy_node()
        rclpy.shutdown(context=self.context)


class Process:
    """The node as a process of its own."""

    def __init__(self, **parameters) -> None:
        arguments = [part for name, value in parameters.items() for part in ("-p", f"{name}:={value}")]
        self.process = subprocess.Popen(
            [sys.executable, "-m", "barn_sim.ros.simulator", "--ros-args", *arguments],
            env=os.environ | {"ROS_DOMAIN_ID": str(DOMAIN)},
            stdout=subprocess.PIPE,
            stderr=subprocess.STDOUT,
            text=True,
        )

    def stop(self, number: int = signal.SIGINT) -> tuple[int, str]:
        if self.process.poll() is None:
            self.process.send_signal(number)
        try:
            output, _ = self.process.communicate(timeout=LIMIT_S)
        except subprocess.TimeoutExpired:
            self.process.kill()
            raise
        return self.process.returncode, output


@pytest.fixture(scope="module", autouse=True)
def this_host_only():
    before = os.environ.get("ROS_AUTOMATIC_DISCOVERY_RANGE")
    os.environ["ROS_AUTOMATIC_DISCOVERY_RANGE"] = "LOCALHOST"
    yield
    if before is None:
        del os.environ["ROS_AUTOMATIC_DISCOVERY_RANGE"]
    else:
        os.environ["ROS_AUTOMATIC_DISCOVERY_RANGE"] = before


@pytest.fixture(scope="module")
def lockstep(this_host_only):
    process = Process(lockstep=True, start_paused=True)
    yield process
    code, output = process.stop()
    assert code == 0
    assert "Traceback" not in output


@pytest.fixture
def peer(lockstep):
    peer = Peer()
    yield peer
    peer.close()


def commands(count: int) -> list[Velocity2D]:
    return [Velocity2D(0.7, 0.8 * math.sin(0.13 * k)) for k in range(count)]


TRIAL = {"world": 120, "seed": 42, "start_x_m": -2.25, "start_y_m": 3.5, "start_yaw_rad": 1.57}


@pytest.mark.parametrize("preset", ["default", "paper"])
def test_lockstep_equals_the_core_to_the_last_bit(peer: Peer, preset: str) -> None:
    config = PRESETS[preset]
    settings = {name.replace(".", "__"): value for name, _, value in fields_of(config)}
    peer.fresh_trial(**settings, **TRIAL)
    sent = commands(80)
    peer.drive(sent)

    world = open_dataset("barn300").load(120)
    simulator = Simulator(world, config, Pose2D(-2.25, 3.5, 1.57), 42)
    expected = [simulator.sense(), *(simulator.step(command) for command in sent)]
    simulator.close()

    heard = peer.heard
    for topic in TOPICS.keys() - {"/clock", "/diagnostics"}:
        assert len(heard[topic]) == len(expected), topic
    origin_ns = from_time(heard["/odom"][0].header.stamp)
    assert origin_ns % NANOSECONDS == 0
    for k, sensors in enumerate(expected):
        odometry, truth = from_odometry(heard["/odom"][k]), from_odometry(heard["/ground_truth/odom"][k])
        assert odometry.stamp_ns == truth.stamp_ns == origin_ns + sensors.stamp_ns
        assert (odometry.pose, odometry.velocity) == (sensors.odometry.pose, sensors.odometry.velocity)
        assert (truth.pose, truth.velocity) == (sensors.truth.pose, sensors.truth.velocity)
        assert from_pose(heard["/amcl_pose"][k].pose.pose) == sensors.localisation
        assert heard["/collision"][k].data == sensors.collision
        scan = from_scan(heard["/scan"][k])
        np.testing.assert_array_equal(scan.ranges, sensors.scan.ranges)
        for name in ("angle_min", "angle_increment", "range_min", "range_max"):
            assert getattr(scan, name) == getattr(sensors.scan, name), name
        assert scan.stamp_ns == origin_ns + sensors.stamp_ns
        assert tuple(heard["/joint_states"][k].position) == sensors.joints.positions
    assert {sensors.collision for sensors in expected} == {False, True}  # so that contacts are compared as well


def test_each_instant_is_whole_and_its_stamps_agree(peer: Peer) -> None:
    peer.fresh_trial(**TRIAL)
    peer.drive(commands(10))
    stamps = [from_time(message.header.stamp) for message in peer.heard["/scan"]]
    assert [b - a for a, b in pairwise(stamps)] == [50_000_000] * 10
    for topic in ("/odom", "/ground_truth/odom", "/amcl_pose", "/joint_states"):
        assert [from_time(message.header.stamp) for message in peer.heard[topic]] == stamps
    ticks = [from_time(message.clock) for message in peer.heard["/clock"]]
    assert sorted(set(ticks)) == stamps
    assert peer.heard["/scan"][0].header.frame_id == "lidar_link"
    assert (peer.heard["/odom"][0].header.frame_id, peer.heard["/odom"][0].child_frame_id) == ("odom", "base_link")
    assert peer.heard["/amcl_pose"][0].header.frame_id == "map"
    peer.wait(lambda: "lidar_link" in peer.description)


def test_the_clock_never_runs_backwards_and_a_reset_goes_to_the_next_second(peer: Peer) -> None:
    peer.fresh_trial(**TRIAL)
    peer.drive(commands(5))
    before = from_time(peer.heard["/clock"][-1].clock)
    assert peer.reset().success
    peer.wait(lambda: from_time(peer.heard["/clock"][-1].clock) > before)
    after = from_time(peer.heard["/clock"][-1].clock)
    assert after == (before // NANOSECONDS + 1) * NANOSECONDS
    ticks = [from_time(message.clock) for message in peer.heard["/clock"]]
    assert ticks == sorted(ticks)


def test_while_paused_nothing_moves_but_single_steps_do(peer: Peer) -> None:
    peer.fresh_trial(**TRIAL)
    time.sleep(0.3)
    peer.wait(lambda: len(peer.heard["/clock"]) > 0)
    assert not peer.heard["/scan"]
    for _ in range(3):
        assert peer.step().success
    peer.wait(lambda: len(peer.heard["/scan"]) == 4)  # that of the start and one for each step
    stamps = [from_time(message.header.stamp) for message in peer.heard["/scan"]]
    assert stamps[-1] - stamps[0] == 150_000_000
    assert peer.pause(False).success
    refused = peer.step()
    assert not refused.success
    assert "not paused" in refused.message


def test_a_step_repeats_the_last_command(peer: Peer) -> None:
    peer.fresh_trial(drive__command_latency_s=0.0, **TRIAL)
    peer.send(Velocity2D(0.5, 0.0))
    time.sleep(0.2)
    for _ in range(20):  # longer than the watchdog would let it run
        assert peer.step().success
    peer.wait(lambda: len(peer.heard["/ground_truth/odom"]) == 21)
    assert peer.heard["/ground_truth/odom"][-1].twist.twist.linear.x == pytest.approx(0.5, abs=0.01)
    peer.set(drive__command_latency_s=0.08)


def test_values_that_are_not_allowed_are_refused_with_the_reason(peer: Peer) -> None:
    results = peer.set(lidar__beams=0, seed=-1, localisation__mode="amlc")
    assert [result.successful for result in results] == [False] * 3
    assert "beams" in results[0].reason
    assert "amcl" in results[2].reason


def test_a_reset_that_cannot_be_done_says_why_and_changes_nothing(peer: Peer) -> None:
    peer.fresh_trial(**TRIAL)
    assert all(result.successful for result in peer.set(world=99999))
    answer = peer.reset()
    assert not answer.success
    assert "no world 99999" in answer.message
    assert "\n" not in answer.message
    peer.set(**TRIAL)
    peer.drive(commands(3))
    assert len(peer.heard["/scan"]) == 4


def test_missed_and_invalid_commands_are_counted_and_reported(peer: Peer) -> None:
    peer.fresh_trial(command_wait_s=0.05, **TRIAL)
    peer.drive([Velocity2D(0.5, 0.0), Velocity2D(math.nan, 0.0)])
    assert peer.pause(False).success
    peer.wait(lambda: len(peer.heard["/scan"]) >= 6)  # nobody answers
    message = peer.pause(True).message
    assert "1 invalid commands" in message
    assert message.endswith("connected: 1 scan subscriptions, 1 command publishers")
    missed = int(message.split(" missed")[0].split()[-1])
    assert missed >= 3
    peer.wait(lambda: any(_says(m, "invalid commands") for m in peer.heard["/diagnostics"]))
    assert "missed commands" in peer.reset().message
    peer.set(command_wait_s=5.0)


def _says(message: DiagnosticArray, text: str) -> bool:
    return any(text in status.message for status in message.status)


def test_stamped_commands_are_taken_as_well(lockstep) -> None:
    peer = Peer(TwistStamped)
    try:
        peer.fresh_trial(**TRIAL)
        peer.drive([Velocity2D(0.5, 0.0)] * 20)
        assert peer.heard["/ground_truth/odom"][-1].twist.twist.linear.x > 0.4
    finally:
        peer.close()


def test_runs_freely_at_the_rates_of_its_sensors_and_complains_of_a_wrong_type() -> None:
    process = Process(real_time_factor=4.0, command_type="twist", **{"lidar.rate_hz": 40.0, "lidar.beams": 100})
    peer = Peer(TwistStamped)
    try:
        # best effort: a reliable subscription would not be served
        scans = []
        peer.node.create_subscription(LaserScan, "scan", scans.append, rclpy.qos.qos_profile_sensor_data)
        peer.wait(lambda: len(scans) > 100)
        peer.wait(lambda: any(_says(m, "TwistStamped") for m in peer.heard["/diagnostics"]))
        spacing = np.diff([from_time(message.header.stamp) for message in scans])
        assert np.median(spacing) == 25_000_000
        assert set(spacing) <= {25_000_000 * k for k in range(1, 40)}  # some may be lost
        odometry = np.diff([from_time(message.header.stamp) for message in peer.heard["/odom"]])
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
        ({"physics.tick_s": 0.003}, "multiple of the physics step"),
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
