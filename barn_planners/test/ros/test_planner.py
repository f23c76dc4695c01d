"""The planner node as a process of its own: over DDS it commands to the last bit what the planner does directly."""

import dataclasses
import signal
from contextlib import closing

import numpy as np
import pytest

rclpy = pytest.importorskip("rclpy", reason="ROS 2 is not installed")

from diagnostic_msgs.msg import DiagnosticArray  # noqa: E402
from geometry_msgs.msg import (  # noqa: E402
    PoseStamped,
    PoseWithCovarianceStamped,
    Twist,
    TwistStamped,
)
from nav_msgs.msg import OccupancyGrid, Path  # noqa: E402
from nav_msgs.msg import Odometry as OdometryMessage  # noqa: E402
from rclpy.serialization import serialize_message  # noqa: E402
from ros_peer import Peer, Process  # noqa: E402
from sensor_msgs.msg import LaserScan  # noqa: E402

from barn_planners.interface import Task  # noqa: E402
from barn_planners.registry import make_planner  # noqa: E402
from barn_worlds.base.errors import ExitCode  # noqa: E402
from barn_worlds.base.types import ORIGIN, STOP, OccupancyMap, Pose2D, Velocity2D  # noqa: E402
from barn_worlds.messages import decode, encode  # noqa: E402
from barn_worlds.messages.topics import LATCHED  # noqa: E402
from barn_worlds.ros.topics import qos_profile  # noqa: E402

BOX = [
    ((-2.0, -2.0), (6.0, -2.0)),
    ((-2.0, 2.0), (6.0, 2.0)),
    ((-2.0, -2.0), (-2.0, 2.0)),
    ((1.5, -2.0), (1.5, -0.1)),
]
MAP_OF_ODOM = Pose2D(0.5, -0.25, 0.1)
pytestmark = pytest.mark.usefixtures("private_domain")


class Harness(Peer):
    """The other side: publishes readings as the simulator does and hears commands."""

    def __init__(self, command_type=Twist):
        super().__init__("harness")
        self.commands = []
        self.plans = []
        self.diagnostics = []
        make = self.node.create_publisher
        self.odom = make(OdometryMessage, "odom", 10)
        self.pose = make(PoseWithCovarianceStamped, "amcl_pose", 10)
        self.scan = make(LaserScan, "scan", 10)
        self.goal = make(PoseStamped, "goal_pose", 10)
        self.map = make(OccupancyGrid, "map", qos_profile(LATCHED))
        listen = self.node.create_subscription
        listen(command_type, "cmd_vel", self.commands.append, 10)
        listen(Path, "plan", self.plans.append, 10)
        listen(DiagnosticArray, "diagnostics", self.diagnostics.append, 10)

    def meet(self, use_map):
        """Wait until every topic has its other side."""
        topics = [self.odom, self.scan, self.goal]
        if use_map:
            topics += [self.map, self.pose]
        for topic in topics:
            self.wait(topic.get_subscription_count, "the planner's subscriptions")
        self.wait(lambda: self.node.count_publishers("cmd_vel") > 0, "cmd_vel")

    def answer(self, observation, with_pose):
        """Publish one instant, the scan first, as the least convenient order, and return the command."""
        count = len(self.commands)
        self.scan.publish(scan_message(observation))
        if with_pose:
            encoder = encode.PoseWithCovarianceEncoder("map")
            self.pose.publish(encoder.encode(observation.pose, observation.stamp_ns))
        self.odom.publish(odometry_message(observation))
        self.wait(lambda: len(self.commands) > count, "a command")
        assert len(self.commands) == count + 1, "one command per scan"
        return velocity_of(self.commands[-1])


@pytest.fixture
def harness():
    with closing(Harness()) as each:
        yield each


@pytest.fixture
def start_node():
    """Return the function that starts the node with parameters; whatever still runs at the end is killed."""
    started = []

    def start(main="main_dwa", **parameters):
        code = f"import sys; from barn_planners.ros.planner import {main}; sys.exit({main}())"
        started.append(Process("-c", code, **parameters))
        return started[-1]

    yield start
    for process in started:
        process.process.kill()


def scan_message(observation):
    scan = observation.scan
    return encode.ScanEncoder(scan, "lidar_link", 0.05).encode(scan, scan.stamp_ns)


def odometry_message(observation):
    encoder = encode.OdometryEncoder("odom", "base_link")
    return encoder.encode(observation.odometry, observation.odometry.stamp_ns)


def goal_message(goal, frame):
    return encode.PoseStampedEncoder(frame).encode(goal, 0)


def velocity_of(command):
    twist = command.twist if isinstance(command, TwistStamped) else command
    return Velocity2D(twist.linear.x, twist.angular.z)


