"""A peer of the simulator node in its tests: it drives the simulator and keeps what it hears."""

import math
import time
from collections import defaultdict
from dataclasses import replace
from functools import partial

import numpy as np
from diagnostic_msgs.msg import DiagnosticArray
from driving import readings_of
from geometry_msgs.msg import PoseWithCovarianceStamped, Twist
from nav_msgs.msg import Odometry
from rcl_interfaces.srv import SetParameters
from rclpy.parameter import Parameter
from rclpy.serialization import serialize_message
from ros_peer import Peer, Process
from rosgraph_msgs.msg import Clock
from sensor_msgs.msg import JointState, LaserScan
from std_msgs.msg import Bool, String
from std_srvs.srv import SetBool

from barn_sim.simulator import Simulator
from barn_worlds.base.types import NANOSECONDS_PER_SECOND, Pose2D, Velocity2D
from barn_worlds.datasets.dataset import open_dataset
from barn_worlds.messages import decode
from barn_worlds.messages.encode import TwistStampedEncoder, encode_twist
from barn_worlds.messages.topics import LATCHED, Qos
from barn_worlds.ros.topics import qos_profile

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


class Driver(Peer):
    """A node in this process that drives the simulator and keeps what it hears, in the order of arrival."""

    def __init__(self, command=Twist):
        super().__init__()
        self.heard: dict[str, list] = defaultdict(list)
        self.description = String()
        self.command_type = command
        self.commands = self.node.create_publisher(command, "cmd_vel", 10)
        for topic, kind in TOPICS.items():
            self.node.create_subscription(
                kind, topic, partial(self._listen, topic), qos_profile(Qos(depth=1000))
            )
        describe = partial(setattr, self, "description")
        self.node.create_subscription(
            String, "robot_description", describe, qos_profile(LATCHED)
        )

    def _listen(self, topic, message):
        self.heard[topic].append(message)

    def set(self, **values):
        parameters = [
            Parameter(name.replace("__", "."), value=value).to_parameter_msg()
            for name, value in values.items()
        ]
        service = "/simulator/set_parameters"
        return self.call(service, SetParameters, parameters=parameters).results

    def pause(self, on):
        return self.call("/simulator/pause", SetBool, data=on)

    def reset(self):
        return self.call("/simulator/reset")

    def is_warned(self, text):
        """Tell whether a diagnostic message with a text has been heard."""
        return any(
            text in status.message
            for message in self.heard["/diagnostics"]
            for status in message.status
        )

    def send(self, velocity):
        if self.command_type is Twist:
            self.commands.publish(encode_twist(velocity))
        else:
            self.commands.publish(TwistStampedEncoder("base_link").encode(velocity, 0))

    def connected(self):
        topics = ["/clock", "/odom", "/scan"]
        is_complete = all(self.node.count_publishers(topic) == 1 for topic in topics)
        return is_complete and self.commands.get_subscription_count() == 1

    def fresh_trial(self, **values):
        """Pause, set parameters, reset and forget what was heard before."""
        assert self.pause(True).success
        assert all(result.successful for result in self.set(**values))
        answer = self.reset()
        assert answer.success, answer.message
        self.wait(self.connected)
        quiet_since = time.monotonic()
        while (
            time.monotonic() - quiet_since < 0.3
        ):  # until what was still on its way has arrived
            self.executor.spin_once(timeout_sec=0.05)
            if any(self.heard[topic] for topic in ("/scan", "/odom")):
                quiet_since = time.monotonic()
            self.heard.clear()

    def drive(self, commands):
        """Answer each scan by the next command."""
        assert self.pause(False).success
        for count, velocity in enumerate(commands, 1):
            self.wait(lambda count=count: len(self.heard["/scan"]) >= count)
            self.send(velocity)
        # one of these may overtake another
        for topic in ("/odom", "/ground_truth/odom", "/joint_states", "/scan"):
            self.wait(lambda topic=topic: len(self.heard[topic]) > len(commands))
        assert self.pause(True).success


def simulator_process(**parameters):
    return Process("-m", "barn_sim.ros.simulator", **parameters)


def commands(count):
    return [Velocity2D(0.7, 0.8 * math.sin(0.13 * k)) for k in range(count)]


TRIAL = {
    "world": 120,
    "seed": 42,
    "start_x_m": -2.25,
    "start_y_m": 3.5,
    "start_yaw_rad": 1.57,
}


def assert_equal(heard, config, sent):
    """Check that a peer heard, to the last bit, what a new simulator reads in that trial; return those readings."""
    start = Pose2D(TRIAL["start_x_m"], TRIAL["start_y_m"], TRIAL["start_yaw_rad"])
    world = open_dataset("barn300").load(TRIAL["world"])
    expected = readings_of(Simulator(world, config, start, TRIAL["seed"]), sent)
    for topic in TOPICS.keys() - {"/clock", "/diagnostics"}:
        assert len(heard[topic]) == len(expected), topic
    origin_ns = stamp_of(heard["/odom"][0])
    assert origin_ns % NANOSECONDS_PER_SECOND == 0
    for k, sensors in enumerate(expected):
        stamp_ns = origin_ns + sensors.stamp_ns
        for topic, reading in (
            ("/odom", sensors.odometry),
            ("/ground_truth/odom", sensors.truth),
        ):
            odometry = read(decode.odometry, heard[topic][k])
            assert odometry == replace(reading, stamp_ns=stamp_ns)
        believed = read(decode.pose_with_covariance, heard["/amcl_pose"][k])
        assert believed == sensors.localization
        assert heard["/collision"][k].data == sensors.collision
        scan = read(decode.scan, heard["/scan"][k])
        assert scan.stamp_ns == stamp_ns
        np.testing.assert_array_equal(scan.ranges, sensors.scan.ranges)
        for name in ("angle_min", "angle_increment", "range_min", "range_max"):
            assert getattr(scan, name) == getattr(sensors.scan, name), name
        assert tuple(heard["/joint_states"][k].position) == sensors.joints.positions
    return expected


def read(decoder, message):
    """Return what the suite reads of a message that rclpy has received."""
    return decoder(serialize_message(message))


def stamp_of(message):
    return read(decode.header, message).stamp_ns