def through_messages(observation):
    """Return an observation as it comes out of messages."""
    return dataclasses.replace(
        observation,
        odometry=decode.odometry(odometry_message(observation)),
        scan=decode.scan(scan_message(observation)),
        pose=observation.pose.through_quaternion(),
    )


@pytest.mark.parametrize(
    "use_map, frame_name, preset",
    [(False, "odom", "challenge"), (True, "map", "paper2020")],
)
def test_the_node_commands_what_the_planner_commands(
    flat_world, harness, start_node, use_map, frame_name, preset
):
    frame = MAP_OF_ODOM if use_map else ORIGIN
    free = OccupancyMap(np.zeros((80, 80), np.int8), 0.15, -6.0, -6.0)
    static_map = free if use_map else None
    goal = (frame @ Pose2D(4.0, 0.3, 0.0)).through_quaternion()
    process = start_node(use_map=use_map, seed=3)
    harness.meet(use_map)
    missing = "no goal yet, no map yet" if use_map else "no goal yet"
    assert harness.call("dwa_planner/ready").message == missing
    world = flat_world(BOX)
    assert harness.answer(with_pose_of(world.observe(), frame), use_map) == STOP
    world.advance(STOP)
    harness.goal.publish(goal_message(goal, frame_name))
    if use_map:
        harness.map.publish(encode.encode_map(static_map, 0, "map"))
    harness.wait(lambda: harness.call("dwa_planner/ready").success, "goal and map")
    planner = make_planner("dwa", preset)
    planner.start(Task(goal, static_map), seed=3)
    last = STOP
    for _ in range(60):
        observation = with_pose_of(world.observe(), frame)
        command = harness.answer(observation, use_map)
        decision = planner.step(through_messages(observation))
        last = decision.command if decision.command is not None else last
        assert command == last
        world.advance(last)
    assert world.pose.x > 0.7
    assert harness.plans[0].header.frame_id == frame_name
    assert harness.diagnostics[0].status[0].name == "dwa_planner"
    assert process.stop(signal.SIGTERM)[0] == 0
    harness.wait(
        lambda: velocity_of(harness.commands[-1]) == STOP,
        "the last command, a standstill",
    )


def test_a_node_that_compiles_kernels_can_be_interrupted(
    start_node, monkeypatch, tmp_path
):
    monkeypatch.setenv("NUMBA_CACHE_DIR", str(tmp_path))
    node = start_node()
    assert "compiling" in node.process.stdout.readline()
    code, output = node.stop()
    assert code == 0 and "planning in frame" not in output


def with_pose_of(observation, frame):
    """Return the observation localized, the map-to-odom transform being `frame`."""
    pose = (frame @ observation.odometry.pose).through_quaternion()
    return dataclasses.replace(observation, pose=pose)


def test_reset_new_parameters_stamped_commands_and_refused_goals(
    flat_world, start_node
):
    goal = Pose2D(4.0, 0.3, 0.0)
    with closing(Harness(TwistStamped)) as harness:
        process = start_node(
            "main",
            planner="dwa",
            preset="challenge",
            command_type="twist_stamped",
            sead=1,
        )
        harness.meet(use_map=False)
        harness.goal.publish(goal_message(goal, "map"))
        world = flat_world(BOX)
        assert harness.answer(world.observe(), False) == STOP
        world.advance(STOP)
        assert harness.call("planner/ready").message == "no goal yet"
        harness.goal.publish(goal_message(goal, "odom"))
        harness.wait(lambda: harness.call("planner/ready").success, "the goal")
        assert harness.answer(world.observe(), False).linear > 0.0
        header = decode.header(serialize_message(harness.commands[-1]))
        assert header == (world.stamp_ns, "base_link")
        assert harness.call("planner/reset").success
        world.advance(STOP)
        assert harness.answer(world.observe(), False) == STOP
        assert harness.call("planner/ready").message == "no goal yet"
        code, log = process.stop()
        assert code == 0
        refusal = "goal refused: it is in frame 'map', but this planner plans in 'odom'"
        assert log.count(refusal) == 1
        assert "unknown parameter 'sead'; did you mean 'seed'?" in log
        assert "Traceback" not in log


@pytest.mark.parametrize(
    "parameter, message",
    [
        ({"planner": "dva"}, "unknown planner 'dva'; did you mean 'dwa'?"),
        ({"dwa.max_speed_mps": -1.0}, "dwa.max_speed_mps out of range"),
    ],
)
def test_a_wrong_parameter_ends_the_node_with_one_line(start_node, parameter, message):
    code, output = start_node("main", **parameter).end()
    assert code == ExitCode.REFUSED and message in output and output.count("\n") == 1


def test_malformed_arguments_end_the_node_without_a_traceback(start_node):
    code, output = start_node(**{"": 0}).end()
    assert code == ExitCode.REFUSED and "Traceback" not in output
